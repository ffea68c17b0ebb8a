//! A policy file made in code: an untrained network over the paper's task. Tests and the benchmark
//! use it where no identified rope is at hand; its motions are as long as a trained policy's.

use shared::arm::DEFAULT_TASK_FRAME;
use shared::blob::{Blob, Provenance, RopeEntry};
use shared::policy::{
    HIDDEN, INPUTS, Layer, Network, Normaliser, OUTPUTS, Policy, ReleaseRegion, Scale, TrainingRanges,
};
use shared::profile::MotionLimits;
use shared::task::{Interval, SwingTask};

/// Length of the sample rope, m.
const LENGTH_M: f64 = 0.25;

/// Weights of both signs, about as large as a trained layer's, from a formula.
fn layer<const I: usize, const O: usize>(phase: f64) -> Layer<I, O> {
    let amplitude = (2.0 / I as f64).sqrt();
    let value = |k: usize| (amplitude * (phase + 1.7 * k as f64).sin()) as f32;
    let weights: Vec<f32> = (0..I * O).map(value).collect();
    let bias: Vec<f32> = (0..O).map(|k| 0.1 * value(k + 7)).collect();
    Layer::from_rows(&weights, &bias).expect("the slices have the layer's size")
}

fn policy(task: &SwingTask) -> Policy {
    let network = Network {
        first: layer::<INPUTS, { HIDDEN[0] }>(0.1),
        second: layer::<{ HIDDEN[0] }, { HIDDEN[1] }>(0.2),
        third: layer::<{ HIDDEN[1] }, { HIDDEN[2] }>(0.3),
        last: layer::<{ HIDDEN[2] }, OUTPUTS>(0.4),
    };
    let scale = |mean, scale| Scale { mean, scale };
    let normaliser = Normaliser {
        goal_x: scale(0.33, 0.04),
        log_young: scale(14.0, 0.8),
        poisson: scale(0.3, 0.05),
        release_x: scale(0.1, 0.03),
        release_z: scale(0.16, 0.07),
    };
    let ranges = TrainingRanges {
        goal_x_m: task.goal_x_m,
        young_pa: Interval {
            low: 2e5,
            high: 4.3e6,
        },
        poisson: Interval { low: 0.2, high: 0.4 },
    };
    let region = ReleaseRegion::new(task, 0.98 * task.free_length_m(LENGTH_M));
    Policy::from_parts(network, normaliser, ranges, region).expect("the sample policy is valid")
}

fn rope() -> RopeEntry {
    RopeEntry {
        name: "sample".try_into().expect("a short name"),
        young_pa: 7.3e5,
        young_se_pa: 4e3,
        poisson: 0.35,
        poisson_se: f64::INFINITY,
        poisson_identified: false,
        length_m: LENGTH_M,
        diameter_m: 0.014,
        mass_kg: 0.0385,
        end_mass_kg: 0.0,
        reach_m: Interval {
            low: 0.275,
            high: 0.40,
        },
        effects: Default::default(),
    }
}

/// The sample policy file in the default task frame.
pub fn blob() -> Box<Blob> {
    let task = SwingTask::PAPER;
    Box::new(Blob {
        policy: policy(&task),
        ropes: [rope()].into_iter().collect(),
        task,
        frame: DEFAULT_TASK_FRAME,
        motion: MotionLimits::PAPER,
        provenance: Provenance {
            demos: Default::default(),
            model: 0,
            dataset: 0,
            seed: 0,
            program: "sample".try_into().expect("a short name"),
        },
    })
}
