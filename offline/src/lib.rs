//! From one measured demonstration to a frozen policy: simulator, effects, demos, fitting,
//! diagnosis, datasets, training, evaluation and reports, in the order in which data flows.

pub mod bench_diagnosis;
pub mod collect;
pub mod countdown;
pub mod demo;
mod depth_cameras;
pub mod diagnose;
pub mod effects;
pub mod evaluate;
pub mod fit;
pub mod freeze;
pub mod inspect;
pub mod model;
pub mod model_file;
pub mod observe;
pub mod paper_units;
pub mod pipeline;
pub mod play;
pub mod plot;
pub mod reach;
pub mod report;
pub mod reproduce;
pub mod residual;
pub mod run_files;
pub mod sim;
pub mod statistics;
pub mod swing;
pub mod tell;
mod toml_lines;
#[cfg(feature = "train")]
pub mod train;
pub mod trained;
pub mod verify;
pub mod words;

/// Name and version of the program, as what it writes names its maker.
pub const PROGRAM: &str = concat!("offline ", env!("CARGO_PKG_VERSION"));
