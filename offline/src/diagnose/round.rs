//! One round of the loop: score every effect, refit in full what may be the cause, choose.

use super::choice::{Choice, Found, Standing};
use super::gates::Gate;
use super::refits::Refits;
use super::rounds::{Bench, LoopOptions, Part};
use super::score::{ScoreProblem, ScoreTable, Untested};
use crate::effects;
use crate::fit::{FitError, Library, along_rows, grid_errors};
use crate::model::{Estimate, Structure};
use crate::residual::ResidualSummary;
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
    let candidates = Refits::new(bench, now, &table, options);
    let mut choice = Choice::default();
    choice.among(bench, now, candidates.leading(progress), options, progress)?;
    if !choice.accepted() {
        let others = candidates.others(&choice.refits, progress);
        choice.among(bench, now, others, options, progress)?;
    }
    if !choice.accepted() {
        choice.among(bench, now, candidates.slight(progress), options, progress)?;
    }
    let (refits, found) = choice.end();
    let accepted = match &found {
        Found::Accepted(next) => next.last_effect(),
        Found::OnTrial(_) => None,
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
