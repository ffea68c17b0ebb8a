//! Rollouts on disk: shards of a fixed number of rows, each whole or absent. Every plan and model has a folder of its
//! own, so that two never mix and none is lost for another. A killed run goes on with the shards that are missing.

use super::design::Sample;
use super::rows::{Row, sample_bits};
use crate::run_files::{Fnv64, read_sealed, read_whole, seal, write_whole};
use anyhow::Context;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Rows of a shard: what a kill may cost is this many rollouts for each thread.
pub const SHARD_ROWS: usize = 32;

/// Kind and version of a shard file.
const KIND: &[u8; 8] = b"gnmrows1";

/// What the rollouts in a folder are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Manifest {
    /// Hash over every sample of the plan.
    plan: u64,
    /// Hash of the model that swings.
    model: u64,
    /// Number of rollouts.
    rollouts: usize,
    /// Rows of a shard.
    shard_rows: usize,
}

impl Manifest {
    /// Name of the folder of such rollouts.
    fn name(&self) -> String {
        let mut hash = Fnv64::default();
        for number in [self.plan, self.model, self.shard_rows as u64] {
            hash.add(&number.to_le_bytes());
        }
        format!("{:016x}", hash.value())
    }
}

/// A folder of shards for one plan and model.
#[derive(Clone, Debug)]
pub struct Shards {
    folder: PathBuf,
}

impl Shards {
    /// The shards of `samples` swung by the model with content hash `model`, in a folder under `parent`.
    ///
    /// # Errors
    /// That folder is damaged, or cannot be made.
    pub fn open(parent: &Path, samples: &[Sample], model: u64) -> anyhow::Result<Self> {
        let manifest = Manifest {
            plan: plan_hash(samples),
            model,
            rollouts: samples.len(),
            shard_rows: SHARD_ROWS,
        };
        let folder = parent.join(manifest.name());
        let path = folder.join("manifest.json");
        if path.exists() {
            let bytes = read_whole(&path)?;
            let found: Manifest = serde_json::from_slice(&bytes).with_context(|| {
                format!(
                    "{} is damaged: delete its folder to collect again",
                    path.display()
                )
            })?;
            anyhow::ensure!(
                found == manifest,
                "{} does not hold what its name says: delete it to collect again",
                folder.display()
            );
        } else {
            write_whole(&path, &serde_json::to_vec_pretty(&manifest)?)?;
        }
        Ok(Self { folder })
    }

    /// The rows of shard `number` if it is there; a shard that is damaged is an error.
    pub fn read(&self, number: usize, samples: &[Sample]) -> anyhow::Result<Option<Vec<Row>>> {
        let path = self.path(number);
        if !path.exists() {
            return Ok(None);
        }
        let rows: Vec<Row> = postcard::from_bytes(&read_sealed(KIND, &path)?).with_context(|| {
            format!(
                "{} cannot be decoded: delete it to collect it again",
                path.display()
            )
        })?;
        let expected = rows.iter().map(|row| row.sample).eq(samples.iter().copied());
        anyhow::ensure!(
            expected,
            "{} holds other rollouts: delete it to collect it again",
            path.display()
        );
        Ok(Some(rows))
    }

    /// Writes shard `number`.
    pub fn write(&self, number: usize, rows: &[Row]) -> anyhow::Result<()> {
        let payload = postcard::to_stdvec(rows).context("rows cannot be encoded")?;
        Ok(write_whole(&self.path(number), &seal(KIND, &payload))?)
    }

    /// The file of shard `number`.
    pub fn path(&self, number: usize) -> PathBuf {
        self.folder.join(format!("shard_{number:05}.bin"))
    }
}

fn plan_hash(samples: &[Sample]) -> u64 {
    let mut hash = Fnv64::default();
    for value in samples.iter().flat_map(sample_bits) {
        hash.add(&value.to_le_bytes());
    }
    hash.value()
}
