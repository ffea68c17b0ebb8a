//! One round of the loop: score every effect, refit the leading ones in full, gate them, choose.

use super::choice::{Found, Standing, Tried, choose};
use super::conclude::explains;
use super::gates::{Gate, given_up, statistical_gates};
use super::rounds::{Bench, LoopOptions, Part};
use super::score::{Score, ScoreProblem, ScoreTable, Untested};
use crate::effects;
use crate::fit::{
    Budget, FitError, FitResult, Library, StopReason, along_rows, descend, estimates, fit_from,
    fit_from_first, flows, grid_errors,
};
use crate::model::{Estimate, Structure};
use crate::residual::ResidualSummary;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// A full refit with one more effect.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Refit {
    /// Name of the effect.
    pub id: String,
    /// Parameters of the effect.
    pub parameters: Vec<Estimate>,
    /// All parameters of the model, as the fit takes them.
    pub theta: Vec<f64>,
    /// Residual where fitted.
    pub fit: ResidualSummary,
    /// Residual where held out.
    pub held_out: ResidualSummary,
    /// Gates in the order in which they were tried.
    pub gates: Vec<Gate>,
    /// Whether all gates were passed.
    pub passed: bool,
}

/// One round of the loop.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Round {
    /// Effects of the model at the start of the round.
    pub known: Vec<String>,
    /// Scores of the others.
    pub table: ScoreTable,
    /// Refits of the best.
    pub refits: Vec<Refit>,
    /// The effect that was accepted.
    pub accepted: Option<String>,
    /// Effects of the model at the start that it needs no more beside the one that was accepted.
    #[serde(default)]
    pub dropped: Vec<String>,
}

/// How many of the best scores are told while the loop runs.
const LISTED: usize = 8;
/// Most evaluations of a refit: it starts from a one-step estimate.
pub(super) const REFIT_EVALUATIONS: usize = 24;
/// Evaluations after which a refit that has come less than half as far as the best is given up.
const HEAT_EVALUATIONS: usize = 8;
/// Cost over the least of its rivals at which a refit is given up.
const HOPELESS: f64 = 2.0;
/// Cost over the least of its rivals up to which a refit whose evaluations are spent goes on beside the best.
const NEAR_THE_BEST: f64 = 1.5;
/// Evaluations after which only [`GO_ON`] of the effects with lesser scores go on.
const SPRINT_EVALUATIONS: usize = 3;
/// How many of them go on: those of least cost.
const GO_ON: usize = 3;
/// Sizes of an effect, as multiples of the one-step estimate, at which a refit starts: the first that is better than
/// nothing. From a rope far off a one-step estimate overshoots, as far as to ropes that cannot be simulated.
const FIRST_SIZES: [f64; 3] = [1.0, 0.25, 0.0625];
/// Sizes of an effect, as multiples of the one-step estimate, at which refits start again where none explains what is
/// left.
const OTHER_SIZES: [f64; 2] = [0.25, 4.0];
/// Evaluations after which such a start is given up if it has not come further than the first.
const SECOND_EVALUATIONS: usize = 4;
/// An effect whose score is below this share of the best is refitted last: it is hardly the whole cause, and a later
/// round, without what another cause does in the residual, sees it better. The cameras' place is no measure: six free
/// parameters imitate a part of anything.
const LEAST_SHARE: f64 = 0.1;

pub(super) fn one_round(
    bench: &Bench,
    now: &Standing,
    options: &LoopOptions,
    progress: &dyn Fn(&str),
) -> Result<(Round, Found, Library), FitError> {
    let (structure, fitted) = (&now.structure, &now.fitted);
    progress("scoring every effect of the library from one pass of tangents");
    let (table, library) = score(bench, structure, &fitted.best.theta, options)?;
    let listed = table.scores.iter().take(LISTED);
    let listed: Vec<String> = listed
        .map(|s| format!("{} {:.0} (of {:.0})", s.id, s.statistic, s.threshold))
        .collect();
    progress(&format!("best scores (needed): {}", listed.join(", ")));
    let tried = refit_leading(bench, structure, fitted, (&table, &now.held), options, progress);
    let (refits, found) = choose(
        bench,
        tried,
        &ResidualSummary::of(&fitted.best),
        options,
        progress,
    )?;
    let accepted = match &found {
        Found::Accepted(next) => next.last_effect(),
        Found::InCompany(_) | Found::Nothing => None,
    };
    let round = Round {
        known: structure.ids(),
        table,
        refits,
        accepted,
        dropped: Vec::new(),
    };
    Ok((round, found, library))
}

