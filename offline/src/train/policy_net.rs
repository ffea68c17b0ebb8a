//! The policy while it learns: first the paper's regression on release points, then a correction
//! through the forward model, which knows where a release point leads (a distal teacher, Jordan and
//! Rumelhart 1992).

use super::TrainError;
use super::data::{Example, Examples};
use super::forward_model::ForwardModel;
use super::net::{Activation, Adam, Batch, LayerValues, Mlp, Scalar, batch, value, values};
use super::schedule::Schedule;
use crate::collect::Watch;
use crate::reach::{Practice, ReachTable};
use rand_chacha::ChaCha8Rng;
use shared::policy::{HIDDEN, INPUTS, Layer, Network, Normaliser, OUTPUTS, PolicyError, ReleaseRegion};

/// Weight of staying near the regression's answer, against the squared miss in spreads of the reach.
/// It picks one of the many release points that reach a goal and costs less than 0.1 mm.
const ANCHOR_WEIGHT: f32 = 1e-3;
/// Weight of the squared distance outside the region of release points, in spreads.
const REGION_WEIGHT: f32 = 3.0;

/// The paper's network in training.
pub struct PolicyNet {
    net: Mlp,
    normaliser: Normaliser,
}

impl PolicyNet {
    /// A policy that knows nothing yet.
    pub fn new(normaliser: Normaliser, rng: &mut ChaCha8Rng) -> Self {
        let sizes = [INPUTS, HIDDEN[0], HIDDEN[1], HIDDEN[2], OUTPUTS];
        Self {
            net: Mlp::new(&sizes, Activation::Relu, rng),
            normaliser,
        }
    }

    /// The paper's training: the release point of each rollout, given what it reached. Where several
    /// release points reach one goal this learns their mean, which need not reach it.
    pub fn regress(
        &mut self,
        examples: &Examples,
        schedule: &Schedule,
        rng: &mut ChaCha8Rng,
        watch: Watch,
    ) -> Result<(), TrainError> {
        let mut adam = Adam::new(&self.net, schedule.clip_norm);
        for step in 0..schedule.steps {
            let drawn: Vec<Example> = (0..schedule.batch).map(|_| examples.draw(rng)).collect();
            let inputs = drawn
                .iter()
                .map(|e| [e.reach, e.rope[0], e.rope[1]])
                .collect::<Vec<_>>();
            let releases = drawn.iter().map(|e| e.release).collect::<Vec<_>>();
            let error = self.net.forward(batch(&inputs)) - batch(&releases);
            let loss = error.powi_scalar(2).mean();
            schedule.check("regression", step, value(loss.clone()), watch)?;
            adam.step(&mut self.net, &loss, schedule.rate(step));
        }
        Ok(())
    }

    /// Corrects the policy until the forward model says that its answers reach their goals.
    pub fn correct(
        &mut self,
        forward: &ForwardModel,
        reach: &ReachTable,
        region: &ReleaseRegion,
        schedule: &Schedule,
        rng: &mut ChaCha8Rng,
        watch: Watch,
    ) -> Result<(), TrainError> {
        let teacher = forward.teacher();
        let anchor = self.net.frozen();
        let outside = Outside::new(&self.normaliser, region);
        let mut adam = Adam::new(&self.net, schedule.clip_norm);
        for step in 0..schedule.steps {
            let drawn: Vec<Practice> = (0..schedule.batch).map(|_| reach.draw(rng)).collect();
            let inputs = drawn
                .iter()
                .map(|p| self.normaliser.inputs(p.goal_x_m, p.young_pa, p.poisson));
            let inputs = batch(&inputs.collect::<Vec<_>>());
            let answers = self.net.forward(inputs.clone());
            let goal = inputs.clone().narrow(1, 0, 1);
            let rope = inputs.clone().narrow(1, 1, 2);
            let reached = teacher.forward(Batch::cat(vec![rope, answers.clone()], 1));
            let miss = (reached - goal).powi_scalar(2).mean();
            let stray = (answers.clone() - anchor.forward(inputs)).powi_scalar(2).mean();
            let loss =
                miss + stray.mul_scalar(ANCHOR_WEIGHT) + outside.penalty(answers).mul_scalar(REGION_WEIGHT);
            schedule.check("correction", step, value(loss.clone()), watch)?;
            adam.step(&mut self.net, &loss, schedule.rate(step));
        }
        Ok(())
    }

    /// The weights as the controller's network.
    pub fn network(&self) -> Result<Network, PolicyError> {
        let layers = self.net.layer_values();
        Ok(Network {
            first: layer(&layers[0])?,
            second: layer(&layers[1])?,
            third: layer(&layers[2])?,
            last: layer(&layers[3])?,
        })
    }

    /// Normalised outputs of the network in training, to check the exported one against.
    pub fn outputs(&self, inputs: &[[f32; INPUTS]]) -> Vec<[f32; OUTPUTS]> {
        let flat = values(self.net.frozen().forward(batch(inputs)));
        flat.chunks_exact(OUTPUTS)
            .map(|pair| [pair[0], pair[1]])
            .collect()
    }
}

fn layer<const I: usize, const O: usize>(values: &LayerValues) -> Result<Layer<I, O>, PolicyError> {
    Layer::from_rows(&values.weight, &values.bias)
}

/// The region of release points in normalised coordinates.
struct Outside {
    low: Batch,
    high: Batch,
    centre: Batch,
    spread: Batch,
    radius: f32,
}

impl Outside {
    fn new(normaliser: &Normaliser, region: &ReleaseRegion) -> Self {
        let scales = [normaliser.release_x, normaliser.release_z];
        let pair = |x: f64, z: f64| batch(&[[scales[0].normalise(x) as f32, scales[1].normalise(z) as f32]]);
        // Distances from the centre count in spreads of x along both axes, so that circles stay round.
        Self {
            low: pair(region.x_m.low, region.z_m.low),
            high: pair(region.x_m.high, region.z_m.high),
            centre: pair(region.centre_m[0], region.centre_m[1]),
            spread: batch(&[[1.0, (scales[1].scale / scales[0].scale) as f32]]),
            radius: (region.radius_m / scales[0].scale) as f32,
        }
    }

    /// Mean squared distance of answers outside the box and outside the circle.
    fn penalty(&self, answers: Batch) -> Scalar {
        let below = (self.low.clone() - answers.clone()).clamp_min(0.0);
        let above = (answers.clone() - self.high.clone()).clamp_min(0.0);
        let from_centre = (answers - self.centre.clone()) * self.spread.clone();
        let distance = from_centre.powi_scalar(2).sum_dim(1).sqrt();
        let beyond = distance.sub_scalar(self.radius).clamp_min(0.0);
        (below + above).powi_scalar(2).mean() + beyond.powi_scalar(2).mean()
    }
}
