//! Makes the demonstration that a diagnosis proposes where it left models alike, and fits those models anew
//! to both: does it resolve the ambiguity? Only G2 can play a motion that was not planned beforehand.
//!
//! What is asked anew is only which of the models left alike is true, by the same rule by which they were
//! alike; the library is not scored again.

use super::cells::Cell;
use super::reality::{Finer, Reality};
use super::sight::see_again;
use super::truth::Truth;
use crate::demo::Demo;
use crate::diagnose::{LoopOptions, NextDemonstration, Outcome, proposed_demo, separating, still_alike};
use serde::{Deserialize, Serialize};

/// What came of a proposal.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FollowUp {
    /// Name of the motion that was proposed; none where none of them would help.
    pub proposed: Option<String>,
    /// Power that it was said to have; of the best motion where none was proposed.
    pub power: Option<f64>,
    /// Effects of the models that are still alike with the new demonstration, the best first.
    pub left: Vec<Vec<String>>,
    /// Why the demonstration could not be made or fitted.
    pub failed: Option<String>,
}

impl FollowUp {
    /// Whether one model is left and it is the true one; none where no demonstration was proposed.
    pub fn resolves(&self, causes: &[String]) -> Option<bool> {
        self.proposed.as_ref()?;
        let [only] = &self.left[..] else {
            return Some(false);
        };
        Some(only.len() == causes.len() && causes.iter().all(|cause| only.contains(cause)))
    }
}

/// Added to the seed of a cell's noise for the demonstration that follows.
const SEED_APART: u64 = 1_000_003;

/// Follows the proposal of a diagnosis of the fitted and the held-out demonstrations of a cell; none where
/// no models were left alike, or where the reality cannot play on.
pub fn follow_up(
    cell: &Cell,
    truth: &Truth,
    [fitted, held_out]: [&[&Demo]; 2],
    outcome: &Outcome,
    options: &LoopOptions,
) -> Option<FollowUp> {
    if cell.world != Finer.name() || cell.hidden || cell.without.is_some() {
        return None;
    }
    let next = separating(fitted, held_out, outcome, options)?;
    let powers = next.motions.iter().filter_map(|m| m.power);
    let mut found = FollowUp {
        proposed: next.proposed.clone(),
        power: powers.max_by(f64::total_cmp),
        left: Vec::new(),
        failed: None,
    };
    match make(cell, truth, fitted, outcome, &next) {
        None => {}
        Some(Err(error)) => found.failed = Some(error),
        Some(Ok(demo)) => {
            let demos: Vec<&Demo> = fitted.iter().copied().chain([&demo]).collect();
            match still_alike(&demos, outcome, options) {
                Ok(left) => found.left = left,
                Err(error) => found.failed = Some(error.to_string()),
            }
        }
    }
    Some(found)
}

/// The proposed demonstration as G2 plays it, noise and all.
fn make(
    cell: &Cell,
    truth: &Truth,
    fitted: &[&Demo],
    outcome: &Outcome,
    next: &NextDemonstration,
) -> Option<Result<Demo, String>> {
    let mut demo = proposed_demo(fitted[0], outcome, next)?;
    let seed = cell.noise_seed().wrapping_add(SEED_APART);
    Some(Finer.play(truth.young_pa, &truth.parts, &demo).map(|track| {
        see_again(cell, &mut demo, &track, seed);
        demo
    }))
}
