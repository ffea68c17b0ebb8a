//! A learned forward model: how far a rope swings from a release point. It answers in microseconds what
//! the simulator answers in a fraction of a second, and has a gradient, so a policy can learn from it.

use super::TrainError;
use super::data::{Example, Examples};
use super::net::{Activation, Adam, Batch, Mlp, batch, value, values};
use super::schedule::Schedule;
use crate::collect::Watch;
use rand_chacha::ChaCha8Rng;
use shared::policy::{Normaliser, ReleaseRegion};
use shared::task::Interval;

/// Smooth activations: the policy follows the slope of this network.
const SIZES: [usize; 5] = [4, 64, 64, 64, 1];
/// Steps of the grid of release points on which extremes are sought, in x and in z.
const GRID: [usize; 2] = [16, 32];

/// Reach as a function of rope and release point.
pub struct ForwardModel {
    net: Mlp,
    normaliser: Normaliser,
}

impl ForwardModel {
    /// A model that knows nothing yet.
    pub fn new(normaliser: Normaliser, rng: &mut ChaCha8Rng) -> Self {
        Self {
            net: Mlp::new(&SIZES, Activation::Silu, rng),
            normaliser,
        }
    }

    /// Learns from `examples`, going on from what it knows.
    pub fn learn(
        &mut self,
        examples: &Examples,
        schedule: &Schedule,
        rng: &mut ChaCha8Rng,
        watch: Watch,
    ) -> Result<(), TrainError> {
        let mut adam = Adam::new(&self.net, schedule.clip_norm);
        for step in 0..schedule.steps {
            let drawn: Vec<Example> = (0..schedule.batch).map(|_| examples.draw(rng)).collect();
            let error = self.net.forward(inputs(&drawn)) - targets(&drawn);
            let loss = error.powi_scalar(2).mean();
            schedule.check("forward model", step, value(loss.clone()), watch)?;
            adam.step(&mut self.net, &loss, schedule.rate(step));
        }
        Ok(())
    }

    /// Root mean square error on examples, m.
    pub fn rms_m(&self, examples: &[Example]) -> f64 {
        if examples.is_empty() {
            return 0.0;
        }
        let error = self.net.forward(inputs(examples)) - targets(examples);
        let square: f64 = values(error).iter().map(|error| f64::from(*error).powi(2)).sum();
        self.normaliser.goal_x.scale * (square / examples.len() as f64).sqrt()
    }

    /// The model as a constant that passes gradients on: normalised (ln E, ν, x, z) to normalised reach.
    pub fn teacher(&self) -> Mlp {
        self.net.frozen()
    }

    /// Predicted reach in m of each release point in m, for one rope.
    pub fn reach_m(&self, young_pa: f64, poisson: f64, releases_m: &[[f64; 2]]) -> Vec<f64> {
        let [_, log_young, ratio] = self.normaliser.inputs(0.0, young_pa, poisson);
        let rows: Vec<[f32; 4]> = releases_m
            .iter()
            .map(|release| {
                let x = self.normaliser.release_x.normalise(release[0]) as f32;
                let z = self.normaliser.release_z.normalise(release[1]) as f32;
                [log_young, ratio, x, z]
            })
            .collect();
        let outputs = values(self.net.frozen().forward(batch(&rows)));
        outputs
            .iter()
            .map(|output| self.normaliser.goal_x.restore(f64::from(*output)))
            .collect()
    }

    /// The reaches in m that release points of `region` are predicted to give for one rope.
    pub fn reachable_m(&self, young_pa: f64, poisson: f64, region: &ReleaseRegion) -> Interval {
        let reaches = self.reach_m(young_pa, poisson, &grid(region));
        Interval {
            low: reaches.iter().copied().fold(f64::INFINITY, f64::min),
            high: reaches.iter().copied().fold(f64::NEG_INFINITY, f64::max),
        }
    }
}

/// Points of a grid over `region`, its boundary included.
fn grid(region: &ReleaseRegion) -> Vec<[f64; 2]> {
    let mut points = Vec::new();
    for i in 0..=GRID[0] {
        for k in 0..=GRID[1] {
            let x = region.x_m.at(i as f64 / GRID[0] as f64);
            let z = region.z_m.at(k as f64 / GRID[1] as f64);
            points.push(region.project([x, z]));
        }
    }
    points
}

fn inputs(examples: &[Example]) -> Batch {
    let rows = examples
        .iter()
        .map(|e| [e.rope[0], e.rope[1], e.release[0], e.release[1]]);
    batch(&rows.collect::<Vec<_>>())
}

fn targets(examples: &[Example]) -> Batch {
    batch(&examples.iter().map(|example| [example.reach]).collect::<Vec<_>>())
}
