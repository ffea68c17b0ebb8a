//! How long and how fast the networks learn.

use super::TrainError;
use crate::collect::Watch;
use crate::tell::Progress;
use serde::{Deserialize, Serialize};
use std::sync::atomic::Ordering;

/// Schedule of one network.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Schedule {
    /// Steps of the optimiser.
    pub steps: usize,
    /// Examples in one step.
    pub batch: usize,
    /// Learning rate at the start; it falls to zero along a half cosine.
    pub learning_rate: f64,
    /// Largest norm of the gradient over all weights.
    pub clip_norm: f32,
}

impl Schedule {
    /// Learning rate at `step`.
    pub(super) fn rate(&self, step: usize) -> f32 {
        let share = step as f64 / self.steps as f64;
        (self.learning_rate * 0.5 * (1.0 + (std::f64::consts::PI * share).cos())) as f32
    }

    /// Reports a step, and ends training where its loss is no number or the user asked to stop.
    pub(super) fn check(
        &self,
        stage: &'static str,
        step: usize,
        loss: f32,
        watch: Watch,
    ) -> Result<(), TrainError> {
        if watch.stop.load(Ordering::Relaxed) {
            return Err(TrainError::Stopped);
        }
        (watch.progress)(Progress {
            stage,
            done: step + 1,
            total: self.steps,
            refused: 0,
        });
        if loss.is_finite() {
            Ok(())
        } else {
            Err(TrainError::Diverged { what: stage, step })
        }
    }
}

/// How a policy is trained.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainSettings {
    /// The paper's regression.
    pub regression: Schedule,
    /// The forward model, from nothing.
    pub forward: Schedule,
    /// The correction through the forward model.
    pub correction: Schedule,
    /// Rounds in which the policy's answers are rolled out and learnt from.
    pub rounds: usize,
    /// Answers rolled out in each round.
    pub answers: usize,
    /// The forward model in a round, going on from what it knows.
    pub round_forward: Schedule,
    /// The correction in a round.
    pub round_correction: Schedule,
    /// Seed of initial weights, batches and practised goals.
    pub seed: u64,
}

/// The paper's optimiser: Adam at 1e-3, gradient norm clipped to 0.1.
const fn paper(steps: usize, batch: usize) -> Schedule {
    Schedule {
        steps,
        batch,
        learning_rate: 1e-3,
        clip_norm: 0.1,
    }
}

/// The forward model learns smooth data and may take larger steps.
const fn forward(steps: usize, batch: usize, learning_rate: f64) -> Schedule {
    Schedule {
        steps,
        batch,
        learning_rate,
        clip_norm: 1.0,
    }
}

impl TrainSettings {
    /// For about 500 rollouts: ten seconds on one core.
    pub const QUICK: Self = Self {
        regression: paper(1000, 64),
        forward: forward(1500, 128, 3e-3),
        correction: paper(2000, 128),
        rounds: 2,
        answers: 75,
        round_forward: forward(1000, 128, 1e-3),
        round_correction: paper(1000, 128),
        seed: 1,
    };

    /// For the paper's 40,000 rollouts and its 300 epochs in batches of 256: minutes.
    pub const PAPER: Self = Self {
        regression: paper(42_000, 256),
        forward: forward(20_000, 256, 3e-3),
        correction: paper(10_000, 256),
        rounds: 2,
        answers: 1000,
        round_forward: forward(5_000, 256, 1e-3),
        round_correction: paper(5_000, 256),
        seed: 1,
    };
}