/// Refits the leading effects and, unless one that passes leaves nothing to explain, all others that are worth it:
/// those that look like it to first order are among the first. The score holds to first order only: where the base model
/// is far off, the cause may well be tenth. Where nothing passes in the first round, it may even have a slight score:
/// damping that only a slope at zero makes strong had thirteen times that of a density gradient of 0.8, the cause.
fn refit_leading(
    bench: &Bench,
    structure: &Structure,
    fitted: &FitResult,
    (table, held_now): (&ScoreTable, &ResidualSummary),
    options: &LoopOptions,
    progress: &dyn Fn(&str),
) -> Vec<Tried> {
    let now = ResidualSummary::of(&fitted.best);
    let batches = leading(table, options.refits);
    if batches.iter().all(Vec::is_empty) {
        progress("refitting with nothing: no effect is significant");
    }
    let mut tried: Vec<Tried> = Vec::new();
    let passed = |tried: &Tried| tried.0.passed;
    let explained = |tried: &Tried| {
        passed(tried) && explains(&now, &tried.2, bench.doubt(&tried.2), table.discretisation_mm)
    };
    for (number, batch) in batches.iter().enumerate() {
        let last = number + 1 == batches.len();
        let enough = |tried: &Tried| if last { passed(tried) } else { explained(tried) };
        // A model that has an effect already is near enough for scores to be right about the others.
        if tried.iter().any(enough) || (last && !structure.effects.is_empty()) {
            break;
        }
        if batch.is_empty() {
            continue;
        }
        progress(&format!("refitting with {}", names(batch).join(", ")));
        let go_on = if number == 0 { batch.len() } else { GO_ON };
        // What failed is no measure of what is tried because it did.
        let least = match last {
            true => f64::INFINITY,
            false => tried.iter().map(|t| t.2.cost).fold(f64::INFINITY, f64::min),
        };
        let heats = heats(bench, structure, fitted, batch, (go_on, HOPELESS * least));
        let least = heats.iter().map(|h| h.1.cost).fold(least, f64::min);
        let judged =
            |score: &Score, fit| judge(bench, structure, (score, fit), (&now, held_now), options).ok();
        let ended = heats.into_par_iter().map(|(score, fit)| {
            (
                score,
                to_the_end(bench, &structure.with(score.effect()), fit, least),
            )
        });
        let ended = best_to_rest(bench, structure, ended.collect());
        let mut ended: Vec<(&Score, Tried)> = ended
            .into_par_iter()
            .filter_map(|(score, fit)| Some((score, judged(score, fit)?)))
            .collect();
        if !ended.iter().any(|(_, tried)| explained(tried)) {
            progress("none of them explains it: starting them elsewhere");
            ended.par_iter_mut().for_each(|(score, tried)| {
                let better = from_elsewhere(bench, structure, fitted, score, [tried.2.cost, least]);
                if let Some(better) = better.and_then(|fit| judged(score, fit)) {
                    *tried = better;
                }
            });
        }
        if last {
            from_where_one_passed(bench, structure, &mut ended, &judged);
        }
        tried.extend(ended.into_iter().map(|(_, tried)| tried));
    }
    tried
}

/// A refit from other starts where one of them comes to less than `cost`, at which the first ended: that was a local
/// minimum then. None is tried for a refit that came less than half as far as the best. A model that lacks a strong
/// effect is far off in everything, and so is a one-step estimate from there.
fn from_elsewhere(
    bench: &Bench,
    structure: &Structure,
    fitted: &FitResult,
    score: &Score,
    [cost, least]: [f64; 2],
) -> Option<FitResult> {
    if cost > HOPELESS * least {
        return None;
    }
    let next = structure.with(score.effect());
    let others = OTHER_SIZES.par_iter().filter_map(|&size| {
        let theta = start(fitted, structure, score, size);
        let budget = Budget {
            evaluations: SECOND_EVALUATIONS,
            worth: cost,
        };
        fit_from(&bench.fit, &next, theta, budget).ok()
    });
    let best = others.min_by(|a, b| a.cost.total_cmp(&b.cost))?;
    let rest = Budget::from(REFIT_EVALUATIONS - SECOND_EVALUATIONS);
    (best.cost < cost).then(|| further(bench, &next, best, rest))
}

