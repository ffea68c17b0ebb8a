//! Levenberg-Marquardt with Marquardt's scaling, gain ratio, Huber's weights and box bounds
//! (Madsen, Nielsen and Tingleff 2004, algorithm 3.16).

use super::problem::{Evaluation, FitError, Problem};
use super::uncertainty::{POISSON, tells_poisson};
use crate::model::{ParameterInfo, Structure};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

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

/// Why a descent ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StopReason {
    /// The step became small against the standard errors.
    Converged,
    /// No step lowered the cost any more.
    Stalled,
    /// The budget of evaluations is spent.
    BudgetSpent,
    /// The slopes do not promise to come near the cost that was asked for.
    GivenUp,
}

/// How long a descent may go on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Budget {
    /// Most evaluations, the first included.
    pub evaluations: usize,
    /// Cost that makes the descent worth while; infinite where any does.
    pub worth: f64,
}

impl From<usize> for Budget {
    /// So many evaluations, whatever comes of it.
    fn from(evaluations: usize) -> Self {
        Self {
            evaluations,
            worth: f64::INFINITY,
        }
    }
}

/// The best iterate of a fit.
pub struct FitResult {
    /// Evaluation at the best θ.
    pub best: Evaluation,
    /// Cost at the best θ: half the robust sum of squares plus the prior's.
    pub cost: f64,
    /// Why the descent ended.
    pub stop: StopReason,
    /// Number of simulations with tangents.
    pub evaluations: usize,
    /// ln E where each followed start ended, and its cost.
    pub ends: Vec<(f64, f64)>,
    /// Damping with which the descent would go on.
    pub damping: f64,
}

