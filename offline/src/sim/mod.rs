//! The simulator: 3-D MLS-MPM of a rope, written once and generic over the number type.
//!
//! Letters, as in the papers (Hu et al. 2018, "A moving least squares material point method";
//! Jiang et al. 2015, "The affine particle-in-cell method"; Stomakhin et al. 2012, "Energetically
//! consistent invertible elasticity"):
//!
//! | letter | meaning | unit |
//! |---|---|---|
//! | x, v | position and velocity of a particle | m, m/s |
//! | Ḟ (`deformation_rate`) | affine velocity field of a particle in undeformed coordinates | 1/s |
//! | F (`deformation_gradient`) | deformation gradient, row-major, dx = F dX | 1 |
//! | J | det F | 1 |
//! | R | rotation of the polar decomposition F = R S | 1 |
//! | τ (`kirchhoff`) | Kirchhoff stress, J times the Cauchy stress | Pa |
//! | μ, λ | Lamé parameters of E (`young_pa`) and ν (`poisson`) | Pa |
//! | s | arc length along the undeformed rope, 0 at its start | m |
//!
//! One step reads clamp targets, scatters particles to the grid, updates the grid, gathers back
//! ([`step`]). Nothing here reads a clock, a file or a random source; the same scene gives the same
//! bits for every thread count, because one rollout runs on one thread.

pub mod adjoint;
pub mod band;
pub mod clamp;
pub mod curve;
pub mod dual;
pub mod elastic;
pub mod error;
pub mod grid;
mod hanging;
pub mod kernel;
pub mod lanes;
mod laws;
mod nodes;
pub mod physics;
pub mod real;
pub mod rollout;
pub mod rope;
pub mod scene;
pub mod start;
pub mod statics;
pub mod step;
mod sweep;
pub mod tensor;
mod transfer;

pub use dual::Dual;
pub use error::{Cause, SimError};
pub use lanes::Laned;
pub use physics::Physics;
pub use real::{Arithmetic, Real};
pub use rollout::{Rollout, simulate};
pub use scene::Scene;
