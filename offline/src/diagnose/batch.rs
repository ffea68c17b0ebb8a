//! Which refits are made side by side, and in which order: the likely effects first.

use super::round::Refit;
use super::score::{Score, ScoreTable, Subset, Untested};
use crate::effects;
use crate::fit::{FitError, flows};
use std::sync::Mutex;

/// How many refits of a batch go on after their very first evaluations: those of least cost.
const GO_ON: usize = 3;
/// An effect whose score is below this share of the best is refitted last: it is hardly the whole cause, and a later
/// round, without what another cause does in the residual, sees it better. The cameras' place is no measure: six free
/// parameters imitate a part of anything.
const LEAST_SHARE: f64 = 0.1;

/// Refits that are made side by side.
pub(super) struct Batch<'c> {
    /// What each of them adds.
    pub(super) candidates: &'c [Subset],
    /// Refits from which those of more effects may start.
    pub(super) had: &'c [Refit],
    /// How many of them at least get more than their very first evaluations.
    pub(super) go_on: usize,
    /// Least cost of what was tried before.
    pub(super) least: f64,
}

impl<'c> Batch<'c> {
    pub(super) fn of(candidates: &'c [Subset]) -> Self {
        Self {
            candidates,
            had: &[],
            go_on: GO_ON,
            least: f64::INFINITY,
        }
    }

    /// The best refit with some of a candidate's effects and no others.
    pub(super) fn fewer(&self, candidate: &Subset) -> Option<&'c Refit> {
        let fewer = self.had.iter().filter(|refit| candidate.has_more_than(refit));
        fewer.min_by(|a, b| a.cost.total_cmp(&b.cost))
    }
}

/// Effects whose refit could not be simulated, and why: the likeliest cause must not be missing without a word.
#[derive(Default)]
pub(super) struct Failures(Mutex<Vec<Untested>>);

impl Failures {
    /// What a refit came to; nothing where it failed. Of several effects together each may well have one of its own.
    pub(super) fn heard<T>(&self, candidate: &Subset, result: Result<T, FitError>) -> Option<T> {
        if let (Err(error), [id]) = (&result, candidate.ids.as_slice()) {
            let mut all = self.0.lock().expect("no thread panics with it");
            all.push(Untested {
                id: id.clone(),
                why: error.to_string(),
            });
        }
        result.ok()
    }

    /// Those without any of these refits, each once.
    pub(super) fn without(self, refits: &[Refit]) -> Vec<Untested> {
        let mut all = self.0.into_inner().expect("no thread panics with it");
        all.retain(|failed| refits.iter().all(|refit| refit.ids != [failed.id.as_str()]));
        all.sort_by(|a, b| a.id.cmp(&b.id));
        all.dedup_by(|a, b| a.id == b.id);
        all
    }
}

/// Effects worth a full refit. First the best `count` with their whole families, because only refits can tell the members
/// of one apart, and whatever the other scores hold to be free; then the others, best first; then all of
/// slight score, where anything is significant: not to try one of those that are alike would name the other. What flows
/// is never among the best: its refit takes up to four times as long, and its score, a secant's, says the least.
pub(super) fn batches(table: &ScoreTable, count: usize) -> [Vec<&Score>; 3] {
    let nuisance = |s: &Score| effects::ALL[s.effect()].nuisance;
    let best = table
        .scores
        .iter()
        .find(|s| !nuisance(s))
        .map_or(0.0, |s| s.statistic);
    let worth = |s: &Score| s.significant() && s.statistic >= LEAST_SHARE * best;
    let (all, slight): (Vec<&Score>, Vec<&Score>) = table.scores.iter().partition(|s| worth(s));
    let any = table.scores.iter().any(Score::significant);
    let slight = slight.into_iter().filter(|s| any && s.statistic > 0.0);
    let slight = slight.collect();
    let ranked = all
        .iter()
        .copied()
        .filter(|s| !(nuisance(s) || flows(s.effect())));
    let ranked: Vec<&Score> = ranked.collect();
    let alike = |s: &Score| {
        let mut best = ranked.iter().take(count);
        !flows(s.effect()) && best.any(|r| r.id == s.id || r.family.contains(&s.id))
    };
    let early = |s: &&Score| nuisance(s) || alike(s);
    let (first, others) = all.into_iter().partition(early);
    [first, others, slight]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn score(id: &str, statistic: f64, threshold: f64, family: &[&str]) -> Score {
        Score {
            family: family.iter().map(ToString::to_string).collect(),
            ..Score::alone(id, statistic, threshold)
        }
    }

    fn names(scores: &[&Score]) -> Vec<String> {
        scores.iter().map(|s| s.id.clone()).collect()
    }

    /// Seen on a rope with a tip mass: drag and friction had the better scores, and nothing else was refitted.
    #[test]
    fn every_effect_gets_its_refit_the_best_and_its_family_first() {
        let table = ScoreTable::of(vec![
            score("yield", 2300.0, 25.0, &[]),
            score("air_drag", 2263.0, 81.0, &["density_gradient"]),
            score("table_friction", 2254.0, 99.0, &[]),
            score("tip_mass", 1758.0, 106.0, &[]),
            score("density_gradient", 1453.0, 59.0, &[]),
            score("camera_offset", 800.0, 35.0, &[]),
            score("internal_damping", 795.0, 900.0, &[]),
            score("bending_ratio", 31.0, 25.0, &[]),
        ]);
        let [first, others, slight] = batches(&table, 2);
        assert_eq!(
            names(&first),
            ["air_drag", "table_friction", "density_gradient", "camera_offset"]
        );
        assert_eq!(names(&others), ["yield", "tip_mass"]);
        assert_eq!(names(&slight), ["internal_damping", "bending_ratio"]);
    }

    /// Seen on a rope in a tilted rig: damping that only a slope at zero made strong came first, wind second, and the
    /// tilt, which looks like wind, was not refitted because wind passed.
    #[test]
    fn all_that_look_like_one_of_the_best_are_tried_beside_it() {
        let table = ScoreTable::of(vec![
            score("internal_damping", 1413.0, 6.0, &[]),
            score("steady_wind", 1230.0, 31.0, &["tilted_gravity"]),
            score("tilted_gravity", 1186.0, 42.0, &["steady_wind"]),
            score("rest_curvature", 1003.0, 14.0, &[]),
        ]);
        let [first, others, _] = batches(&table, 2);
        assert_eq!(
            names(&first),
            ["internal_damping", "steady_wind", "tilted_gravity"]
        );
        assert_eq!(names(&others), ["rest_curvature"]);
    }

    /// Seen on a cable that is bent where it rests: nothing but the cameras' place was refitted.
    #[test]
    fn where_the_cameras_stand_keeps_no_effect_from_its_refit() {
        let table = ScoreTable::of(vec![
            score("camera_offset", 46376.0, 16.0, &[]),
            score("rest_curvature", 3768.0, 9.0, &[]),
            score("gripper_lag", 992.0, 6.0, &[]),
            score("tilted_gravity", 490.0, 8.0, &[]),
            score("tip_mass", 279.0, 6.0, &[]),
        ]);
        let [first, others, slight] = batches(&table, 2);
        assert_eq!(names(&first), ["camera_offset", "rest_curvature", "gripper_lag"]);
        assert_eq!(names(&others), ["tilted_gravity"]);
        assert_eq!(names(&slight), ["tip_mass"]);
    }
}
