//! From one measured demonstration to a frozen policy: simulator, effects, demos, fitting,
//! diagnosis, datasets, training, evaluation and reports, in the order in which data flows.

pub mod demo;
pub mod plot;