/// Refits again from the model's own parameters in the best refit that passed, where they promise to come near its cost:
/// the rope that one effect found may be the cause's as well, and the way there from a model that is far off is a matter
/// of luck. A tip mass was never found where a density gradient was.
fn from_where_one_passed(
    bench: &Bench,
    structure: &Structure,
    ended: &mut [(&Score, Tried)],
    judged: &(dyn Fn(&Score, FitResult) -> Option<Tried> + Sync),
) {
    let passed = ended
        .iter()
        .map(|(_, tried)| tried)
        .filter(|tried| tried.0.passed);
    let Some(best) = passed.min_by(|a, b| a.2.cost.total_cmp(&b.2.cost)) else {
        return;
    };
    let own = best.2.best.theta[..structure.parameters().len()].to_vec();
    let budget = Budget {
        evaluations: REFIT_EVALUATIONS,
        worth: HOPELESS * best.2.cost,
    };
    ended.par_iter_mut().for_each(|(score, tried)| {
        let nothing = effects::ALL[score.effect()].vanishing();
        let start = own.iter().copied().chain(nothing).collect();
        let again = fit_from(&bench.fit, &structure.with(score.effect()), start, budget);
        let better = again.ok().filter(|fit| fit.cost < tried.2.cost);
        if let Some(better) = better.and_then(|fit| judged(score, fit)) {
            *tried = better;
        }
    });
}

/// Effects worth a full refit. First the best `count`, the whole family of the best, because only refits can
/// tell its members apart, and whatever the other scores hold to be free; then the others, best first; then all of
/// slight score, where anything is significant: not to try one of those that are alike would name the other. What flows
/// is never among the best: its refit takes up to four times as long, and its score, a secant's, says the least.
fn leading(table: &ScoreTable, count: usize) -> [Vec<&Score>; 3] {
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
    let family: &[String] = ranked.first().map_or(&[], |best| &best.family);
    let early =
        |s: &&Score| nuisance(s) || family.contains(&s.id) || ranked.iter().take(count).any(|r| r.id == s.id);
    let (first, others) = all.into_iter().partition(early);
    [first, others, slight]
}

fn names(scores: &[&Score]) -> Vec<String> {
    scores.iter().map(|s| s.id.clone()).collect()
}

fn score(
    bench: &Bench,
    structure: &Structure,
    theta: &[f64],
    options: &LoopOptions,
) -> Result<(ScoreTable, Library), FitError> {
    let (asked, on_the_way): (Vec<usize>, Vec<usize>) = options
        .missing(structure)
        .partition(|&index| bench.fit.knows(index));
    let (library, difference) = rayon::join(
        || bench.fit.library(structure, theta, &asked),
        || grid_errors([&bench.fit, &bench.finer], structure, theta),
    );
    let (library, difference) = (library?, difference?);
    let evaluation = &library.evaluation;
    let errors = along_rows(evaluation, &difference);
    let sigmas: Vec<f64> = evaluation.all_rows().map(|r| r.sigma_m).collect();
    let nuisances = options.without != Some(Part::Nuisances);
    let problem = ScoreProblem::new(evaluation, &library.structure, structure, &bench.noise, nuisances);
    let mut table = problem.table(&errors, &sigmas, options.seed);
    table.untested = on_the_way
        .into_iter()
        .map(|effect| {
            (
                effect,
                "where a rope hangs that gives way depends on how it got there".to_owned(),
            )
        })
        .chain(
            library
                .failed
                .iter()
                .map(|(effect, error)| (*effect, error.to_string())),
        )
        .map(|(effect, why)| Untested {
            id: effects::ALL[effect].id.into(),
            why,
        })
        .collect();
    Ok((table, library))
}

