//! Levenberg-Marquardt with Marquardt's scaling, gain ratio, Huber's weights and box bounds
//! (Madsen, Nielsen and Tingleff 2004, algorithm 3.16).

use super::broyden::Traced;
use super::correlation::Correlation;
use super::cost::{cost_equations, total_cost};
use super::problem::{Evaluation, FitError, Problem};
use super::step::{STEP_TOLERANCE, damped_step, is_small, moved};
use super::uncertainty::{POISSON, tells_poisson};
use crate::model::{ParameterInfo, Structure};
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

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
    /// Most evaluations in all, the first included.
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
    /// Number of simulations with tangents, and of steps that were not taken.
    pub evaluations: usize,
    /// How many times narrower than it is the prior was where the descent ended: one, or more where it was
    /// [`Descent::shrunk`].
    pub prior_weight: f64,
    /// ln E where each followed start ended, and its cost.
    pub ends: Vec<(f64, f64)>,
}

#[cfg(test)]
impl FitResult {
    /// An evaluation as the end of a fit.
    pub(crate) fn at(evaluation: Evaluation, structure: &Structure) -> Self {
        Self {
            cost: total_cost(&evaluation, &structure.parameters()),
            ends: Vec::new(),
            best: evaluation,
            stop: StopReason::Converged,
            evaluations: 1,
            prior_weight: 1.0,
        }
    }
}

/// A step that promises no more than a small one does ends the descent, as that does: half the square of it, in units of the
/// mean square misfit. (A share of the whole cost would not do: with thousands of rows it ends the descent
/// several standard errors away from the minimum.)
const SMALL_DECREASE: f64 = 0.5 * STEP_TOLERANCE * STEP_TOLERANCE;

/// Share of the cost by which rounding and the assignment of points move it from one θ to the next: where fits of a
/// bench cell had come to rest, costs within about 3e-4 of each other came in any order.
const COST_NOISE: f64 = 3e-4;
/// How many times what a step promises a whole descent may come down at most: rope is no linear thing, and descents
/// of bench cells came down by up to 3.3 times the promise of their first step.
const PROMISES: f64 = 4.0;
/// Damping beyond which no step is tried.
const MOST_DAMPING: f64 = 1e8;
/// Most damping of a descent's first step.
const FIRST_DAMPING: f64 = 1e-3;
/// And least.
const LEAST_FIRST_DAMPING: f64 = 1e-9;
/// Share of what an undamped first step promises that a damped one promises at least.
const LEAST_PROMISED: f64 = 0.5;
/// By how much the damping grows where a descent's first step does not lower the cost.
const FIRST_GROWTH: f64 = 2.0;
/// Damping up to which a step promises what an undamped one does.
const LITTLE_DAMPING: f64 = 0.01;

/// Share of what a step promised by which it may fall short or exceed it for its slopes to be corrected by it; else they
/// are found anew.
const FAITHFUL: f64 = 0.5;
/// Most steps in a row after which slopes are corrected.
const MOST_CORRECTIONS: usize = 3;

/// Priors that are tried where the one that promises to take no more away than it may takes more: see [`Descent::shrunk`].
const PRIORS_TRIED: usize = 3;
/// How many times lighter each is than the one before.
const GENTLER: f64 = 2.0;
/// Halvings by which the heaviest prior that promises to keep what it must is found: to 1e-3 of its logarithm.
const PRIOR_HALVINGS: usize = 10;

/// How the slopes at a descent's best iterate were found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Slopes {
    /// From tangents, for every entry of θ.
    Whole,
    /// From tangents, for what is free.
    Free,
    /// From tangents so many steps ago, corrected since ([`super::broyden`]).
    Corrected(usize),
}

/// The parameters of a structure with a prior that is so many times narrower.
pub(super) fn held_by(structure: &Structure, prior_weight: f64) -> Vec<ParameterInfo> {
    let narrower = |mut p: ParameterInfo| {
        p.prior_sd /= prior_weight;
        p
    };
    structure.parameters().into_iter().map(narrower).collect()
}

