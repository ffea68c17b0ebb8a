//! The twin world: an independent rope model seen by simulated depth cameras, which plays reality.

pub mod camera;
pub mod contact;
pub mod derivatives;
pub mod dynamics;
pub mod effects;
pub mod elastica;
pub mod motion;
pub mod reality;
pub mod rod;
pub mod sample_rope;
pub mod scenes;
pub mod swing;
pub mod world;
