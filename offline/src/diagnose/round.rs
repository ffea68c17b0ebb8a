//! One round of the loop: score every effect, refit in full what may be the cause, choose.

use super::accounted::excess_mm;
use super::bench::Bench;
use super::choice::{Choice, Standing};
use super::gates::Gate;
use super::memory::KeptModel;
use super::refits::Refits;
use super::rounds::LoopOptions;
use super::score::{MOST_MEMBERS, ScoreProblem, ScoreTable, Subset, Untested, discretisation_mm};
use crate::effects;
use crate::fit::{FitError, Library};
use crate::model::{Estimate, Structure};
use crate::residual::ResidualSummary;
use crate::tell::Tell;
use serde::{Deserialize, Serialize};

/// A full refit with one more effect, or several at once.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Refit {
    /// Names of the effects.
    pub ids: Vec<String>,
    /// Their parameters, effect after effect.
    pub parameters: Vec<Estimate>,
    /// All parameters of the model, as the fit takes them.
    pub theta: Vec<f64>,
    /// What the fit made least: half the robust sum of squares, in noise floors, plus the prior's.
    #[serde(default)]
    pub cost: f64,
    /// Residual where fitted.
    pub fit: ResidualSummary,
    /// Residual where held out.
    pub held_out: ResidualSummary,
    /// Gates in the order in which they were tried.
    pub gates: Vec<Gate>,
    /// Whether all gates were passed.
    pub passed: bool,
}

impl Refit {
    /// One more question that decides whether it passes.
    pub(super) fn ask(&mut self, gates: Vec<Gate>) {
        self.passed &= gates.iter().all(|gate| gate.passed);
        self.gates.extend(gates);
    }

    /// What it leaves and where it failed, for whoever watches.
    pub(super) fn in_brief(&self) -> String {
        let failed = self.gates.iter().filter(|gate| !gate.passed);
        let failed: Vec<&str> = failed.map(|gate| gate.name.as_str()).collect();
        let failed = if failed.is_empty() {
            String::new()
        } else {
            format!(" (not {})", failed.join(", "))
        };
        let [fit_mm, held_out_mm] = [&self.fit, &self.held_out].map(|left| left.rms_mm);
        format!(
            "{} {fit_mm:.2}, {held_out_mm:.2}{failed}",
            effects::together(&self.ids)
        )
    }
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
    /// The effects that were accepted: one, several that pass only together, or none.
    pub accepted: Vec<String>,
    /// Nothing was refitted, because what the model with its effects leaves is no more than the simulation's own error.
    #[serde(default)]
    pub only_numerical: bool,
    /// Effects of the model at the start that it needs no more beside those that were accepted.
    #[serde(default)]
    pub dropped: Vec<String>,
    /// Effects that went in the end: within their last standard errors they may be nothing, and the rest explains.
    #[serde(default)]
    pub nothing: Vec<String>,
    /// Effects that were accepted here at first, from which the loop did not come as far.
    #[serde(default)]
    pub instead_of: Vec<String>,
}

/// What a round came to.
pub(super) struct Turn {
    pub(super) round: Round,
    /// The model with what was accepted.
    pub(super) next: Option<Standing>,
    /// The model with what passed second.
    pub(super) second: Option<KeptModel>,
    /// The slopes of the whole library.
    pub(super) library: Library,
}

/// How many of the best scores are told while the loop runs.
const LISTED: usize = 8;

/// A round on a model.
pub(super) fn one_round(
    bench: &Bench,
    now: &Standing,
    options: &LoopOptions,
    progress: &dyn Tell,
) -> Result<Turn, FitError> {
    let (structure, fitted) = (&now.structure, &now.fitted);
    progress.say("scoring every effect of the library from one pass of tangents");
    let (mut table, library) = score(bench, structure, &fitted.best.theta, options)?;
    tell(&table, progress);
    let left_mm = excess_mm(&now.left, bench.doubt(&fitted.best));
    progress.say(&format!(
        "{:.2} mm are left where fitted, {left_mm:.2} of them beyond the noise; the simulation's own error there is {:.2} mm",
        now.left.rms_mm, table.discretisation_mm
    ));
    // The base model's slight effects are asked for all the same: they may be the rope's.
    let only_numerical = !structure.effects.is_empty() && left_mm <= table.discretisation_mm;
    let choice = if only_numerical {
        Choice::default()
    } else {
        refitted(bench, now, &mut table, options, progress)
    };
    let (accepted, next) = choice.accepted.unzip();
    let round = Round {
        known: structure.ids(),
        table,
        refits: choice.refits,
        accepted: accepted.unwrap_or_default(),
        only_numerical,
        dropped: Vec::new(),
        nothing: Vec::new(),
        instead_of: Vec::new(),
    };
    Ok(Turn {
        round,
        next,
        second: choice.second,
        library,
    })
}

/// The refits of a round, the likely ones first, until one is accepted; effects that could not be refitted go to the table.
fn refitted(
    bench: &Bench,
    now: &Standing,
    table: &mut ScoreTable,
    options: &LoopOptions,
    progress: &dyn Tell,
) -> Choice {
    let candidates = Refits::new(bench, now, table, options);
    let mut choice = Choice {
        only_numerical: candidates.only_numerical(),
        ..Choice::default()
    };
    choice.among(bench, now, candidates.leading(progress), options, progress);
    if choice.accepted.is_none() {
        let others = candidates.others(&choice.refits, progress);
        choice.among(bench, now, others, options, progress);
    }
    if choice.accepted.is_none() {
        choice.among(bench, now, candidates.slight(progress), options, progress);
    }
    for members in 2..=MOST_MEMBERS {
        if choice.accepted.is_none() {
            let together = candidates.together(members, &choice.refits, progress);
            choice.among(bench, now, together, options, progress);
        }
    }
    let failures = candidates.failures.without(&choice.refits);
    table.untested.extend(failures);
    choice
}

/// The best scores, for whoever watches.
fn tell(table: &ScoreTable, progress: &dyn Tell) {
    let tell = |what: &str, all: Vec<Subset>| {
        let told = all.iter().take(LISTED);
        let told = told.map(|c| format!("{} {:.0} (of {:.0})", c.name(), c.statistic, c.threshold));
        progress.say(&format!(
            "best {what} (needed): {}",
            told.collect::<Vec<_>>().join(", ")
        ));
    };
    tell("scores", table.scores.iter().map(Subset::from).collect());
    if !table.subsets.is_empty() {
        tell("together", table.subsets.clone());
    }
}

/// Scores every effect that a model lacks, and the slopes of the whole library at it.
pub(super) fn score(
    bench: &Bench,
    structure: &Structure,
    theta: &[f64],
    options: &LoopOptions,
) -> Result<(ScoreTable, Library), FitError> {
    let (mut asked, mut untold) = (Vec::new(), Vec::new());
    for effect in options.missing(structure) {
        match bench.fit.untold(effect) {
            None => asked.push(effect),
            Some(why) => untold.push((effect, why.to_owned())),
        }
    }
    let library = bench.fit.library(structure, theta, &asked)?;
    let evaluation = &library.evaluation;
    let errors = bench.fit.grid_errors(evaluation);
    let nuisances = options.nuisances();
    let problem = ScoreProblem::new(evaluation, &library.structure, structure, &bench.noise, nuisances);
    let discretisation_mm = discretisation_mm(evaluation, structure, &errors);
    let mut table = problem.table(errors, discretisation_mm, options.seed);
    table.untested = untold
        .into_iter()
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
