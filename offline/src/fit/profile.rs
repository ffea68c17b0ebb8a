//! Intervals by profile likelihood (Venzon and Moolgavkar 1988): how far a parameter may go, while all others follow,
//! until the fit is worse than chance makes it. Where the rope does not answer in proportion, as where stiffness and
//! end mass of a cable grow together, one side is longer than the other, and a standard error hides that.

use super::cost::{mean_square, prior_cost};
use super::descent::{Descent, FitResult, held_by, not_told};
use super::problem::{Evaluation, FitError, Problem};
use super::uncertainty::Information;
use crate::model::{Estimate, ParameterInfo, Structure};
use crate::words::{significant, with_unit};
use nalgebra::DMatrix;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Share of cases in which an interval holds the truth.
pub const LEVEL: f64 = 0.95;
/// Normal quantile of a two-sided interval of that level, the root of the point of χ² with one degree of freedom.
const QUANTILE: f64 = 1.959_964;
/// Error of that root at which an end is found.
const TOLERANCE: f64 = 0.05;
/// Most refits for one end.
const REFITS: usize = 8;
/// Most evaluations of a refit: it starts where the covariance says that the others go.
const EVALUATIONS: usize = 12;
/// Likelihood ratio from which on a fit counts as better than the best: that of one standard error. Descents end within
/// a tenth of one, and points that are assigned to other stations move the ratio by some tenths.
const BETTER: f64 = 1.0;
/// How much farther than the last try the next may be.
const FARTHEST: f64 = 3.0;

/// The interval of one parameter. An end is none where none was found: the data allow everything up to the end of the
/// physical range, the rope cannot be simulated so far out, or the fit grows worse too slowly for the tries that a side
/// has.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Profile {
    /// Name, see [`ParameterInfo`].
    pub name: String,
    /// Unit.
    pub unit: String,
    /// Estimate.
    pub value: f64,
    /// Lower end of the 95 % interval.
    pub low: Option<f64>,
    /// Upper end.
    pub high: Option<f64>,
    /// Whether a better fit was met on the way: then the estimate is of a local minimum.
    pub better_elsewhere: bool,
}

/// Profiles of those `asked` entries of θ that the data may tell, the simulation's own error, `grid_shift` as one
/// standard error of each entry of θ, added to them.
///
/// # Errors
/// The fit itself cannot be simulated.
pub fn profiles(
    problem: &Problem,
    (structure, fitted): (&Structure, &FitResult),
    asked: &[usize],
    (estimates, grid_shift): (&[Estimate], &[f64]),
) -> Result<Vec<Profile>, FitError> {
    // What was found on another way to rest would be compared with what is found from here.
    let (problem, best) = problem.settled_and_evaluated(structure, &fitted.best.theta)?;
    let information = Information::of(&best, structure);
    let search = Search {
        spread: information.covariance(),
        variance_factor: information.variance_factor,
        held: not_told(&problem, structure, &best),
        info: held_by(structure, fitted.prior_weight),
        prior_weight: fitted.prior_weight,
        problem,
        structure,
        best,
    };
    let told: Vec<usize> = asked.iter().copied().filter(|&k| !search.held[k]).collect();
    let profile = |&k: &usize| {
        let systematic = QUANTILE * grid_shift[k].hypot(information.ratio_shift[k]);
        let [low, high] = [-1.0, 1.0].map(|side| (k, side));
        let (low, high) = rayon::join(|| search.end(low), || search.end(high));
        let value = fitted.best.theta[k];
        let end = |end: &End, side: f64| {
            let at = value + side * (end.distance?).hypot(systematic);
            let physical = at > search.info[k].low && at < search.info[k].high;
            physical.then(|| if k == 0 { at.exp() } else { at })
        };
        Profile {
            name: estimates[k].name.clone(),
            unit: estimates[k].unit.clone(),
            value: estimates[k].value,
            low: end(&low, -1.0),
            high: end(&high, 1.0),
            better_elsewhere: low.better || high.better,
        }
    };
    Ok(told.par_iter().map(profile).collect())
}

impl Profile {
    /// The interval in words, with numbers as `number` writes them.
    pub fn in_words(&self, number: impl Fn(f64) -> String) -> String {
        let words = match [self.low, self.high].map(|end| end.map(&number)) {
            [Some(low), Some(high)] => format!("{low} to {high}"),
            [Some(low), None] => format!("above {low}"),
            [None, Some(high)] => format!("below {high}"),
            [None, None] => "no end found".to_owned(),
        };
        let doubt = if self.better_elsewhere {
            " (the value is of a local minimum)"
        } else {
            ""
        };
        words + doubt
    }
}

impl std::fmt::Display for Profile {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.in_words(|end| with_unit(&significant(end), &self.unit)))
    }
}

/// Where an interval ends.
struct End {
    /// From the estimate; none where there is no end.
    distance: Option<f64>,
    better: bool,
}

/// A fit with one entry of θ held.
struct Point {
    /// How far that entry is from its estimate.
    distance: f64,
    /// Root of the likelihood ratio against the best fit.
    root: f64,
    theta: Vec<f64>,
}

struct Search<'a> {
    problem: Problem<'a>,
    structure: &'a Structure,
    best: Evaluation,
    /// Covariance of θ.
    spread: DMatrix<f64>,
    /// See [`Information`].
    variance_factor: Vec<f64>,
    /// With the prior as narrow as it was there.
    info: Vec<ParameterInfo>,
    /// As [`FitResult::prior_weight`]: what held the best there holds the others.
    prior_weight: f64,
    /// Entries that the data do not tell.
    held: Vec<bool>,
}

