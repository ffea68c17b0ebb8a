//! A trained policy on disk: what evaluating and freezing need, without the training program.

use crate::collect::DatasetSummary;
use crate::reach::ReachTable;
use crate::run_files::{RunFolder, read_sealed, seal, write_whole};
use anyhow::Context;
use serde::{Deserialize, Serialize};
use shared::policy::Policy;

/// Kind and version of the file.
const KIND: &[u8; 8] = b"gnmwght2";

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

/// `training.json`.
#[derive(Serialize)]
struct TrainingFile<'a> {
    record: &'a TrainingRecord,
    dataset: &'a DatasetSummary,
}

impl Trained {
    /// Writes weights and record into the run. `key` tells what they were trained on and how.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn save(&self, run: &RunFolder, key: u64) -> anyhow::Result<()> {
        let payload = postcard::to_stdvec(&(key, self)).context("the policy cannot be encoded")?;
        write_whole(&run.weights(), &seal(KIND, &payload))?;
        let record = TrainingFile {
            record: &self.record,
            dataset: &self.dataset,
        };
        write_whole(&run.training(), &serde_json::to_vec_pretty(&record)?)?;
        Ok(())
    }

    /// What [`Trained::save`] wrote for this key; none where it is missing, damaged or another's.
    pub fn kept(run: &RunFolder, key: u64) -> Option<Self> {
        let payload = read_sealed(KIND, &run.weights()).ok()?;
        let (of, trained): (u64, Self) = postcard::from_bytes(&payload).ok()?;
        let sound = trained.policy.check().is_ok() && trained.regression.check().is_ok();
        (of == key && sound).then_some(trained)
    }
}