/// A descent, which can go on where its budget was spent. Its steps have slopes only for the entries of θ that are free:
/// those that are held take as much time as others. Tangents take two to eight times as long as the prediction itself:
/// where a step kept what it promised its slopes are corrected by what it did. A descent never ends by corrected slopes.
#[derive(Clone)]
pub struct Descent<'a> {
    /// Settled at the best θ.
    here: Problem<'a>,
    structure: Structure,
    /// The best iterate so far.
    best: Traced,
    cost: f64,
    stop: StopReason,
    evaluations: usize,
    damping: f64,
    /// By how much that grows where the next step lowers the cost no more.
    growth: f64,
    /// Entries of θ that stay where they are.
    held: Vec<bool>,
    slopes: Slopes,
    /// As [`FitResult::prior_weight`].
    prior_weight: f64,
}

impl<'a> Descent<'a> {
    /// Before the first step from θ.
    ///
    /// # Errors
    /// The start cannot be simulated, or too little was measured there.
    pub fn at(problem: &Problem<'a>, structure: &Structure, theta: &[f64]) -> Result<Self, FitError> {
        Self::of(problem.settled(structure, theta)?, structure, theta)
    }

    /// The same with some entries of θ held where they are, and no others.
    ///
    /// # Errors
    /// The start cannot be simulated, or too little was measured there.
    pub(super) fn holding(
        problem: &Problem<'a>,
        structure: &Structure,
        theta: &[f64],
        held: Vec<bool>,
    ) -> Result<Self, FitError> {
        let here = problem.settled(structure, theta)?;
        let start = here.traced(structure, theta, &vec![false; theta.len()])?;
        Ok(Self::begun(here, structure, start, held))
    }

    /// At the first of some starts that costs less than `below`, or at the best of them where none does.
    ///
    /// # Errors
    /// No start can be simulated, or too little was measured there.
    pub fn at_first(
        problem: &Problem<'a>,
        structure: &Structure,
        starts: impl IntoIterator<Item = Vec<f64>>,
        below: f64,
    ) -> Result<Self, FitError> {
        let info = structure.parameters();
        let mut tried = Vec::new();
        for theta in starts {
            let one = problem.settled(structure, &theta).and_then(|here| {
                let cost = total_cost(&here.residuals_as_begun(structure, &theta)?, &info);
                Ok((cost, theta, here))
            });
            let enough = one.as_ref().is_ok_and(|(cost, ..)| *cost < below);
            tried.push(one);
            if enough {
                break;
            }
        }
        let cost = |one: &Result<(f64, _, _), _>| one.as_ref().map_or(f64::INFINITY, |(cost, ..)| *cost);
        let best = tried.into_iter().min_by(|a, b| cost(a).total_cmp(&cost(b)));
        let (_, theta, here) = best.unwrap_or_else(|| Err(FitError::NoStart("no start was given".into())))?;
        Self::of(here, structure, &theta)
    }

    /// Before the first step from θ of a problem that is settled there.
    ///
    /// # Errors
    /// The start cannot be simulated, or too little was measured there.
    pub(super) fn of(here: Problem<'a>, structure: &Structure, theta: &[f64]) -> Result<Self, FitError> {
        let start = here.traced(structure, theta, &vec![false; theta.len()])?;
        let held = not_told(&here, structure, &start.evaluation);
        Ok(Self::begun(here, structure, start, held))
    }

    /// Before the first step from where a settled problem was traced.
    fn begun(here: Problem<'a>, structure: &Structure, start: Traced, held: Vec<bool>) -> Self {
        let mut first = Self {
            held,
            cost: total_cost(&start.evaluation, &structure.parameters()),
            here,
            structure: structure.clone(),
            best: start,
            stop: StopReason::BudgetSpent,
            evaluations: 1,
            damping: FIRST_DAMPING,
            growth: FIRST_GROWTH,
            slopes: Slopes::Whole,
            prior_weight: 1.0,
        };
        first.damp_first();
        first
    }

    /// Whether it came to rest, or had as many evaluations as this without.
    pub fn has_had(&self, evaluations: usize) -> bool {
        match self.stop {
            StopReason::Converged | StopReason::Stalled => true,
            StopReason::BudgetSpent => self.evaluations >= evaluations,
            StopReason::GivenUp => false,
        }
    }

    /// Evaluation of the best iterate so far.
    pub fn best(&self) -> &Evaluation {
        &self.best.evaluation
    }

    /// Cost so far.
    pub fn cost(&self) -> f64 {
        self.cost
    }