impl Search<'_> {
    /// The end of entry `k` on a side.
    fn end(&self, (k, side): (usize, f64)) -> End {
        let Self { spread, .. } = self;
        if !spread[(k, k)].is_finite() {
            return End {
                distance: None,
                better: false,
            };
        }
        let bound = if side < 0.0 {
            self.info[k].low
        } else {
            self.info[k].high
        };
        let farthest = (bound - self.best.theta[k]).abs();
        // Where the others that are fitted go with this one, to first order.
        let follow: Vec<f64> = (0..spread.nrows())
            .map(|j| {
                if self.held[j] {
                    0.0
                } else {
                    spread[(j, k)] / spread[(k, k)]
                }
            })
            .collect();
        let mut inside = Point {
            distance: 0.0,
            root: 0.0,
            theta: self.best.theta.clone(),
        };
        // Of what is outside, its distance, and its root where it could be simulated.
        let mut outside: Option<(f64, Option<f64>)> = None;
        let mut next = (QUANTILE * spread[(k, k)].sqrt()).min(0.5 * farthest);
        let mut better = false;
        for _ in 0..REFITS {
            let step = side * (next - inside.distance);
            let theta = self.within(inside.theta.iter().zip(&follow).map(|(t, f)| t + step * f));
            match self.point((k, side), theta) {
                Some((point, lower)) => {
                    better |= lower;
                    if (point.root - QUANTILE).abs() < TOLERANCE {
                        return End {
                            distance: Some(point.distance),
                            better,
                        };
                    }
                    if point.root < QUANTILE {
                        if point.distance >= farthest {
                            return End {
                                distance: None,
                                better,
                            };
                        }
                        inside = point;
                    } else {
                        outside = Some((point.distance, Some(point.root)));
                    }
                }
                None => outside = Some((next, None)),
            }
            next = between(&inside, outside, farthest);
        }
        let simulated = outside.is_some_and(|(_, root)| root.is_some());
        End {
            distance: simulated.then_some(next),
            better,
        }
    }

    /// θ inside its bounds.
    fn within(&self, theta: impl Iterator<Item = f64>) -> Vec<f64> {
        theta
            .zip(&self.info)
            .map(|(t, p)| t.clamp(p.low, p.high))
            .collect()
    }

    /// The fit with entry `k` held at that of θ, and whether it is better than the best by more than that was found
    /// to; none where it cannot be simulated.
    fn point(&self, (k, side): (usize, f64), theta: Vec<f64>) -> Option<(Point, bool)> {
        let mut held = self.held.clone();
        held[k] = true;
        let fit = Descent::holding(&self.problem, self.structure, &theta, held).ok()?;
        let fit = fit.under(self.prior_weight).run(EVALUATIONS).into_result();
        let ratio = self.likelihood_ratio(&fit.best, self.variance_factor[k]);
        let point = Point {
            distance: side * (fit.best.theta[k] - self.best.theta[k]),
            root: ratio.max(0.0).sqrt(),
            theta: fit.best.theta,
        };
        Some((point, ratio < -BETTER))
    }

    /// Twice the difference of log-likelihoods of the best and another evaluation, the prior's part with them, over the
    /// factor by which the misfit of the best and how its offsets hang together enlarge the variance of the entry that
    /// differs: scaled as its standard error is (McCullagh and Nelder 1989, 9.2).
    fn likelihood_ratio(&self, other: &Evaluation, variance_factor: f64) -> f64 {
        let rows = self.best.len() as f64;
        let misfit = |e: &Evaluation| rows * mean_square(e) + 2.0 * prior_cost(&e.theta, &self.info);
        (misfit(other) - misfit(&self.best)) / variance_factor
    }
}

/// The next distance to try: where the root would be the quantile if it grew in proportion, or half-way to what
/// cannot be simulated.
fn between(inside: &Point, outside: Option<(f64, Option<f64>)>, farthest: f64) -> f64 {
    match outside {
        Some((distance, Some(root))) => {
            let share = (QUANTILE - inside.root) / (root - inside.root);
            inside.distance + share.clamp(0.1, 0.9) * (distance - inside.distance)
        }
        Some((distance, None)) => 0.5 * (inside.distance + distance),
        None => {
            let more = if inside.root > 0.0 {
                QUANTILE / inside.root
            } else {
                FARTHEST
            };
            (inside.distance * more.clamp(1.1, FARTHEST)).min(farthest)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_interval_says_where_it_ends_and_where_it_does_not() {
        let profile = |low, high, better_elsewhere| Profile {
            name: "young_pa".into(),
            unit: "Pa".into(),
            value: 1.25e6,
            low,
            high,
            better_elsewhere,
        };
        let [low, high] = [Some(1.1e6), Some(1.4e6)];
        assert_eq!(profile(low, high, false).to_string(), "1100000 Pa to 1400000 Pa");
        assert_eq!(profile(low, None, false).to_string(), "above 1100000 Pa");
        assert_eq!(profile(None, None, false).to_string(), "no end found");
        let in_mpa = |end: f64| format!("{:.1}", 1e-6 * end);
        assert_eq!(
            profile(None, high, true).in_words(in_mpa),
            "below 1.4 (the value is of a local minimum)"
        );
    }
}
