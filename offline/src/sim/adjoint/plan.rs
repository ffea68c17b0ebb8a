//! What of a rollout is kept for the way back, within a budget of memory.
//!
//! The way back needs, at every step, the velocities of the nodes after the step: from them a
//! particle's velocity and affine field follow, and with these its position and deformation gradient
//! can be undone. That is 3 numbers per node and step instead of 24 per particle and step, about a
//! tenth. Undoing rounds, so the whole state is kept at the start of every segment and taken from
//! there when the way back arrives. Node velocities are kept for as many of the last segments as the
//! budget allows; the others are simulated once more, from their checkpoint, when they are needed, in
//! the memory that the last segment has left by then.

use crate::sim::error::Cause;

/// Shortest segment, steps: undoing that many steps loses some 10⁻⁶ in single precision.
const SHORTEST: usize = 64;

/// Segments of a rollout.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Plan {
    /// Steps per segment; the last may be shorter.
    pub(super) segment: usize,
    /// Number of segments.
    pub(super) segments: usize,
    /// Segments from here on keep their node velocities on the way forward.
    pub(super) kept_from: usize,
    /// Memory that this takes, bytes.
    pub(super) bytes: usize,
}

impl Plan {
    /// The plan that simulates the fewest steps twice. `state_bytes` is the size of a checkpoint,
    /// `nodes_bytes` that of the node velocities of a step.
    pub(super) fn new(
        steps: usize,
        state_bytes: usize,
        nodes_bytes: usize,
        budget_bytes: usize,
    ) -> Result<Self, Cause> {
        let mut best: Option<(usize, Self)> = None;
        let mut least = usize::MAX;
        let mut segment = SHORTEST;
        loop {
            let segments = steps.div_ceil(segment).max(1);
            let tape = segment.min(steps) * nodes_bytes;
            let checkpoints = segments * state_bytes;
            least = least.min(checkpoints + tape);
            if checkpoints + tape <= budget_bytes {
                let kept = ((budget_bytes - checkpoints) / tape.max(1)).min(segments);
                let again = (segments - kept) * segment;
                if best.is_none_or(|(fewest, _)| again < fewest) {
                    let plan = Self {
                        segment,
                        segments,
                        kept_from: segments - kept,
                        bytes: checkpoints + kept * tape,
                    };
                    best = Some((again, plan));
                }
            }
            if segment >= steps {
                break;
            }
            segment *= 2;
        }
        best.map(|(_, plan)| plan).ok_or(Cause::Memory {
            needed_bytes: least,
            budget_bytes,
        })
    }

    /// The steps of a segment.
    pub(super) fn range(&self, segment: usize, steps: usize) -> std::ops::Range<usize> {
        segment * self.segment..((segment + 1) * self.segment).min(steps)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plan_stays_within_its_budget_and_covers_every_step() {
        for steps in [0, 1, 63, 64, 65, 2000, 20_000] {
            for budget in [3_000_000, 30_000_000, 300_000_000] {
                let Ok(plan) = Plan::new(steps, 400_000, 40_000, budget) else {
                    continue;
                };
                assert!(plan.bytes <= budget, "{plan:?}");
                let covered: usize = (0..plan.segments).map(|s| plan.range(s, steps).len()).sum();
                assert_eq!(covered, steps, "{plan:?}");
                assert!(
                    plan.kept_from < plan.segments,
                    "the last segment is kept: {plan:?}"
                );
            }
        }
    }

    #[test]
    fn nothing_is_simulated_twice_where_memory_allows() {
        let plan = Plan::new(2000, 400_000, 40_000, 256 << 20).unwrap();
        assert_eq!((plan.kept_from, plan.segment), (0, SHORTEST));
    }

    #[test]
    fn a_budget_that_is_too_small_is_refused_with_what_is_needed() {
        let error = Plan::new(2000, 400_000, 40_000, 1_000_000).unwrap_err();
        let Cause::Memory { needed_bytes, .. } = error else {
            panic!("{error}");
        };
        assert!(Plan::new(2000, 400_000, 40_000, needed_bytes).is_ok());
        assert!(Plan::new(2000, 400_000, 40_000, needed_bytes - 1).is_err());
    }
}
