//! From one measured demonstration to a frozen policy: simulator, effects, demos, fitting,
//! diagnosis, datasets, training, evaluation and reports, in the order in which data flows.

pub mod collect;
pub mod demo;
pub mod evaluate;
pub mod freeze;
pub mod inspect;
pub mod paper_units;
pub mod reach;
pub mod run_files;
#[cfg(feature = "train")]
pub mod train;
pub mod trained;
