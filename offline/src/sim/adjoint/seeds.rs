//! Where the result touches the rollout: the derivatives that enter the way back.

use super::{Cotangent, Float, State};
use crate::sim::rollout::{FrameMark, Recorder, Rollout};

/// Derivatives of the result with respect to frames and reach, with the states they came from.
pub(super) struct Seeds {
    cotangent: Cotangent,
    /// Of the frames that are still to come on the way back.
    marks: Vec<FrameMark>,
    reach_state: usize,
}

impl Seeds {
    pub(super) fn new<F: Float>(cotangent: Cotangent, recorder: &Recorder<F>, rollout: &Rollout<F>) -> Self {
        let points = |frame: usize| rollout.frames.get(frame).map(Vec::len);
        let fits = cotangent.frames.is_empty()
            || cotangent.frames.len() == rollout.frames.len()
                && (0..rollout.frames.len()).all(|f| points(f) == Some(cotangent.frames[f].len()));
        assert!(fits, "one derivative per point of every frame");
        Self {
            marks: recorder.marks[..cotangent.frames.len()].to_vec(),
            reach_state: recorder.reach_state,
            cotangent,
        }
    }

    /// Adds what the result takes from the state after `state` steps.
    pub(super) fn add<F: Float>(&mut self, state: usize, section: usize, bars: &mut [State<F>]) {
        let share = 1.0 / section as f64;
        while let Some(mark) = self.marks.pop_if(|mark| mark.state == state) {
            let frame = &self.cotangent.frames[self.marks.len()];
            for (slice, point) in bars.chunks_mut(section).zip(frame) {
                for bar in slice {
                    for k in 0..3 {
                        let value = share * point[k];
                        bar.position_m[k] += F::of(value);
                        bar.velocity_m_s[k] += F::of(value * mark.ahead_s);
                    }
                }
            }
        }
        if state == self.reach_state && self.cotangent.reach != 0.0 {
            // The tip is 3/2 of the last slice's middle less 1/2 of the one before.
            let reach = std::mem::take(&mut self.cotangent.reach) * share;
            let n = bars.len();
            for (index, bar) in bars.iter_mut().enumerate().skip(n - 2 * section) {
                let weight = if index < n - section { -0.5 } else { 1.5 };
                bar.position_m[0] += F::of(weight * reach);
            }
        }
    }
}
