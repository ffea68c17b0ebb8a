//! Where the result touches the rollout: the derivatives that enter the way back.

use super::state::StateCotangent;
use super::{Cotangent, Precision};
use crate::sim::lanes::Lanes;
use crate::sim::real::Arithmetic;
use crate::sim::rollout::{FrameMark, Recorder, Rollout};
use crate::sim::rope::RopeLayout;

/// Derivatives of the result with respect to frames and reach, with the states they came from.
pub(super) struct Seeds {
    cotangent: Cotangent,
    /// Of the frames that are still to come on the way back.
    marks: Vec<FrameMark>,
    reach_state: usize,
    /// Of the last slice and of the one before in the tip.
    end_weights: [f64; 2],
}

impl Seeds {
    pub(super) fn new<F: Precision>(
        cotangent: Cotangent,
        recorder: &Recorder<F>,
        rollout: &Rollout<F>,
        layout: &RopeLayout,
    ) -> Self {
        let points = |frame: usize| rollout.frames.get(frame).map(Vec::len);
        let fits = cotangent.frames.is_empty()
            || cotangent.frames.len() == rollout.frames.len()
                && (0..rollout.frames.len()).all(|f| points(f) == Some(cotangent.frames[f].len()));
        assert!(fits, "one derivative per point of every frame");
        Self {
            marks: recorder.marks[..cotangent.frames.len()].to_vec(),
            reach_state: recorder.reach_state,
            end_weights: layout.end_weights(),
            cotangent,
        }
    }

    /// Adds what the result takes from the state after `state` steps of a rope of `slices` slices, each
    /// with `members` particles.
    pub(super) fn add<L: Lanes>(
        &mut self,
        state: usize,
        (slices, members): (usize, usize),
        bars: &mut [StateCotangent<L>],
    ) {
        let share = 1.0 / members as f64;
        let lanes = |block: usize, weight: &dyn Fn(usize) -> f64| {
            L::from_lanes(|lane| {
                let slice = block * L::COUNT + lane;
                L::Scalar::of(if slice < slices { weight(slice) } else { 0.0 })
            })
        };
        while let Some(mark) = self.marks.pop_if(|mark| mark.state == state) {
            let frame = &self.cotangent.frames[self.marks.len()];
            for (block, bars) in bars.chunks_mut(members).enumerate() {
                for k in 0..3 {
                    let place = lanes(block, &|slice| share * frame[slice][k]);
                    for bar in &mut *bars {
                        bar.position[k] += place;
                        bar.velocity[k] += place.scale(mark.ahead_s);
                    }
                }
            }
        }
        if state == self.reach_state && self.cotangent.reach != 0.0 {
            let reach = std::mem::take(&mut self.cotangent.reach) * share;
            let end_weights = self.end_weights;
            let weight = |slice: usize| match slices - slice {
                from_end @ 1..=2 => end_weights[from_end - 1] * reach,
                _ => 0.0,
            };
            for (block, bars) in bars.chunks_mut(members).enumerate() {
                let x = lanes(block, &weight);
                for bar in bars {
                    bar.position[0] += x;
                }
            }
        }
    }
}