    /// Damps the first step as far as leaves it a good part of what it promises undamped, as if none had been tried. In a
    /// narrow valley, as of a bending ratio and the stiffness that falls as it grows, what is little damping elsewhere leaves
    /// a hundredth of a step, whose promise is lost in rounding.
    fn damp_first(&mut self) {
        let info = self.info(self.prior_weight);
        let equations = cost_equations(&self.best.evaluation, &info);
        let promise = |damping: f64| self.damped(damping, &equations, &info).1;
        let enough = LEAST_PROMISED * promise(0.0);
        let mut damping = FIRST_DAMPING;
        while damping > LEAST_FIRST_DAMPING && promise(damping) < enough {
            damping *= 0.1;
        }
        (self.damping, self.growth) = (damping, FIRST_GROWTH);
    }

    /// Goes on until it ends or the budget is spent; a descent that ended is at its end.
    pub fn run(mut self, budget: impl Into<Budget>) -> Self {
        if self.slopes != Slopes::Whole && self.stop == StopReason::BudgetSpent {
            // What the data do not tell at one θ they may tell at another.
            self.complete();
            self.held = not_told(&self.here, &self.structure, &self.best.evaluation);
        }
        self.descend(budget.into());
        self
    }

    /// Goes on from the best iterate to where the prior holds it, with so many evaluations at most. Offsets that hang
    /// together tell less than their number, which standard errors know and the cost does not. Along
    /// a valley that the data hardly tell, as of a cable's stiffness and the mass at its end, the best of offsets that
    /// were independent is often the end of a range; with the prior as heavy against them as it is in the standard
    /// error, it is a value that the error goes with. Where noise is all that is left nothing changes.
    ///
    /// What makes offsets hang together may be something else that the model lacks, and a prior as heavy as all of that
    /// takes what was explained away: the damping of a foam rod lost half of what it had taken away. So it becomes no
    /// heavier than leaves the cost, without its change, at `most_cost`; but where that leaves an effect at an end of its
    /// range, which no cause is, it becomes as heavy as it may.
    pub fn shrunk(mut self, evaluations: usize, most_cost: f64) -> Self {
        self.complete();
        // Steps are promised as they will be taken: by the damping that stopped the last descent nothing would move.
        self.damp_first();
        let heaviest = Correlation::of(&self.best.evaluation).variance_factor().sqrt();
        let held = |weight: f64| self.clone().under(weight).again(evaluations);
        let weight = self.heaviest_that_promises(heaviest, most_cost);
        let keeps = |there: &Self| there.own_cost() <= most_cost && !there.at_an_end();
        let first = held(weight);
        if keeps(&first) {
            return first;
        }
        let mut gentler = (1..PRIORS_TRIED).map(|times| held(weight / GENTLER.powi(times as i32)));
        match gentler.find(keeps) {
            Some(there) => there,
            None if !self.at_an_end() => self,
            None if weight == heaviest => first,
            None => held(heaviest),
        }
    }

    /// The weight of the heaviest prior, `heaviest` or less, that promises a cost of at most `most_cost` without its own.
    fn heaviest_that_promises(&self, heaviest: f64, most_cost: f64) -> f64 {
        let promises = |weight: f64| self.promised_cost(weight) <= most_cost;
        if promises(heaviest) {
            return heaviest;
        }
        let (mut keeps, mut takes) = (0.0, heaviest.ln());
        for _ in 0..PRIOR_HALVINGS {
            let middle = 0.5 * (keeps + takes);
            if promises(middle.exp()) {
                keeps = middle;
            } else {
                takes = middle;
            }
        }
        f64::exp(keeps)
    }

    /// Whether an effect is at an end of its range at the best iterate so far.
    fn at_an_end(&self) -> bool {
        let theta = &self.best.evaluation.theta;
        !self.structure.effects_at_an_end(theta).is_empty()
    }

    /// Goes on as if it had just begun; what ended it stays its end.
    fn again(mut self, evaluations: usize) -> Self {
        let end = self.stop;
        self.damp_first();
        self.stop = StopReason::BudgetSpent;
        let budget = self.evaluations + evaluations;
        Self {
            stop: end,
            ..self.run(budget)
        }
    }

    /// Cost at the best iterate so far, whatever the weight of the prior.
    fn own_cost(&self) -> f64 {
        total_cost(&self.best.evaluation, &self.structure.parameters())
    }

    /// The same where the next step under so heavy a prior leads, to second order.
    fn promised_cost(&self, prior_weight: f64) -> f64 {
        let (hessian, gradient) = cost_equations(&self.best.evaluation, &self.structure.parameters());
        let step = self.step(&self.info(prior_weight)).0;
        self.own_cost() + gradient.dot(&step) + 0.5 * (&hessian * &step).dot(&step)
    }

