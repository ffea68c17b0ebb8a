//! A trained policy on disk: what evaluating and freezing need, without the training program.

use crate::collect::DatasetSummary;
use crate::reach::ReachTable;
use crate::run_files::{RunFolder, read_sealed, seal, write_whole};
use anyhow::Context;
use serde::{Deserialize, Serialize};
use shared::policy::Policy;

/// Kind and version of the file.
const KIND: &[u8; 8] = b"gnmwght1";

/// The result of training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Trained {
    /// The policy to use.
    pub policy: Box<Policy>,
    /// The paper's regression alone, for comparison.
    pub regression: Box<Policy>,
    /// Goals that each rope is predicted to reach.
    pub reach: ReachTable,
    /// What was learnt from, all rounds together.
    pub dataset: DatasetSummary,
    /// How training went.
    pub record: TrainingRecord,
}

/// How training went.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainingRecord {
    /// Seed of training.
    pub seed: u64,
    /// The forward model after the random design and after each round.
    pub forward: Vec<ForwardErrors>,
    /// How far the answers of each round missed their goals before they were learnt from: mean, mm;
    /// none where all were refused.
    pub round_miss_mm: Vec<Option<f64>>,
    /// Largest difference between trained and exported network, in spreads.
    pub export_difference: f32,
}

/// Errors of the forward model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ForwardErrors {
    /// Root mean square on what it learnt from, mm.
    pub training_rms_mm: f64,
    /// Root mean square on rows held back, mm.
    pub validation_rms_mm: f64,
}

impl Trained {
    /// Writes weights and record into the run.
    pub fn save(&self, run: &RunFolder) -> anyhow::Result<()> {
        let payload = postcard::to_stdvec(self).context("the policy cannot be encoded")?;
        write_whole(&run.weights(), &seal(KIND, &payload))?;
        let record = serde_json::to_vec_pretty(&(&self.record, &self.dataset))?;
        write_whole(&run.training(), &record)?;
        Ok(())
    }

    /// Reads what [`Trained::save`] wrote.
    pub fn load(run: &RunFolder) -> anyhow::Result<Self> {
        let path = run.weights();
        let what = || format!("{} holds no usable policy: train again", path.display());
        let trained: Self = postcard::from_bytes(&read_sealed(KIND, &path)?).with_context(what)?;
        trained.policy.check().with_context(what)?;
        trained.regression.check().with_context(what)?;
        Ok(trained)
    }
}