/// θ of a fit where the data told it, the prior's centre where they did not: what a model that lacks an effect
/// makes of the rest, often a value at its bound, is a bad start for one that has it.
fn told(fitted: &FitResult, structure: &Structure) -> Vec<f64> {
    let all = estimates(&fitted.best, structure);
    let start = all.iter().zip(&fitted.best.theta).zip(structure.parameters());
    start
        .map(|((estimate, &theta), info)| {
            if estimate.identified {
                theta
            } else {
                info.prior_mean
            }
        })
        .collect()
}

/// The first evaluations of refits; where there are more than `go_on`, the others do not get all of them. A refit that
/// does not promise to come down to the cost `worth` is given up.
fn heats<'a>(
    bench: &Bench,
    structure: &Structure,
    fitted: &FitResult,
    batch: &[&'a Score],
    (go_on, worth): (usize, f64),
) -> Vec<(&'a Score, FitResult)> {
    let budget = |evaluations| Budget { evaluations, worth };
    let sprint = if batch.len() > go_on {
        budget(SPRINT_EVALUATIONS)
    } else {
        budget(HEAT_EVALUATIONS)
    };
    let mut runners: Vec<(&Score, FitResult)> = batch
        .par_iter()
        .filter_map(|score| Some((*score, started(bench, structure, fitted, score, sprint).ok()?)))
        .collect();
    if batch.len() <= go_on {
        return runners;
    }
    runners.sort_by(|a, b| a.1.cost.total_cmp(&b.1.cost));
    let behind = runners.split_off(go_on.min(runners.len()));
    let more = budget(HEAT_EVALUATIONS - SPRINT_EVALUATIONS);
    let ahead = runners
        .into_par_iter()
        .map(|(score, fit)| (score, further(bench, &structure.with(score.effect()), fit, more)));
    let mut heats: Vec<(&Score, FitResult)> = ahead.collect();
    heats.extend(behind);
    heats
}

/// Where a refit starts: at the one-step estimate, as many times as large as `larger` says.
fn start(fitted: &FitResult, structure: &Structure, score: &Score, larger: f64) -> Vec<f64> {
    let mut theta = told(fitted, structure);
    for (p, e) in effects::ALL[score.effect()]
        .parameters
        .iter()
        .zip(&score.estimate)
    {
        // A one-step estimate can overshoot; half the physical range is a safe start.
        let safe = [p.low, p.high].map(|end| 0.5 * (end + p.vanishes_at));
        theta.push((p.vanishes_at + larger * e).clamp(safe[0], safe[1]));
    }
    theta
}

/// The very first evaluations of a refit, from the one-step estimate, or nearer to nothing where that is worse than
/// nothing; at worst from the model as it stands.
fn started(
    bench: &Bench,
    structure: &Structure,
    fitted: &FitResult,
    score: &Score,
    budget: Budget,
) -> Result<FitResult, FitError> {
    let next = structure.with(score.effect());
    let sizes = FIRST_SIZES.map(|size| start(fitted, structure, score, size));
    let nothing = effects::ALL[score.effect()].vanishing();
    let standing = fitted.best.theta.iter().copied().chain(nothing).collect();
    let starts = sizes.into_iter().chain([standing]);
    fit_from_first(&bench.fit, &next, starts, fitted.cost, budget)
}

/// The other evaluations, where there is hope that they find the least cost.
fn to_the_end(bench: &Bench, structure: &Structure, fit: FitResult, least: f64) -> FitResult {
    let budget = Budget {
        evaluations: REFIT_EVALUATIONS - HEAT_EVALUATIONS,
        worth: HOPELESS * least,
    };
    if fit.cost > budget.worth {
        return fit;
    }
    further(bench, structure, fit, budget)
}