    /// The same with a prior that is so many times narrower than it is, which its cost then counts; the cost of a
    /// [`FitResult`] never does.
    pub fn under(self, prior_weight: f64) -> Self {
        let mut under = Self { prior_weight, ..self };
        under.cost = total_cost(&under.best.evaluation, &under.info(prior_weight));
        under
    }

    /// The step that it would try first from where it is.
    pub fn next_step(&self) -> DVector<f64> {
        self.step(&self.info(self.prior_weight)).0
    }

    /// That step, what it promises, and the Hessian.
    fn step(&self, info: &[ParameterInfo]) -> (DVector<f64>, f64, DMatrix<f64>) {
        let equations = cost_equations(&self.best.evaluation, info);
        let (step, predicted) = self.damped(self.damping, &equations, info);
        (step, predicted, equations.0)
    }

    /// The step of a Hessian and gradient so damped, and what it promises.
    fn damped(
        &self,
        damping: f64,
        (hessian, gradient): &(DMatrix<f64>, DVector<f64>),
        info: &[ParameterInfo],
    ) -> (DVector<f64>, f64) {
        let place = (&self.best.evaluation.theta[..], &self.held[..]);
        let step = damped_step((hessian, gradient), damping, place, info);
        let predicted = -(gradient.dot(&step) + 0.5 * (hessian * &step).dot(&step));
        (step, predicted)
    }

    /// The parameters with a prior that is so many times narrower.
    fn info(&self, prior_weight: f64) -> Vec<ParameterInfo> {
        held_by(&self.structure, prior_weight)
    }

    /// Steps until an end or until the budget is spent.
    fn descend(&mut self, budget: Budget) {
        let info = &self.info(self.prior_weight);
        while self.stop == StopReason::BudgetSpent && self.evaluations < budget.evaluations {
            let (step, predicted, hessian) = self.step(info);
            let end = self.ends(&hessian, (&step, predicted), budget.worth);
            if end.is_none() && self.accepts((&step, predicted), &hessian, info) {
                self.growth = FIRST_GROWTH;
            } else if matches!(self.slopes, Slopes::Corrected(_)) {
                if !self.find_slopes(info) {
                    self.stop = StopReason::Stalled;
                }
            } else if let Some(end) = end {
                self.stop = end;
            } else {
                self.evaluations += 1;
                self.rejected(predicted);
            }
        }
    }

    /// After a step that did not lower the cost, by slopes from tangents.
    fn rejected(&mut self, predicted: f64) {
        if predicted < COST_NOISE * self.cost {
            self.stop = StopReason::Stalled;
        } else {
            self.damping *= self.growth;
            self.growth *= 4.0;
        }
    }

    /// Why no step is tried, if none is.
    fn ends(
        &self,
        hessian: &DMatrix<f64>,
        (step, predicted): (&DVector<f64>, f64),
        worth: f64,
    ) -> Option<StopReason> {
        let misfit = (2.0 * self.cost / self.best.evaluation.most_rows as f64).max(1.0);
        if is_small(step, hessian, misfit) || predicted < SMALL_DECREASE * misfit {
            Some(StopReason::Converged)
        } else if self.damping > MOST_DAMPING {
            Some(StopReason::Stalled)
        } else if self.damping < LITTLE_DAMPING && self.cost - PROMISES * predicted > worth {
            Some(StopReason::GivenUp)
        } else {
            None
        }
    }

    /// Tries a step, and takes it if it lowers the cost.
    fn accepts(
        &mut self,
        (step, predicted): (&DVector<f64>, f64),
        hessian: &DMatrix<f64>,
        info: &[ParameterInfo],
    ) -> bool {
        let with_effect = !self.structure.effects.is_empty();
        let trial = moved(
            &self.best.evaluation.theta,
            step.iter().copied(),
            info,
            with_effect,
        );
        // A trial that cannot be simulated is a step too far.
        let Ok(there) = self.here.settled(&self.structure, &trial) else {
            return false;
        };
        let curvature = hessian.diagonal();
        let place = (&trial[..], &self.held[..]);
        let Ok(mut next) = there.corrected(&self.structure, &self.best, place, curvature.iter().copied())
        else {
            return false;
        };
        let mut cost = total_cost(&next.evaluation, info);
        let gain = (self.cost - cost) / predicted;
        // A gain that is no number is none.
        if !matches!(gain.partial_cmp(&0.0), Some(std::cmp::Ordering::Greater)) {
            return false;
        }
        let corrections = match self.slopes {
            Slopes::Corrected(times) => times + 1,
            Slopes::Whole | Slopes::Free => 1,
        };
        let mut slopes = Slopes::Corrected(corrections);
        if (gain - 1.0).abs() > FAITHFUL || corrections > MOST_CORRECTIONS {
            let Ok(found) = there.traced(&self.structure, &trial, &self.held) else {
                return false;
            };
            self.evaluations += 1;
            (cost, slopes) = (total_cost(&found.evaluation, info), self.found());
            next = found;
        }
        self.damping *= f64::max(1.0 / 10.0, 1.0 - (2.0 * gain - 1.0).powi(3));
        (self.best, self.cost, self.here, self.slopes) = (next, cost, there, slopes);
        true
    }

