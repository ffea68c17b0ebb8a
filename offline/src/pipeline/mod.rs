//! Everything in order: demonstrations to fit, diagnosis, rollouts, policy, blob and report. Every stage leaves whole files
//! in the run's folder. What takes long, up to the policy and its evaluation, is not made again where it is there for the
//! same data and settings, so a killed run goes on where it was; what follows is made anew.

#[cfg(feature = "train")]
mod beside;
#[cfg(feature = "train")]
mod evaluated;
mod fit;
mod identify;
#[cfg(feature = "train")]
mod learn;
mod model;
mod profile;
mod settings;

#[cfg(feature = "train")]
pub use beside::{Beside, beside, refuse_beside, refuse_untrained};
pub use fit::{NOT_DIAGNOSED, fit, refuse_strangers};
pub use identify::{Identified, holds_diagnosis, identify};
#[cfg(feature = "train")]
pub use learn::{Learned, freeze_policy, learn, refuse_unswingable, rollouts};
pub use profile::{Profiled, profile};
pub use settings::{Inputs, Preset, RunSettings, refuse_unnameable};

use serde::Serialize;

/// The last stage that shall be done.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// Fit of the base model.
    Fit,
    /// Residual and effects.
    Diagnose,
    /// Rollouts.
    Collect,
    /// Training.
    Train,
    /// Evaluation.
    Evaluate,
    /// Blob.
    Freeze,
    /// Report.
    Report,
}

/// What a run found, for people and machines.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// Folder of the run.
    pub folder: String,
    /// Verdict in words.
    pub verdict: String,
    /// Effects that were found.
    pub effects: Vec<String>,
    /// Parameters with standard errors.
    pub parameters: Vec<crate::model::Estimate>,
    /// Their 95 % intervals by profile likelihood, where these were asked for.
    pub profiles: Vec<crate::fit::Profile>,
    /// Held-out error of the base model, mm.
    pub held_out_before_mm: f64,
    /// Held-out error of the final model, mm.
    pub held_out_after_mm: f64,
    /// Noise floor of the held-out error, mm.
    pub floor_mm: f64,
    /// |goal − reached| over unseen ropes and goals.
    pub policy: Option<crate::evaluate::MissSummary>,
    /// The same where the answers are swung on a grid that is finer by [`crate::fit::FINER`].
    pub policy_on_finer_grid: Option<crate::evaluate::MissSummary>,
    /// Other ropes in the blob.
    pub beside: Vec<BesideSummary>,
    /// Path of the blob.
    pub blob: Option<String>,
    /// Path of the report.
    pub report: Option<String>,
    /// Wall time of this invocation, s.
    pub wall_s: f64,
}

/// Another rope that a policy answers for.
#[derive(Clone, Debug, Serialize)]
pub struct BesideSummary {
    /// Its name.
    pub name: String,
    /// Goals that it reaches, m.
    pub reach_m: shared::task::Interval,
    /// |goal − reached| over some of them.
    pub miss: crate::evaluate::MissSummary,
}