/// The best of some refits, and those that may still come as far, go on with as many evaluations again: along the narrow
/// valley of stiffness and yield a descent takes thirty, and what it has not yet come to looks as if the effect did not
/// explain it.
fn best_to_rest<'a>(
    bench: &Bench,
    structure: &Structure,
    fits: Vec<(&'a Score, FitResult)>,
) -> Vec<(&'a Score, FitResult)> {
    let least = fits.iter().map(|fit| fit.1.cost).fold(f64::INFINITY, f64::min);
    let go_on = |(score, fit): (&'a Score, FitResult)| {
        if fit.cost > NEAR_THE_BEST * least {
            return (score, fit);
        }
        let next = structure.with(score.effect());
        (score, further(bench, &next, fit, REFIT_EVALUATIONS.into()))
    };
    fits.into_par_iter().map(go_on).collect()
}

/// More evaluations for a fit that could not end with those that it had.
fn further(bench: &Bench, structure: &Structure, fit: FitResult, budget: Budget) -> FitResult {
    if fit.stop != StopReason::BudgetSpent {
        return fit;
    }
    descend(&bench.fit, structure, fit.best, budget)
}

/// What became of a refit.
fn judge(
    bench: &Bench,
    structure: &Structure,
    (score, result): (&Score, FitResult),
    before: (&ResidualSummary, &ResidualSummary),
    options: &LoopOptions,
) -> Result<Tried, FitError> {
    let next = structure.with(score.effect());
    let spec = &effects::ALL[score.effect()];
    let held_out = bench.held_out.residuals(&next, &result.best.theta)?;
    let all = estimates(&result.best, &next);
    let first = all.len() - spec.parameters.len();
    let mut refit = Refit {
        id: spec.id.into(),
        parameters: all[first..].to_vec(),
        theta: result.best.theta.clone(),
        fit: ResidualSummary::of(&result.best),
        held_out: ResidualSummary::of(&held_out),
        gates: Vec::new(),
        passed: false,
    };
    let held = bench.fit.out_of_plane(&next, &result.best);
    let free = held[first..].iter().filter(|&&held| !held).count();
    refit.gates = statistical_gates(score, before, (&refit, free), options);
    if result.stop == StopReason::GivenUp {
        refit.gates.insert(0, given_up(result.evaluations));
    }
    refit.passed = refit.gates.iter().all(|g| g.passed);
    Ok((refit, next, result))
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

    fn table(scores: Vec<Score>) -> ScoreTable {
        ScoreTable {
            scores,
            discretisation_mm: 0.0,
            untested: Vec::new(),
        }
    }

    /// Seen on a rope with a tip mass: drag and friction had the better scores, and nothing else was refitted.
    #[test]
    fn every_effect_gets_its_refit_the_best_and_its_family_first() {
        let table = table(vec![
            score("yield", 2300.0, 25.0, &[]),
            score("air_drag", 2263.0, 81.0, &["density_gradient"]),
            score("table_friction", 2254.0, 99.0, &[]),
            score("tip_mass", 1758.0, 106.0, &[]),
            score("density_gradient", 1453.0, 59.0, &[]),
            score("camera_offset", 800.0, 35.0, &[]),
            score("internal_damping", 795.0, 900.0, &[]),
            score("bending_ratio", 31.0, 25.0, &[]),
        ]);
        let [first, others, slight] = leading(&table, 2);
        assert_eq!(
            names(&first),
            ["air_drag", "table_friction", "density_gradient", "camera_offset"]
        );
        assert_eq!(names(&others), ["yield", "tip_mass"]);
        assert_eq!(names(&slight), ["internal_damping", "bending_ratio"]);
    }

    /// Seen on a cable that is bent where it rests: nothing but the cameras' place was refitted.
    #[test]
    fn where_the_cameras_stand_keeps_no_effect_from_its_refit() {
        let table = table(vec![
            score("camera_offset", 46376.0, 16.0, &[]),
            score("rest_curvature", 3768.0, 9.0, &[]),
            score("gripper_lag", 992.0, 6.0, &[]),
            score("tilted_gravity", 490.0, 8.0, &[]),
            score("tip_mass", 279.0, 6.0, &[]),
        ]);
        let [first, others, slight] = leading(&table, 2);
        assert_eq!(names(&first), ["camera_offset", "rest_curvature", "gripper_lag"]);
        assert_eq!(names(&others), ["tilted_gravity"]);
        assert_eq!(names(&slight), ["tip_mass"]);
    }
}
