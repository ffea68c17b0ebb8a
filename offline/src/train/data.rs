//! A dataset as networks see it: every quantity with mean 0 and spread 1.

use super::TrainError;
use crate::collect::{Dataset, Sample};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use shared::policy::{Normaliser, Scale};

/// Fewer scored rollouts than this teach nothing.
pub const FEWEST_ROWS: usize = 32;

/// One of this many rows is held back to measure the forward model.
const VALIDATION_ONE_IN: usize = 10;

/// A scored rollout, normalised.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Example {
    /// ln E and ν.
    pub rope: [f32; 2],
    /// Release point x and z.
    pub release: [f32; 2],
    /// Reach.
    pub reach: f32,
}

/// Examples to learn from and to validate on.
#[derive(Clone, Debug)]
pub struct Examples {
    /// To learn from.
    pub training: Vec<Example>,
    /// Held back.
    pub validation: Vec<Example>,
}

impl Examples {
    /// The scored rows of `dataset`, normalised by `normaliser`; every tenth is held back.
    pub fn new(dataset: &Dataset, normaliser: Normaliser) -> Self {
        let mut examples = Self {
            training: Vec::new(),
            validation: Vec::new(),
        };
        for (index, (sample, reach)) in dataset.scored().enumerate() {
            let example = example(&normaliser, sample, reach);
            if index % VALIDATION_ONE_IN == VALIDATION_ONE_IN - 1 {
                examples.validation.push(example);
            } else {
                examples.training.push(example);
            }
        }
        examples
    }

    /// A random training example.
    pub fn draw(&self, rng: &mut ChaCha8Rng) -> Example {
        self.training[rng.random_range(0..self.training.len() as u64) as usize]
    }
}

fn example(normaliser: &Normaliser, sample: &Sample, reach: f64) -> Example {
    let [goal, log_young, poisson] = normaliser.inputs(reach, sample.young_pa, sample.poisson);
    Example {
        rope: [log_young, poisson],
        release: [
            normaliser.release_x.normalise(sample.release_m[0]) as f32,
            normaliser.release_z.normalise(sample.release_m[1]) as f32,
        ],
        reach: goal,
    }
}

/// Means and spreads of the scored rows.
pub fn normaliser(dataset: &Dataset) -> Result<Normaliser, TrainError> {
    let rows: Vec<(&Sample, f64)> = dataset.scored().collect();
    if rows.len() < FEWEST_ROWS {
        return Err(TrainError::TooFew {
            scored: rows.len(),
            rollouts: dataset.rows.len(),
        });
    }
    let scale = |name: &'static str, value: &dyn Fn(&(&Sample, f64)) -> f64| {
        let count = rows.len() as f64;
        let mean = rows.iter().map(value).sum::<f64>() / count;
        let square = rows.iter().map(|row| (value(row) - mean).powi(2)).sum::<f64>();
        let scale = (square / count).sqrt();
        if scale > 1e-9 * mean.abs() {
            Ok(Scale { mean, scale })
        } else {
            Err(TrainError::Constant(name))
        }
    };
    Ok(Normaliser {
        goal_x: scale("reach", &|row| row.1)?,
        log_young: scale("Young's modulus", &|row| row.0.young_pa.ln())?,
        poisson: scale("Poisson's ratio", &|row| row.0.poisson)?,
        release_x: scale("release x", &|row| row.0.release_m[0])?,
        release_z: scale("release z", &|row| row.0.release_m[1])?,
    })
}
