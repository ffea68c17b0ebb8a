//! A policy on its way: regression, correction through the forward model, and rounds on its own answers.

use super::data::{Examples, normaliser};
use super::forward_model::ForwardModel;
use super::policy_net::PolicyNet;
use super::{TrainError, TrainSettings};
use crate::collect::{Dataset, Design, Sample, Watch, stream};
use crate::reach::{Practice, ReachTable};
use crate::trained::{ForwardErrors, Trained, TrainingRecord};
use rand_chacha::ChaCha8Rng;
use shared::policy::{INPUTS, Normaliser, Policy, TrainingRanges};

/// Random streams of training lie above all indices of rollouts.
const FIRST_STREAM: u64 = 1 << 40;
/// Streams of one round: one for each thing that is drawn.
const STREAMS_PER_ROUND: u64 = 4;
/// Goals on which the exported network is compared with the trained one.
const EXPORT_CHECKS: usize = 256;
/// Largest difference allowed there, in spreads: sums in another order, nothing more.
const EXPORT_TOLERANCE: f32 = 1e-4;

/// What is drawn from a random stream of its own.
enum Draws {
    Policy,
    Forward,
    Correction,
    Practice,
}

/// A policy in training.
pub struct Learner {
    design: Design,
    settings: TrainSettings,
    dataset: Dataset,
    normaliser: Normaliser,
    forward: ForwardModel,
    net: PolicyNet,
    regression: Box<Policy>,
    reach: ReachTable,
    forward_errors: Vec<ForwardErrors>,
    round_miss_mm: Vec<Option<f64>>,
}

impl Learner {
    /// Learns from the random design: regression, forward model, correction.
    pub fn start(
        design: &Design,
        dataset: Dataset,
        settings: &TrainSettings,
        watch: Watch,
    ) -> Result<Self, TrainError> {
        let normaliser = normaliser(&dataset)?;
        let examples = Examples::new(&dataset, normaliser);
        let mut rng = draws(settings, 0, Draws::Policy);
        let mut net = PolicyNet::new(normaliser, &mut rng);
        net.regress(&examples, &settings.regression, &mut rng, watch)?;
        let mut rng = draws(settings, 0, Draws::Forward);
        let mut forward = ForwardModel::new(normaliser, &mut rng);
        forward.learn(&examples, &settings.forward, &mut rng, watch)?;
        let reach = reach_table(&forward, design);
        let regression = export(&net, design, normaliser, &reach)?;
        let mut rng = draws(settings, 0, Draws::Correction);
        net.correct(
            &forward,
            &reach,
            &design.region,
            &settings.correction,
            &mut rng,
            watch,
        )?;
        Ok(Self {
            design: *design,
            settings: *settings,
            forward_errors: vec![forward_errors(&forward, &examples)],
            round_miss_mm: Vec::new(),
            dataset,
            normaliser,
            forward,
            net,
            regression,
            reach,
        })
    }

    /// Goals for which answers are rolled out in `round`.
    pub fn practice(&self, round: usize) -> Vec<Practice> {
        let mut rng = draws(&self.settings, round, Draws::Practice);
        (0..self.settings.answers)
            .map(|_| self.reach.draw(&mut rng))
            .collect()
    }

    /// The present policy's answers as rollouts to make.
    pub fn answers(&self, practice: &[Practice]) -> Result<Vec<Sample>, TrainError> {
        let policy = export(&self.net, &self.design, self.normaliser, &self.reach)?;
        let answer = |(index, goal): (usize, &Practice)| Sample {
            index: index as u64,
            young_pa: goal.young_pa,
            poisson: goal.poisson,
            release_m: policy.release_point_m(goal.goal_x_m, goal.young_pa, goal.poisson),
        };
        Ok(practice.iter().enumerate().map(answer).collect())
    }

