//! Training of the policy: (goal, ln E, ν) to a release point.
//!
//! 1. **Regression**, as in the paper: release point on what it reached. A goal has many release points
//!    and the mean of these need not reach it, which is most of the error.
//! 2. **Correction**: a forward model learns reach from release point, which is single-valued; the policy
//!    then learns through it that its answers reach their goals (distal teacher, Jordan and Rumelhart
//!    1992), staying near the regression's answer and inside the region of release points.
//! 3. **Rounds**: the policy's own answers are rolled out and added to the data, so that the forward model
//!    becomes exact where the policy lives, and both go on learning.
//!
//! Mean |goal − reached| on the stand-in of the tests, 300 goals of 60 unseen ropes, in mm; "noise" is a
//! Gaussian error of 2 mm in every rollout that training sees (measured 2026-11 by
//! `cargo test --release -p offline --lib train -- --ignored --nocapture`):
//!
//! | rollouts | step | exact | noise |
//! |---|---|---|---|
//! | 500 | regression | 6.4 | 6.5 |
//! | 500 | and correction | 0.62 | 1.42 |
//! | 500 + 75 | and one round | 0.47 | 1.13 |
//! | 500 + 150 | and two rounds | 0.36 | 1.08 |
//! | 650 | regression and correction, no rounds | 0.62 | |
//! | 40,000 | regression, preset `PAPER` | 4.7 | |
//! | 40,000 + 2,000 | all three, preset `PAPER`, 160 s | 0.09 | |
//!
//! Tried and left out: a committee of four forward models (1.42 becomes 1.32 with noise, nothing without,
//! for twice the time).

mod data;
mod forward_model;
mod learner;
pub(crate) mod net;
mod policy_net;
mod schedule;

pub use learner::Learner;
pub use schedule::{Schedule, TrainSettings};

use crate::collect::{Design, Swinger, Watch, collect, collect_design};
use crate::run_files::{Fnv64, RunFolder, made_by};
use crate::trained::Trained;
use shared::policy::PolicyError;

/// Why training gave no policy.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TrainError {
    /// Too few rollouts have a score.
    #[error(
        "only {scored} of {rollouts} rollouts have a score: collect more, and see why the others were refused"
    )]
    TooFew {
        /// Rollouts with a score.
        scored: usize,
        /// Rollouts made.
        rollouts: usize,
    },
    /// A quantity does not vary.
    #[error("{0} is the same in all rollouts: widen its range")]
    Constant(&'static str),
    /// The loss became infinite or NaN.
    #[error("the loss of the {what} became infinite at step {step}: lower its learning rate")]
    Diverged {
        /// Which network.
        what: &'static str,
        /// At which step.
        step: usize,
    },
    /// The exported network gives other numbers than the trained one.
    #[error("the exported network differs by {0:e} spreads from the trained one: report this as a bug")]
    Export(f32),
    /// The user asked to stop.
    #[error("training stopped on request: run the same command again to repeat it from the rollouts on disk")]
    Stopped,
    /// The policy's parts do not fit.
    #[error(transparent)]
    Policy(#[from] PolicyError),
}

/// Collects `design`, trains on it, and lets the policy's answers be rolled out and learnt from for the
/// rounds of `settings`. Rollouts live in `run` and are reused; the result is saved there, and taken from there where the
/// same was trained before. `model` is the content hash of what swings.
///
/// # Errors
/// Stopped on request, too few rollouts had a score, or a file cannot be written.
pub fn train(
    design: &Design,
    swinger: &dyn Swinger,
    run: &RunFolder,
    model: u64,
    settings: &TrainSettings,
    watch: Watch,
) -> anyhow::Result<Trained> {
    let key = Fnv64::of(format!("{} {model:x} {design:?} {settings:?}", made_by()).as_bytes());
    if let Some(trained) = Trained::kept(run, key) {
        return Ok(trained);
    }
    let dataset = collect_design(design, swinger, run, model, watch)?;
    let mut learner = Learner::start(design, dataset, settings, watch)?;
    for round in 1..=settings.rounds {
        let practice = learner.practice(round);
        let samples = learner.answers(&practice)?;
        let answers = collect(&samples, swinger, &run.rollouts(round), model, watch)?;
        learner.absorb(round, &practice, answers, watch)?;
    }
    let trained = learner.finish()?;
    trained.save(run, key)?;
    Ok(trained)
}

#[cfg(test)]
mod tests;
