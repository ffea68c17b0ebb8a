//! Values for the tests of this crate: a policy whose weights follow a small formula, and a blob
//! around it. Never compiled outside tests.

use crate::blob::{Blob, EffectSummary, Provenance, RopeEntry, TaskFrame};
use crate::policy::{Layer, Network, Normaliser, Policy, ReleaseRegion, Scale, TrainingRanges};
use crate::profile::MotionLimits;
use crate::task::{Interval, SwingTask};

/// A layer with weights of both signs, about as large as a trained layer's.
fn layer<const I: usize, const O: usize>(phase: f64) -> Layer<I, O> {
    let amplitude = libm::sqrt(2.0 / I as f64);
    let value = |k: usize| (amplitude * libm::sin(phase + 1.7 * k as f64)) as f32;
    let mut weights = [0.0; 256 * 128];
    for (k, weight) in weights.iter_mut().enumerate() {
        *weight = value(k);
    }
    let mut bias = [0.0; 256];
    for (k, offset) in bias.iter_mut().enumerate() {
        *offset = 0.1 * value(k + 7);
    }
    Layer::from_rows(&weights[..I * O], &bias[..O]).expect("the slices are cut to size")
}

pub(crate) fn network() -> Network {
    Network {
        first: layer(0.1),
        second: layer(0.2),
        third: layer(0.3),
        last: layer(0.4),
    }
}

pub(crate) fn normaliser() -> Normaliser {
    let scale = |mean, scale| Scale { mean, scale };
    Normaliser {
        goal_x: scale(0.33, 0.04),
        log_young: scale(14.0, 0.8),
        poisson: scale(0.3, 0.05),
        release_x: scale(0.1, 0.03),
        release_z: scale(0.16, 0.07),
    }
}

pub(crate) fn policy() -> Policy {
    let ranges = TrainingRanges {
        goal_x_m: SwingTask::PAPER.goal_x_m,
        young_pa: Interval {
            low: 2e5,
            high: 4.3e6,
        },
        poisson: Interval { low: 0.2, high: 0.4 },
    };
    let region = ReleaseRegion::new(&SwingTask::PAPER, 0.98 * 0.23);
    Policy::from_parts(network(), normaliser(), ranges, region).expect("the fixture is valid")
}

pub(crate) fn text<const N: usize>(value: &str) -> heapless::String<N> {
    heapless::String::try_from(value).expect("the fixture's names are short")
}

pub(crate) fn rope(name: &str) -> RopeEntry {
    let drag = EffectSummary {
        name: text("air drag"),
        parameter: text("normal coefficient"),
        value: 1.1,
        se: 0.2,
    };
    RopeEntry {
        name: text(name),
        young_pa: 7.3e5,
        young_se_pa: 4e3,
        poisson: 0.35,
        poisson_se: f64::INFINITY,
        poisson_identified: false,
        length_m: 0.25,
        diameter_m: 0.014,
        mass_kg: 0.0385,
        end_mass_kg: 0.004,
        reach_m: Interval {
            low: 0.27,
            high: 0.36,
        },
        effects: heapless::Vec::from_slice(&[drag]).expect("one effect fits"),
    }
}

pub(crate) fn blob() -> Blob {
    Blob {
        policy: policy(),
        ropes: heapless::Vec::from_slice(&[rope("red")]).expect("one rope fits"),
        task: SwingTask::PAPER,
        frame: TaskFrame {
            origin_m: [0.2, -0.3, 0.172],
            yaw_rad: 0.5,
        },
        motion: MotionLimits::PAPER,
        provenance: Provenance {
            demos: heapless::Vec::from_slice(&[1]).expect("one demo fits"),
            model: 2,
            dataset: 3,
            seed: 4,
            program: text("offline 0.1.0"),
        },
    }
}
