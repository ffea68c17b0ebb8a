//! The last question to a model: whether what it found explains as much without the effects that may be nothing.
//!
//! Likelihoods count noise alone. Where the simulation itself is off, as of a rope that yields, by as much as the noise,
//! further effects imitate that error and are needed, as far as a likelihood can tell: relaxation and a bending ratio beside
//! a yield that explained everything. Their standard errors, in which the grid's part is counted last, hold nothing.

use super::bench::Bench;
use super::choice::Standing;
use super::gates::clear_of_nothing;
use super::revise::{refitted_without, rivals_of_less};
use super::score::Invariance;
use super::verdict::{ReasonCode, Verdict};
use crate::effects;
use crate::fit::{Evaluation, FitError, estimates_within};
use crate::model::{Estimate, Structure};
use crate::tell::Tell;

/// A model and what is concluded of it.
pub(super) struct Judged {
    pub(super) model: Standing,
    /// What it leaves where held out.
    pub(super) held_out: Evaluation,
    /// How far the simulation's own error may have moved each entry of θ.
    pub(super) grid_shift: Vec<f64>,
    /// How its effects fare in parts of what was fitted.
    pub(super) invariances: Vec<Invariance>,
    pub(super) verdict: Verdict,
    pub(super) reasons: Vec<ReasonCode>,
}

impl Judged {
    /// Parameters, with what the simulation's own error may have moved in their standard errors.
    fn estimates(&self) -> Vec<Estimate> {
        let Standing {
            fitted, structure, ..
        } = &self.model;
        estimates_within(&fitted.best, structure, &self.grid_shift)
    }

    /// Whether its effects are called the cause.
    fn explains(&self) -> bool {
        matches!(
            self.verdict,
            Verdict::Explained { .. } | Verdict::Confounded { .. }
        )
    }

    /// Effects that may be nothing, where others are not.
    fn nothing_beside_something(&self) -> Vec<usize> {
        let all = self.estimates();
        let structure = &self.model.structure;
        let clear =
            |&&effect: &&usize| clear_of_nothing(&effects::ALL[effect], &all[structure.entries(effect)]);
        let (something, nothing): (Vec<&usize>, Vec<&usize>) = structure.effects.iter().partition(clear);
        if something.is_empty() {
            return Vec::new();
        }
        nothing.into_iter().copied().collect()
    }
}

/// An explanation without those of its effects that may be nothing, as far as it still is one, and their names; all at
/// once if that may be, else one after the other.
pub(super) fn leaner(
    bench: &Bench,
    mut judged: Judged,
    judge: &dyn Fn(Standing) -> Result<Judged, FitError>,
    progress: &dyn Tell,
) -> (Judged, Vec<String>) {
    let mut dropped = Vec::new();
    while judged.explains() {
        let nothing = judged.nothing_beside_something();
        let alone = nothing.iter().map(|&effect| vec![effect]);
        let all = (nothing.len() > 1).then(|| nothing.clone());
        let found = all.into_iter().chain(alone).find_map(|gone| {
            let ids = Structure {
                effects: gone.clone(),
            }
            .ids();
            progress.say(&format!(
                "asking whether {} explains anything",
                effects::together(&ids)
            ));
            let smaller = refitted_without(bench, &judged.model, &gone)?;
            let rivals = rivals_of_less(bench, &smaller, judged.model.rivals.clone(), progress);
            let smaller = judge(Standing { rivals, ..smaller }).ok()?;
            smaller.explains().then_some((smaller, ids))
        });
        let Some((smaller, ids)) = found else { break };
        dropped.extend(ids);
        judged = smaller;
    }
    (judged, dropped)
}

#[cfg(test)]
mod tests {
    use super::super::revise::tests::{options, recorded, with};
    use super::*;
    use crate::bench_diagnosis::reality::part;
    use crate::tell::Silent;

    /// A loss of next to nothing beside a tilt goes, but not where the tilt alone explains too little.
    #[test]
    fn what_may_be_nothing_goes_where_the_rest_explains() {
        let demos = recorded(&[part("tilted_gravity", 8.0)]);
        let bench = Bench::new(&[&demos[0]], &[&demos[1]], &options()).unwrap();
        let stays = |alone_explains: bool| {
            let judge = |model: Standing| {
                let explains = alone_explains || model.structure.effects.len() > 1;
                let hint = String::new();
                Ok(Judged {
                    held_out: model.fitted.best.clone(),
                    grid_shift: vec![0.0; model.fitted.best.theta.len()],
                    invariances: Vec::new(),
                    verdict: if explains {
                        Verdict::Explained {
                            effects: model.structure.ids(),
                            parameters: Vec::new(),
                        }
                    } else {
                        Verdict::Unexplained { hint }
                    },
                    reasons: Vec::new(),
                    model,
                })
            };
            let both = judge(with(&bench, &["internal_damping", "tilted_gravity"])).unwrap();
            let (judged, dropped) = leaner(&bench, both, &judge, &Silent);
            (judged.model.structure.ids(), dropped)
        };
        let names = |ids: &[&str]| ids.iter().map(ToString::to_string).collect::<Vec<_>>();
        let (tilt, loss) = (names(&["tilted_gravity"]), names(&["internal_damping"]));
        assert_eq!(stays(true), (tilt.clone(), loss.clone()));
        assert_eq!(stays(false), ([loss, tilt].concat(), Vec::new()));
    }
}
