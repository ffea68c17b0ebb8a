//! Models that fit as well as the one that a loop has come to: what tied with an effect of an earlier round may do so
//! still, beside what was found since.

use super::bench::Bench;
use super::choice::{Standing, Tried, ties};
use super::gates::within_ranges;
use super::memory::KeptModel;
use super::refits::Refits;
use super::round::{Refit, Round};
use super::rounds::LoopOptions;
use super::score::{ScoreTable, Subset};
use crate::effects;
use crate::fit::estimates;
use crate::model::Structure;
use crate::tell::Tell;

/// The rivals of the model `before` that fit as well as the model `next`, which a round made of that, or better, once they
/// are extended as it was. What was accepted has to pass the gates beside them too. They are not extended by what ties
/// with it: every model here differs from `next` in what one round found.
pub(super) fn still_rivals(
    bench: &Bench,
    before: &Standing,
    next: &Standing,
    round: &Round,
    options: &LoopOptions,
    progress: &dyn Tell,
) -> Vec<KeptModel> {
    let Some(extension) = Extension::of(round) else {
        return Vec::new();
    };
    let may = |rival: &&KeptModel| {
        let with_that = [&rival.effects[..], &round.accepted].concat();
        // A model that needs an earlier effect no more is a part of that effect's rivals with what took its place.
        !round.accepted.iter().any(|id| rival.effects.contains(id))
            && !has_all(&with_that, &next.structure.ids())
    };
    let asked = before.rivals.iter().filter(may);
    let alike = asked.filter_map(|rival| {
        let name = effects::together(&rival.effects);
        progress.say(&format!("asking whether {name} does as well with that"));
        let one = extension.of_rival(bench, rival, options)?;
        (one.refit.passed && is_physical(&one) && ties(&next.fitted, &one.fitted)).then(|| {
            progress.say(&format!("{name} does"));
            KeptModel::of(&Standing::judged(one.structure, one.fitted, one.refit.held_out))
        })
    });
    alike.collect()
}

/// A model that another way came to, where it fits as well as `model`, is not among its rivals, and neither has all of
/// the other's effects.
pub(super) fn by_another_way(model: &Standing, other: &Standing) -> Option<KeptModel> {
    let (own, others) = (model.structure.ids(), other.structure.ids());
    let nested = has_all(&own, &others) || has_all(&others, &own);
    let known = |rival: &KeptModel| has_all(&rival.effects, &others) && has_all(&others, &rival.effects);
    let new = !nested && !model.rivals.iter().any(known);
    (new && ties(&model.fitted, &other.fitted)).then(|| KeptModel::of(other))
}

fn has_all(one: &[String], of: &[String]) -> bool {
    of.iter().all(|id| one.contains(id))
}

/// What a round accepted.
struct Extension<'r> {
    candidate: Subset,
    refit: &'r Refit,
    table: &'r ScoreTable,
    known: Structure,
}

impl<'r> Extension<'r> {
    fn of(round: &'r Round) -> Option<Self> {
        let refit = round.refits.iter().find(|refit| refit.ids == round.accepted)?;
        let table = &round.table;
        let mut all = table.scores.iter().map(Subset::from).chain(table.subsets.clone());
        Some(Self {
            candidate: all.find(|subset| subset.ids == round.accepted)?,
            refit,
            table,
            known: Structure::of_ids(&round.known),
        })
    }

    /// A rival that is extended alike; none where that cannot be simulated.
    fn of_rival(&self, bench: &Bench, rival: &KeptModel, options: &LoopOptions) -> Option<Tried> {
        let rival = rival.again(bench).ok()?;
        Refits::new(bench, &rival, self.table, options).like(&self.candidate, self.refit, &self.known)
    }
}

fn is_physical(tried: &Tried) -> bool {
    within_ranges(&tried.structure, &estimates(&tried.fitted.best, &tried.structure))
}

#[cfg(test)]
mod tests {
    use super::super::revise::tests::{options, passed, recorded, standing, with};
    use super::super::score::Score;
    use super::*;
    use crate::bench_diagnosis::reality::part;
    use crate::tell::Silent;

    /// Effects of the rivals that are left once a tilt of so many units, with which a wind tied, is joined by a lag.
    fn left(tilt: f64) -> Vec<Vec<String>> {
        let demos = recorded(&[part("tilted_gravity", tilt), part("gripper_lag", 7.0)]);
        let options = options();
        let bench = Bench::new(&[&demos[0]], &[&demos[1]], &options).unwrap();
        let before = Standing {
            rivals: vec![KeptModel::of(&with(&bench, &["steady_wind"]))],
            ..with(&bench, &["tilted_gravity"])
        };
        let next = with(&bench, &["tilted_gravity", "gripper_lag"]);
        let round = Round {
            known: before.structure.ids(),
            table: ScoreTable::of(vec![Score::alone("gripper_lag", 60.0, 20.0)]),
            refits: vec![passed(&next)],
            accepted: vec!["gripper_lag".into()],
            dropped: Vec::new(),
            nothing: Vec::new(),
            only_numerical: false,
            instead_of: Vec::new(),
        };
        let rivals = still_rivals(&bench, &before, &next, &round, &options, &Silent);
        rivals.into_iter().map(|rival| rival.effects).collect()
    }

    /// A table that leans a little and a slight wind look alike, with and without a lag; one that leans more does not.
    #[test]
    fn what_tied_before_another_cause_was_found_may_tie_beside_it() {
        assert_eq!(left(1.5), [["steady_wind", "gripper_lag"]]);
        assert!(left(8.0).is_empty());
    }

    /// Ways may come to one model by different turns, to more of it, to what is known to fit as well, or to less.
    #[test]
    fn what_another_way_came_to_is_a_rival_where_it_is_another_model_that_fits_as_well() {
        let tilt = standing(&["tilted_gravity", "gripper_lag"], 2.0);
        let other = |ids: &[&str], rms_mm: f64| by_another_way(&tilt, &standing(ids, rms_mm)).is_some();
        assert!(other(&["steady_wind", "gripper_lag"], 2.01));
        assert!(!other(&["steady_wind", "gripper_lag"], 4.0));
        assert!(!other(&["gripper_lag", "tilted_gravity"], 2.0));
        assert!(!other(&["gripper_lag"], 2.0));
        assert!(!other(&["gripper_lag", "tilted_gravity", "tip_mass"], 2.0));
        let wind = standing(&["steady_wind", "gripper_lag"], 2.01);
        let known = Standing {
            rivals: vec![KeptModel::of(&wind)],
            ..tilt
        };
        assert!(by_another_way(&known, &wind).is_none());
    }
}