    /// Finds the slopes of what is free at the best iterate from tangents; whether that could be done.
    fn find_slopes(&mut self, info: &[ParameterInfo]) -> bool {
        let theta = &self.best.evaluation.theta;
        let Ok(found) = self.here.traced(&self.structure, theta, &self.held) else {
            return false;
        };
        self.evaluations += 1;
        self.cost = total_cost(&found.evaluation, info);
        self.slopes = self.found();
        self.best = found;
        true
    }

    /// What tangents of what is free are: slopes of everything where nothing is held.
    fn found(&self) -> Slopes {
        if self.held.contains(&true) {
            Slopes::Free
        } else {
            Slopes::Whole
        }
    }

    /// Slopes of the best iterate for what is held too, from tangents; one that is no number stays zero.
    fn complete(&mut self) {
        if self.slopes == Slopes::Whole {
            return;
        }
        let theta = &self.best.evaluation.theta;
        if let Ok(whole) = self.here.traced_what_runs(&self.structure, theta) {
            self.best = whole;
        }
        self.slopes = Slopes::Whole;
    }

    /// The best iterate, with slopes for every entry of θ.
    pub fn finish(mut self) -> FitResult {
        self.complete();
        self.into_result()
    }

    /// The best iterate; once a step was taken, its slopes may be corrected ones, and zero for what is held.
    pub(super) fn into_result(self) -> FitResult {
        let best = self.best.evaluation;
        let cost = total_cost(&best, &self.structure.parameters());
        FitResult {
            ends: vec![(best.theta[0], cost)],
            best,
            cost,
            stop: self.stop,
            evaluations: self.evaluations,
            prior_weight: self.prior_weight,
        }
    }
}

/// Which entries of θ stay where they are because the data do not tell them.
pub(super) fn not_told(problem: &Problem, structure: &Structure, evaluation: &Evaluation) -> Vec<bool> {
    let mut held = problem.out_of_plane(structure, evaluation);
    held[POISSON] |= !tells_poisson(evaluation, problem.stiffness_accuracy);
    held
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench_diagnosis::experiment::MOTIONS;
    use crate::bench_diagnosis::reality::{Finer, Reality, part};
    use crate::effects;
    use crate::fit::{Resolution, fit_from};

    /// Its bending says nothing but the product of ratio and stiffness: a descent stayed where the fit without the ratio had
    /// ended, because what the damping left of its steps promised nothing, and along their line the rope bent otherwise.
    #[test]
    fn a_descent_follows_the_valley_of_bending_and_stiffness() {
        let track = &Finer
            .rough_tracks(0.5e6, &[part("bending_ratio", 60.0)], &MOTIONS[..1])
            .unwrap()[0];
        let demo = MOTIONS[0].demo(track, 0.0003, 1);
        let problem = Problem::new(&[&demo], Resolution { cells: 1.5 }).unwrap();
        let base = Structure::default();
        let without = fit_from(&problem, &base, vec![2e6_f64.ln(), 0.3], 24).unwrap();
        let with = base.with(effects::find("bending_ratio").unwrap());
        let start = [without.best.theta, vec![1.0]].concat();
        let end = Descent::at(&problem, &with, &start).unwrap().run(24).finish();
        let [young_pa, ratio] = [end.best.theta[0].exp(), end.best.theta[2]];
        assert!(
            (3.0..5.0).contains(&ratio),
            "ratio {ratio}, E {young_pa} Pa, {:?}",
            end.stop
        );
        assert!(end.cost < 0.5 * without.cost, "{} of {}", end.cost, without.cost);
    }
}