impl FitResult {
    /// A descent before its first step.
    pub(crate) fn at(start: Evaluation, info: &[ParameterInfo]) -> Self {
        let cost = total_cost(&start, info);
        Self {
            ends: vec![(start.theta[0], cost)],
            best: start,
            cost,
            stop: StopReason::BudgetSpent,
            evaluations: 1,
            damping: FIRST_DAMPING,
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
    let scored: Vec<_> = starts
        .into_par_iter()
        .map(|theta| {
            let here = problem.settled(structure, &theta)?;
            let residuals = here.residuals(structure, &theta)?;
            Ok((robust_cost(&residuals, DEFAULT_HUBER), theta, here))
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
    starts.truncate(options.followed.max(1));
    let results: Vec<_> = starts
        .into_par_iter()
        .map(|(_, theta, here)| {
            let start = here.evaluate_settled(structure, &theta)?;
            Ok(descend_settled(
                here,
                structure,
                start,
                options.max_evaluations.into(),
            ))
        })
        .collect();
    let mut best: Option<FitResult> = None;
    let mut ends = Vec::new();
    let mut failure = None;
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
    match (best, failure) {
        (Some(best), _) => Ok(FitResult { ends, ..best }),
        (None, Some(error)) => Err(error),
        (None, None) => Err(FitError::NoStart("no start was given".into())),
    }
}

/// Whitened offsets beyond this count linearly. It is large because a model that lacks an effect
/// misses by many standard errors everywhere, which is signal; only gross outliers shall lose weight.
const DEFAULT_HUBER: f64 = 30.0;
/// A step smaller than this share of every standard error ends the descent.
const STEP_TOLERANCE: f64 = 0.1;
/// So does one that promises no more than such a step does: half the square of it, in units of the mean
/// square misfit. (A share of the whole cost would not do: with thousands of rows it ends the descent
/// several standard errors away from the minimum.)
const SMALL_DECREASE: f64 = 0.5 * STEP_TOLERANCE * STEP_TOLERANCE;

/// Share of the cost by which rounding and the assignment of points move it from one θ to the next: where fits of a
/// bench cell had come to rest, costs within about 3e-4 of each other came in any order.
const COST_NOISE: f64 = 3e-4;
/// How many times what a step promises a whole descent may come down at most: rope is no linear thing, and descents
/// of bench cells came down by up to 3.3 times the promise of their first step.
const PROMISES: f64 = 4.0;
/// Damping of a descent's first step.
const FIRST_DAMPING: f64 = 1e-3;
/// Damping up to which a step promises what an undamped one does.
const LITTLE_DAMPING: f64 = 0.01;

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
    let (here, start) = problem.settled_and_evaluated(structure, &theta)?;
    Ok(descend_settled(here, structure, start, budget.into()))
}

/// The same with some entries of θ held where they are, and no others.
///
/// # Errors
/// The start cannot be simulated, or too little was measured there.
pub(super) fn fit_holding(
    problem: &Problem,
    structure: &Structure,
    (theta, held): (Vec<f64>, Vec<bool>),
    budget: impl Into<Budget>,
) -> Result<FitResult, FitError> {
    let (here, start) = problem.settled_and_evaluated(structure, &theta)?;
    let start = FitResult::at(start, &structure.parameters());
    Ok(descend(here, structure, (start, held), budget.into()))
}

/// Descends from the first of some starts that costs less than `below`, or from the best of them where none does; returns
/// the best iterate.
///
/// # Errors
/// No start can be simulated, or too little was measured there.
pub fn fit_from_first(
    problem: &Problem,
    structure: &Structure,
    starts: impl IntoIterator<Item = Vec<f64>>,
    below: f64,
    budget: impl Into<Budget>,
) -> Result<FitResult, FitError> {
    let info = structure.parameters();
    let mut tried = Vec::new();
    for theta in starts {
        let one = problem.settled_and_evaluated(structure, &theta);
        let one = one.map(|(here, evaluation)| (total_cost(&evaluation, &info), here, evaluation));
        let enough = one.as_ref().is_ok_and(|one| one.0 < below);
        tried.push(one);
        if enough {
            break;
        }
    }
    let cost = |one: &Result<_, _>| one.as_ref().map_or(f64::INFINITY, |one: &(f64, _, _)| one.0);
    let best = tried.into_iter().min_by(|a, b| cost(a).total_cmp(&cost(b)));
    let (_, here, start) = best.unwrap_or_else(|| Err(FitError::NoStart("no start was given".into())))?;
    Ok(descend_settled(here, structure, start, budget.into()))
}

/// Goes on with a descent whose budget is spent, as if it had been larger by `more` evaluations; one that ended otherwise
/// is at its end.
pub fn resume(
    problem: &Problem,
    structure: &Structure,
    fit: FitResult,
    more: impl Into<Budget>,
) -> FitResult {
    if fit.stop != StopReason::BudgetSpent {
        return fit;
    }
    let mut budget = more.into();
    budget.evaluations += fit.evaluations;
    let here = problem.settled(structure, &fit.best.theta);
    let here = here.unwrap_or_else(|_| problem.clone());
    let held = not_told(&here, structure, &fit.best);
    descend(here, structure, (fit, held), budget)
}

/// Descends from an evaluation, which counts as the first, of a problem that is settled there.
fn descend_settled(here: Problem, structure: &Structure, start: Evaluation, budget: Budget) -> FitResult {
    let held = not_told(&here, structure, &start);
    let start = FitResult::at(start, &structure.parameters());
    descend(here, structure, (start, held), budget)
}

/// Descends, with some entries of θ held, from where a fit has come to, in a problem that is settled there.
fn descend(
    mut here: Problem,
    structure: &Structure,
    (mut fit, held): (FitResult, Vec<bool>),
    budget: Budget,
) -> FitResult {
    let info = structure.parameters();
    let mut growth = 2.0;
    fit.stop = loop {
        if fit.evaluations >= budget.evaluations {
            break StopReason::BudgetSpent;
        }
        let (hessian, gradient) = normal_equations(&fit.best, &info);
        let step = damped_step(
            (&hessian, &gradient),
            fit.damping,
            (&fit.best.theta, &held),
            &info,
        );
        let predicted = -(gradient.dot(&step) + 0.5 * (&hessian * &step).dot(&step));
        let misfit = (2.0 * fit.cost / nominal_rows(&fit.best)).max(1.0);
        if is_small(&step, &hessian, misfit) || predicted < SMALL_DECREASE * misfit {
            break StopReason::Converged;
        }
        if fit.damping > 1e8 {
            break StopReason::Stalled;
        }
        if fit.damping < LITTLE_DAMPING && fit.cost - PROMISES * predicted > budget.worth {
            break StopReason::GivenUp;
        }
        let trial: Vec<f64> = fit
            .best
            .theta
            .iter()
            .zip(step.iter())
            .map(|(t, s)| t + s)
            .collect();
        fit.evaluations += 1;
        let accepted = match here.settled_and_evaluated(structure, &trial) {
            Ok((there, next)) => {
                let next_cost = total_cost(&next, &info);
                let gain = (fit.cost - next_cost) / predicted;
                if gain > 0.0 {
                    fit.damping *= f64::max(1.0 / 10.0, 1.0 - (2.0 * gain - 1.0).powi(3));
                    (fit.best, fit.cost, here) = (next, next_cost, there);
                }
                gain > 0.0
            }
            // A trial that cannot be simulated is a step too far.
            Err(_) => false,
        };
        if accepted {
            growth = 2.0;
        } else if predicted < COST_NOISE * fit.cost {
            break StopReason::Stalled;
        } else {
            fit.damping *= growth;
            growth *= 4.0;
        }
    };
    fit.ends = vec![(fit.best.theta[0], fit.cost)];
    fit
}

/// Mean square of the whitened offsets, with Huber's weights.
pub(super) fn mean_square(evaluation: &Evaluation) -> f64 {
    2.0 * robust_cost(evaluation, DEFAULT_HUBER) / evaluation.len() as f64
}

fn robust_cost(evaluation: &Evaluation, huber: f64) -> f64 {
    evaluation
        .whitened()
        .iter()
        .map(|r| {
            let a = r.abs();
            if a <= huber {
                0.5 * a * a
            } else {
                huber * (a - 0.5 * huber)
            }
        })
        .sum()
}

fn total_cost(evaluation: &Evaluation, info: &[ParameterInfo]) -> f64 {
    let prior: f64 = evaluation
        .theta
        .iter()
        .zip(info)
        .map(|(t, p)| 0.5 * ((t - p.prior_mean) / p.prior_sd).powi(2))
        .sum();
    // Stations come and go with the assignment of points, so the cost counts per row.
    0.5 * mean_square(evaluation) * nominal_rows(evaluation) + prior
}

/// A number of rows that does not depend on θ.
fn nominal_rows(evaluation: &Evaluation) -> f64 {
    evaluation
        .rows
        .iter()
        .map(|rows| rows.last().map_or(0, |r| r.frame + 1) as f64 * 2.0 * crate::observe::STATIONS as f64)
        .sum()
}

/// Residual and Jacobian over the standard errors, both times the roots of Huber's weights, and these roots.
pub(super) fn weighted(evaluation: &Evaluation) -> (DVector<f64>, DMatrix<f64>, DVector<f64>) {
    let mut r = evaluation.whitened();
    let mut j = evaluation.whitened_jacobian();
    let roots = r.map(|offset| (DEFAULT_HUBER / offset.abs()).min(1.0).sqrt());
    for (i, &root) in roots.iter().enumerate() {
        r[i] *= root;
        j.row_mut(i).scale_mut(root);
    }
    (r, j, roots)
}

/// Hessian and gradient of the cost. The residual is measured minus predicted, so its derivative is
/// minus the Jacobian of the prediction.
pub(super) fn normal_equations(
    evaluation: &Evaluation,
    info: &[ParameterInfo],
) -> (DMatrix<f64>, DVector<f64>) {
    let (r, j, _) = weighted(evaluation);
    let mut hessian = j.tr_mul(&j);
    let mut gradient = -j.tr_mul(&r);
    for (k, p) in info.iter().enumerate() {
        let weight = 1.0 / (p.prior_sd * p.prior_sd);
        hessian[(k, k)] += weight;
        gradient[k] += weight * (evaluation.theta[k] - p.prior_mean);
    }
    (hessian, gradient)
}

/// Which entries of θ stay where they are because the data do not tell them.
pub(super) fn not_told(problem: &Problem, structure: &Structure, evaluation: &Evaluation) -> Vec<bool> {
    let mut held = problem.out_of_plane(structure, evaluation);
    held[POISSON] |= !tells_poisson(evaluation, problem.stiffness_accuracy);
    held
}

/// The damped Newton step inside the box, without the entries that are held. Entries that would leave it are put
/// on the bound and the others solved again.
fn damped_step(
    (hessian, gradient): (&DMatrix<f64>, &DVector<f64>),
    damping: f64,
    (theta, held): (&[f64], &[bool]),
    info: &[ParameterInfo],
) -> DVector<f64> {
    let n = theta.len();
    let mut fixed: Vec<Option<f64>> = held.iter().map(|held| held.then_some(0.0)).collect();
    loop {
        let mut a = hessian.clone();
        let mut b = -gradient.clone();
        for k in 0..n {
            a[(k, k)] *= 1.0 + damping;
        }
        for k in 0..n {
            if let Some(value) = fixed[k] {
                for i in 0..n {
                    b[i] -= hessian[(i, k)] * value;
                    a[(i, k)] = 0.0;
                    a[(k, i)] = 0.0;
                }
            }
        }
        for k in 0..n {
            if let Some(value) = fixed[k] {
                a[(k, k)] = 1.0;
                b[k] = value;
            }
        }
        let Some(factor) = a.cholesky() else {
            return DVector::zeros(n);
        };
        let step = factor.solve(&b);
        let mut clean = true;
        for k in 0..n {
            let allowed = step[k].clamp(info[k].low - theta[k], info[k].high - theta[k]);
            if fixed[k].is_none() && allowed != step[k] {
                fixed[k] = Some(allowed);
                clean = false;
            }
        }
        if clean {
            return step;
        }
    }
}

/// Whether a step is small against standard errors that grow with the misfit: where the model lacks
/// an effect, the place of the minimum is uncertain by more than the noise says.
fn is_small(step: &DVector<f64>, hessian: &DMatrix<f64>, misfit: f64) -> bool {
    let inflation = misfit.sqrt();
    (0..step.len()).all(|k| step[k].abs() * hessian[(k, k)].sqrt() < STEP_TOLERANCE * inflation)
}