    /// Learns from what the answers of `round` led to.
    pub fn absorb(
        &mut self,
        round: usize,
        practice: &[Practice],
        answers: Dataset,
        watch: Watch,
    ) -> Result<(), TrainError> {
        self.round_miss_mm.push(mean_miss_mm(practice, &answers));
        self.dataset.rows.extend(answers.rows);
        let examples = Examples::new(&self.dataset, self.normaliser);
        let settings = &self.settings;
        let mut rng = draws(settings, round, Draws::Forward);
        self.forward
            .learn(&examples, &settings.round_forward, &mut rng, watch)?;
        self.forward_errors.push(forward_errors(&self.forward, &examples));
        self.reach = reach_table(&self.forward, &self.design);
        let mut rng = draws(settings, round, Draws::Correction);
        let (forward, region) = (&self.forward, &self.design.region);
        self.net.correct(
            forward,
            &self.reach,
            region,
            &settings.round_correction,
            &mut rng,
            watch,
        )
    }

    /// The trained policy, after a check that the exported network computes what the trained one does.
    pub fn finish(self) -> Result<Trained, TrainError> {
        let policy = export(&self.net, &self.design, self.normaliser, &self.reach)?;
        Ok(Trained {
            record: TrainingRecord {
                seed: self.settings.seed,
                forward: self.forward_errors.clone(),
                round_miss_mm: self.round_miss_mm.clone(),
                export_difference: self.export_difference(&policy)?,
            },
            policy,
            regression: self.regression,
            reach: self.reach,
            dataset: self.dataset.summary(),
        })
    }

    fn export_difference(&self, policy: &Policy) -> Result<f32, TrainError> {
        let mut rng = draws(&self.settings, 0, Draws::Practice);
        let inputs: Vec<[f32; INPUTS]> = (0..EXPORT_CHECKS)
            .map(|_| self.reach.draw(&mut rng))
            .map(|goal| self.normaliser.inputs(goal.goal_x_m, goal.young_pa, goal.poisson))
            .collect();
        let mut largest = 0f32;
        for (input, expected) in inputs.iter().zip(self.net.outputs(&inputs)) {
            let found = policy.network().forward(input);
            for (found, expected) in found.iter().zip(expected) {
                largest = largest.max((found - expected).abs());
            }
        }
        if largest <= EXPORT_TOLERANCE {
            Ok(largest)
        } else {
            Err(TrainError::Export(largest))
        }
    }
}

fn draws(settings: &TrainSettings, round: usize, what: Draws) -> ChaCha8Rng {
    let index = FIRST_STREAM + STREAMS_PER_ROUND * round as u64 + what as u64;
    stream(settings.seed, index)
}

fn reach_table(forward: &ForwardModel, design: &Design) -> ReachTable {
    ReachTable::new(design.young_pa, design.poisson, |young_pa, poisson| {
        let reachable = forward.reachable_m(young_pa, poisson, &design.region);
        reachable.within(&design.goal_x_m)
    })
}

/// Boxed, and in a frame of its own: the copies made on the way take several times the policy's 150 KB.
#[inline(never)]
fn export(
    net: &PolicyNet,
    design: &Design,
    normaliser: Normaliser,
    reach: &ReachTable,
) -> Result<Box<Policy>, TrainError> {
    let ranges = TrainingRanges {
        goal_x_m: reach.all_goals_m(),
        young_pa: design.young_pa,
        poisson: design.poisson,
    };
    let policy = Policy::from_parts(net.network()?, normaliser, ranges, design.region)?;
    Ok(Box::new(policy))
}

fn forward_errors(forward: &ForwardModel, examples: &Examples) -> ForwardErrors {
    ForwardErrors {
        training_rms_mm: 1e3 * forward.rms_m(&examples.training),
        validation_rms_mm: 1e3 * forward.rms_m(&examples.validation),
    }
}

fn mean_miss_mm(practice: &[Practice], answers: &Dataset) -> Option<f64> {
    let misses: Vec<f64> = answers
        .rows
        .iter()
        .zip(practice)
        .filter_map(|(row, goal)| Some(1e3 * (row.reach_m.as_ref().ok()? - goal.goal_x_m).abs()))
        .collect();
    (!misses.is_empty()).then(|| misses.iter().sum::<f64>() / misses.len() as f64)
}
