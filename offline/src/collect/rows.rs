//! What came out of rollouts, and a summary that hides no refusal.

use super::design::Sample;
use super::swinger::SwingRefusal;
use crate::run_files::Fnv64;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// One rollout and its outcome.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// What was swung.
    pub sample: Sample,
    /// The largest x of the tip in m, or why there is none.
    pub reach_m: Result<f64, SwingRefusal>,
}

/// Rollouts in the order of their plan.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Dataset {
    /// All rollouts, refused ones too.
    pub rows: Vec<Row>,
}

impl Dataset {
    /// Rollouts with a score: sample and reach in m.
    pub fn scored(&self) -> impl Iterator<Item = (&Sample, f64)> {
        self.rows
            .iter()
            .filter_map(|row| row.reach_m.as_ref().ok().map(|reach| (&row.sample, *reach)))
    }

    /// Content hash over every bit of every row.
    pub fn hash(&self) -> u64 {
        let mut hash = Fnv64::default();
        for row in &self.rows {
            for value in sample_bits(&row.sample) {
                hash.add(&value.to_le_bytes());
            }
            match &row.reach_m {
                Ok(reach) => hash.add(&reach.to_le_bytes()),
                Err(refusal) => hash.add(refusal.to_string().as_bytes()),
            }
        }
        hash.value()
    }

    /// Counts and the range of scores.
    pub fn summary(&self) -> DatasetSummary {
        let reaches: Vec<f64> = self.scored().map(|(_, reach)| reach).collect();
        DatasetSummary {
            rollouts: self.rows.len(),
            scored: reaches.len(),
            refusals: count_refusals(self.rows.iter().filter_map(|row| row.reach_m.as_ref().err())),
            reach_low_m: reaches.iter().copied().reduce(f64::min),
            reach_high_m: reaches.iter().copied().reduce(f64::max),
            hash: self.hash(),
        }
    }
}

/// How many refusals there were of each kind.
pub fn count_refusals<'a>(refusals: impl Iterator<Item = &'a SwingRefusal>) -> BTreeMap<String, usize> {
    let mut counts = BTreeMap::new();
    for refusal in refusals {
        *counts.entry(refusal.reason().to_string()).or_insert(0) += 1;
    }
    counts
}

/// The bits that say what a sample is.
pub(super) fn sample_bits(sample: &Sample) -> [u64; 5] {
    [
        sample.index,
        sample.young_pa.to_bits(),
        sample.poisson.to_bits(),
        sample.release_m[0].to_bits(),
        sample.release_m[1].to_bits(),
    ]
}

/// A dataset in a few numbers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DatasetSummary {
    /// Rollouts asked for.
    pub rollouts: usize,
    /// Rollouts with a score.
    pub scored: usize,
    /// Refusals by reason.
    pub refusals: BTreeMap<String, usize>,
    /// Smallest score, m.
    pub reach_low_m: Option<f64>,
    /// Largest score, m.
    pub reach_high_m: Option<f64>,
    /// Content hash.
    pub hash: u64,
}
