//! Fits from one start or several, and the best iterate of all.

use super::cost::total_cost;
use super::descent::{Budget, Descent, FitResult};
use super::problem::{FitError, Problem};
use crate::model::Structure;
use rayon::prelude::*;

/// Settings of a fit.
#[derive(Clone, Debug, PartialEq)]
pub struct FitOptions {
    /// Young's moduli of the starts, Pa.
    pub starts_pa: Vec<f64>,
    /// How many of the starts, the best by their residual, are followed to the end.
    pub followed: usize,
    /// Most evaluations of one descent.
    pub max_evaluations: usize,
}

impl Default for FitOptions {
    /// Six starts over the paper's range and a decade beyond, the best two followed.
    fn default() -> Self {
        Self {
            starts_pa: vec![0.1e6, 0.25e6, 0.6e6, 1.2e6, 2.4e6, 4.8e6],
            followed: 2,
            max_evaluations: 12,
        }
    }
}

/// Fits from several starts and returns the best iterate of all.
///
/// # Errors
/// No start can be simulated, or too little was measured.
pub fn fit(problem: &Problem, structure: &Structure, options: &FitOptions) -> Result<FitResult, FitError> {
    let starts = options.starts_pa.iter().map(|&pa| structure.start(pa)).collect();
    fit_starts(problem, structure, starts, options)
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
    let info = structure.parameters();
    let scored: Vec<_> = starts
        .into_par_iter()
        .map(|theta| {
            let here = problem.settled(structure, &theta)?;
            let residuals = here.residuals_as_begun(structure, &theta)?;
            Ok((total_cost(&residuals, &info), theta, here))
        })
        .collect();
    let (mut starts, mut failures) = (Vec::new(), Vec::new());
    for start in scored {
        match start {
            Ok(start) => starts.push(start),
            Err(error) => failures.push(error),
        }
    }
    if starts.is_empty() {
        let first = failures.into_iter().next();
        return Err(first.unwrap_or_else(|| FitError::NoStart("no start was given".into())));
    }
    starts.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut best: Option<FitResult> = None;
    let mut ends = Vec::new();
    let mut failure = None;
    // Those with the least cost, and of the others as many again for as long as no slope could be found at any.
    let mut starts = starts.into_iter();
    while best.is_none() {
        let followed: Vec<_> = starts.by_ref().take(options.followed.max(1)).collect();
        if followed.is_empty() {
            break;
        }
        let follow = |(_, theta, here): (f64, Vec<f64>, _)| {
            let start = Descent::of(here, structure, &theta)?;
            Ok(start.run(options.max_evaluations).finish())
        };
        let results: Vec<_> = followed.into_par_iter().map(follow).collect();
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
