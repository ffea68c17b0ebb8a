//! From one measured demonstration to a frozen policy: simulator, effects, demos, fitting,
//! diagnosis, datasets, training, evaluation and reports, in the order in which data flows.

pub mod collect;
pub mod demo;
pub mod effects;
pub mod fit;
pub mod model;
pub mod observe;
pub mod plot;
pub mod run_files;
pub mod sim;
