//! Fits from one start or several, and the best iterate of all.

use super::cost::total_cost;
use super::descent::{Budget, Descent, FitResult};
use super::problem::{FitError, Problem};
use crate::model::Structure;
use crate::tell::{Pieces, Silent, Tell};
use rayon::prelude::*;

/// Settings of a fit.
#[derive(Clone, Debug, PartialEq)]
pub struct FitOptions {
    /// Young's moduli of the starts, Pa, increasing.
    pub starts_pa: Vec<f64>,
    /// How many of the starts are followed to the end: those with the least cost, of moduli first those that cost less
    /// than their neighbours.
    pub followed: usize,
    /// Most evaluations of one descent.
    pub max_evaluations: usize,
}

impl Default for FitOptions {
    /// Sixteen starts over the paper's range and a decade beyond, the best two followed. They are a factor of 1.3 apart:
    /// a rope that falls on the table fits in several valleys of E, the right one no wider than from 0.75 to 1.1 MPa.
    fn default() -> Self {
        Self {
            starts_pa: (0..16).map(|k| 0.1e6 * 1.3_f64.powi(k)).collect(),
            followed: 2,
            max_evaluations: 12,
        }
    }
}

/// A valley that costs so many times as much as the cheapest start is none to descend into.
const HOPELESS: f64 = 10.0;

/// Fits from several starts and returns the best iterate of all.
///
/// # Errors
/// No start can be simulated, or too little was measured.
pub fn fit(problem: &Problem, structure: &Structure, options: &FitOptions) -> Result<FitResult, FitError> {
    fit_and_tell(problem, structure, options, &Silent)
}

/// The same, telling how far it has come.
///
/// # Errors
/// As [`fit`].
pub fn fit_and_tell(
    problem: &Problem,
    structure: &Structure,
    options: &FitOptions,
    tell: &dyn Tell,
) -> Result<FitResult, FitError> {
    let starts = options.starts_pa.iter().map(|&pa| structure.start(pa)).collect();
    let mut scored = scored(problem, structure, starts, tell);
    let costs: Vec<f64> = scored.iter().map(Result::as_ref).map(cost).collect();
    let least = costs.iter().copied().fold(f64::INFINITY, f64::min);
    for (k, start) in scored.iter_mut().enumerate() {
        let neighbours = [k.checked_sub(1), Some(k + 1)];
        let lower = |other: usize| costs.get(other).is_some_and(|&other| other < costs[k]);
        if let Ok(start) = start {
            let is_low = start.cost <= HOPELESS * least;
            start.in_valley = is_low && !neighbours.into_iter().flatten().any(lower);
        }
    }
    follow(scored, structure, options, tell)
}

/// Fits from the given θ and returns the best iterate of all; `options.starts_pa` is not used.
///
/// # Errors
/// No start can be simulated, or too little was measured.
pub fn fit_starts(
    problem: &Problem,
    structure: &Structure,
    starts: Vec<Vec<f64>>,
    options: &FitOptions,
) -> Result<FitResult, FitError> {
    follow(
        scored(problem, structure, starts, &Silent),
        structure,
        options,
        &Silent,
    )
}

/// A start that can be simulated.
struct Scored<'a> {
    cost: f64,
    theta: Vec<f64>,
    /// Settled there.
    here: Problem<'a>,
    /// Whether no neighbour costs less: another one leads to another end.
    in_valley: bool,
}

fn cost(start: Result<&Scored, &FitError>) -> f64 {
    start.map_or(f64::INFINITY, |start| start.cost)
}

/// What each start costs.
fn scored<'a>(
    problem: &Problem<'a>,
    structure: &Structure,
    starts: Vec<Vec<f64>>,
    tell: &dyn Tell,
) -> Vec<Result<Scored<'a>, FitError>> {
    let info = structure.parameters();
    let pieces = Pieces::of(tell, "starts", starts.len());
    let score = |theta: Vec<f64>| {
        let here = problem.settled(structure, &theta)?;
        let residuals = here.residuals_as_begun(structure, &theta)?;
        Ok(Scored {
            cost: total_cost(&residuals, &info),
            theta,
            here,
            in_valley: false,
        })
    };
    let scored = starts.into_par_iter().map(|theta| pieces.ended(score(theta)));
    scored.collect()
}

/// Descends from the best starts, and of the others from as many again for as long as no slope could be found at any.
fn follow(
    scored: Vec<Result<Scored, FitError>>,
    structure: &Structure,
    options: &FitOptions,
    tell: &dyn Tell,
) -> Result<FitResult, FitError> {
    let (mut starts, mut failure) = (Vec::new(), None);
    for start in scored {
        match start {
            Ok(start) => starts.push(start),
            Err(error) => failure = failure.or(Some(error)),
        }
    }
    starts.sort_by(|a, b| b.in_valley.cmp(&a.in_valley).then(a.cost.total_cmp(&b.cost)));
    let mut best: Option<FitResult> = None;
    let mut ends = Vec::new();
    let mut starts = starts.into_iter();
    while best.is_none() {
        let followed: Vec<_> = starts.by_ref().take(options.followed.max(1)).collect();
        if followed.is_empty() {
            break;
        }
        let descend = |start: Scored| {
            let descent = Descent::of(start.here, structure, &start.theta)?;
            Ok(descent.run(options.max_evaluations).finish())
        };
        let pieces = Pieces::of(tell, "descents", followed.len());
        let descents = followed.into_par_iter().map(|start| pieces.ended(descend(start)));
        let results: Vec<_> = descents.collect();
        for result in results {
            match result {
                Ok(r) => {
                    ends.push((r.best.theta[0], r.cost));
                    if best.as_ref().is_none_or(|b| r.cost < b.cost) {
                        best = Some(r);
                    }
                }
                Err(error) => failure = Some(error),
            }
        }
    }
    match (best, failure) {
        (Some(best), _) => Ok(FitResult { ends, ..best }),
        (None, Some(error)) => Err(error),
        (None, None) => Err(FitError::NoStart("no start was given".into())),
    }
}

/// Descends from one θ; returns the best iterate.
///
/// # Errors
/// The start cannot be simulated, or too little was measured there.
pub fn fit_from(
    problem: &Problem,
    structure: &Structure,
    theta: Vec<f64>,
    budget: impl Into<Budget>,
) -> Result<FitResult, FitError> {
    Ok(Descent::at(problem, structure, &theta)?.run(budget).finish())
}
