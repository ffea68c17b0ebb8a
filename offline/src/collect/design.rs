//! Which rollouts to make: ropes and release points drawn at random, each from the random stream of
//! its own index, so that a rollout is the same for any number of threads and in any order.

use rand::RngExt;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use shared::policy::ReleaseRegion;
use shared::task::{Interval, SwingTask};

/// Share of the free length up to which a rope is dragged: beyond it the rope is a taut line and
/// the drag stretches it (design section 4).
pub const REACH_SHARE: f64 = 0.98;

/// One rollout to make.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sample {
    /// Index in its plan.
    pub index: u64,
    /// Young's modulus, Pa.
    pub young_pa: f64,
    /// Poisson's ratio.
    pub poisson: f64,
    /// Release point (x, z), m.
    pub release_m: [f64; 2],
}

/// A random design over ropes and release points.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Design {
    /// Young's modulus, Pa; drawn log-uniformly.
    pub young_pa: Interval,
    /// Poisson's ratio, drawn uniformly.
    pub poisson: Interval,
    /// Release points, drawn uniformly over the region.
    pub region: ReleaseRegion,
    /// Goals that a policy may be asked for, m.
    pub goal_x_m: Interval,
    /// Number of rollouts.
    pub rollouts: u64,
    /// Seed of all streams.
    pub seed: u64,
}

impl Design {
    /// The region of release points that a rope of free length `free_length_m` reaches in `task`.
    pub fn region(task: &SwingTask, free_length_m: f64) -> ReleaseRegion {
        ReleaseRegion::new(task, REACH_SHARE * free_length_m)
    }

    /// All rollouts of the design.
    pub fn samples(&self) -> Vec<Sample> {
        (0..self.rollouts).map(|index| self.sample(index)).collect()
    }

    /// Rollout `index`.
    pub fn sample(&self, index: u64) -> Sample {
        let mut rng = stream(self.seed, index);
        let (young_pa, poisson) = self.rope(&mut rng);
        Sample {
            index,
            young_pa,
            poisson,
            release_m: self.release(&mut rng),
        }
    }

    /// A random rope: Young's modulus in Pa and Poisson's ratio.
    pub fn rope(&self, rng: &mut ChaCha8Rng) -> (f64, f64) {
        let logs = Interval {
            low: self.young_pa.low.ln(),
            high: self.young_pa.high.ln(),
        };
        (
            self.young_pa.clamp(logs.at(rng.random::<f64>()).exp()),
            self.poisson.at(rng.random::<f64>()),
        )
    }

    /// A random release point, by rejection; the region is never empty in a checked design.
    pub fn release(&self, rng: &mut ChaCha8Rng) -> [f64; 2] {
        loop {
            let point = [
                self.region.x_m.at(rng.random::<f64>()),
                self.region.z_m.at(rng.random::<f64>()),
            ];
            if self.region.contains(point) {
                return point;
            }
        }
    }

    /// What is wrong with the design, if anything.
    pub fn check(&self) -> Result<(), DesignError> {
        let ordered =
            |range: &Interval| range.low.is_finite() && range.high.is_finite() && range.low < range.high;
        if self.rollouts == 0 {
            return Err(DesignError::Rollouts);
        }
        if !ordered(&self.young_pa) || self.young_pa.low <= 0.0 {
            return Err(DesignError::Young);
        }
        if !ordered(&self.poisson) || self.poisson.low < 0.0 || self.poisson.high >= 0.5 {
            return Err(DesignError::Poisson);
        }
        if self.region_share() < SMALLEST_REGION_SHARE {
            return Err(DesignError::Region);
        }
        Ok(())
    }

    /// The share of the task's release ranges that the rope reaches, on a grid.
    fn region_share(&self) -> f64 {
        let steps = 40;
        let at = |range: &Interval, k: usize| range.at((k as f64 + 0.5) / steps as f64);
        let inside = (0..steps * steps)
            .filter(|k| {
                let point = [at(&self.region.x_m, k / steps), at(&self.region.z_m, k % steps)];
                self.region.contains(point)
            })
            .count();
        inside as f64 / (steps * steps) as f64
    }
}

/// A task of which the rope reaches less than this share is a mistake in its numbers.
const SMALLEST_REGION_SHARE: f64 = 0.02;

/// Why a design cannot be drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DesignError {
    /// No rollouts.
    #[error("the design has no rollouts: ask for at least one")]
    Rollouts,
    /// The range of Young's modulus.
    #[error("the range of Young's modulus must be positive, finite and not empty")]
    Young,
    /// The range of Poisson's ratio.
    #[error("the range of Poisson's ratio must lie in 0 to 0.5 and not be empty")]
    Poisson,
    /// The region of release points.
    #[error("the rope reaches almost none of the task's release points: check rope length and task")]
    Region,
}

/// The random stream of rollout `index`.
pub fn stream(seed: u64, index: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(index);
    rng
}

/// A standard normal number (Box and Muller 1958).
pub fn standard_normal(rng: &mut ChaCha8Rng) -> f64 {
    let radius = (-2.0 * libm::log(1.0 - rng.random::<f64>())).sqrt();
    radius * libm::cos(std::f64::consts::TAU * rng.random::<f64>())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collect::stand_in::design;

    #[test]
    fn samples_lie_in_the_design_and_depend_on_their_index_alone() {
        let design = design(200);
        let samples = design.samples();
        for sample in &samples {
            assert!(design.young_pa.contains(sample.young_pa));
            assert!(design.poisson.contains(sample.poisson));
            assert!(design.region.contains(sample.release_m));
            assert_eq!(*sample, design.sample(sample.index));
        }
        let soft = samples.iter().filter(|sample| sample.young_pa < 9.3e5).count();
        assert!(
            (70..130).contains(&soft),
            "log-uniform has half below the geometric mean: {soft}"
        );
        let other = Design { seed: 2, ..design };
        assert_ne!(other.sample(0), samples[0]);
    }

    #[test]
    fn a_design_that_cannot_be_drawn_is_refused() {
        let good = design(10);
        assert_eq!(good.check(), Ok(()));
        assert_eq!(Design { rollouts: 0, ..good }.check(), Err(DesignError::Rollouts));
        let mut bad = good;
        bad.region.radius_m = 0.1;
        assert_eq!(bad.check(), Err(DesignError::Region));
        let mut bad = good;
        bad.poisson.high = 0.5;
        assert_eq!(bad.check(), Err(DesignError::Poisson));
        let mut bad = good;
        bad.young_pa.low = f64::NAN;
        assert_eq!(bad.check(), Err(DesignError::Young));
    }
}
