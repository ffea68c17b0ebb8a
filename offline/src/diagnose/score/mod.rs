//! Scores of all effects that the model lacks, from one pass of tangents.

mod free;
pub(super) mod invariance;
mod subsets;

pub(super) use free::{Projector, whitened_left, whitened_vector};
use free::{always_free, normal_matrix};
pub(super) use invariance::invariances;
pub use invariance::{Invariance, PartValue};
pub(super) use subsets::MOST_MEMBERS;
pub use subsets::Subset;

use super::noise::{Noise, Whitener};
use crate::collect::standard_normal;
use crate::effects;
use crate::fit::Evaluation;
use crate::model::{ParameterInfo, Structure};
use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// How well one effect would explain the residual, to first order.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// Name of the effect.
    pub id: String,
    /// Predicted drop of the whitened sum of squares.
    pub statistic: f64,
    /// What it has to exceed: chosen so that in 95 % of pseudo-data without any effect no effect's
    /// score exceeds its own threshold.
    pub threshold: f64,
    /// One-step estimate per parameter.
    pub estimate: Vec<f64>,
    /// Its standard error, noise only.
    pub standard_error: Vec<f64>,
    /// By how much the parameters that the model has already change with it.
    #[serde(default)]
    pub own_change: Vec<f64>,
    /// Share of the effect's trace that base parameters and camera pose can imitate.
    pub absorbed_share: f64,
    /// The other effect whose remaining trace is most alike.
    pub nearest_rival: Option<String>,
    /// Cosine between the two.
    pub rival_cosine: f64,
    /// Effects whose remaining traces are so alike that these data hardly tell them apart.
    pub family: Vec<String>,
}

impl Score {
    /// One that no other effect resembles.
    #[cfg(test)]
    pub(super) fn alone(id: &str, statistic: f64, threshold: f64) -> Self {
        Self {
            id: id.into(),
            statistic,
            threshold,
            estimate: Vec::new(),
            standard_error: Vec::new(),
            own_change: Vec::new(),
            absorbed_share: 0.0,
            nearest_rival: None,
            rival_cosine: 0.0,
            family: Vec::new(),
        }
    }

    /// Index into [`effects::ALL`].
    pub fn effect(&self) -> usize {
        effects::find(&self.id).expect("the registry scored it")
    }

    /// Whether data without any effect would rarely give as much.
    pub fn significant(&self) -> bool {
        self.statistic > self.threshold
    }
}

/// Scores and their calibration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScoreTable {
    /// Best first.
    pub scores: Vec<Score>,
    /// Effects that would explain the residual together, best first.
    #[serde(default)]
    pub subsets: Vec<Subset>,
    /// Root mean square of the estimated discretisation error that the model's parameters do not follow, mm.
    pub discretisation_mm: f64,
    /// Effects that these demonstrations could not be tried with.
    #[serde(default)]
    pub untested: Vec<Untested>,
}

#[cfg(test)]
impl ScoreTable {
    /// One without subsets.
    pub(super) fn of(scores: Vec<Score>) -> Self {
        Self {
            scores,
            subsets: Vec::new(),
            discretisation_mm: 0.0,
            untested: Vec::new(),
        }
    }
}

/// An effect without a score.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Untested {
    /// Name of the effect.
    pub id: String,
    /// Why it could not be tried.
    pub why: String,
}

/// Number of pseudo-data sets.
const PSEUDO_SETS: usize = 500;
/// Share of the pseudo-data without any effect in which none shall be found.
const QUANTILE: f64 = 0.95;

/// Cosine of two traces above which they count as one family.
const FAMILY_COSINE: f64 = 0.95;

/// Least-squares problem of a round: whitened residual, columns that are always free, and a block of
/// columns per candidate effect.
pub struct ScoreProblem {
    residual: DVector<f64>,
    always: DMatrix<f64>,
    whitener: Whitener,
    always_precision: Vec<f64>,
    /// How many of the columns are parameters of the model; cameras follow.
    known: usize,
    blocks: Vec<Block>,
}

struct Block {
    effect: usize,
    /// Whether the camera's columns do what it does, so that it is scored without them.
    without_cameras: bool,
    columns: DMatrix<f64>,
    /// Its physical ranges, from where its parameters vanish.
    ranges: Vec<[f64; 2]>,
    precision: Vec<f64>,
}

impl ScoreProblem {
    /// From an evaluation of the structure with every remaining effect appended at its vanishing
    /// value; `known` is the structure without them, `noise` what the offsets have in common, and
    /// `nuisances` says whether the cameras' pose is free.
    pub fn new(
        wide: &Evaluation,
        wide_structure: &Structure,
        known: &Structure,
        noise: &Noise,
        nuisances: bool,
    ) -> Self {
        let whitener = noise.whitener(wide);
        let residual = whitened_vector(&whitener, wide.whitened());
        let jacobian = whitener.apply(&wide.whitened_jacobian());
        let info = wide_structure.parameters();
        let n_known = known.parameters().len();
        let own = jacobian.columns(0, n_known).into_owned();
        let (always, always_precision) = always_free(wide, &whitener, (own, &info[..n_known]), nuisances);
        let mut first = n_known;
        let mut blocks = Vec::new();
        for &effect in &wide_structure.effects[known.effects.len()..] {
            let count = effects::ALL[effect].parameters.len();
            let range: Range<usize> = first..first + count;
            let at = |k: usize| wide.theta[k];
            blocks.push(Block {
                effect,
                without_cameras: effects::ALL[effect].nuisance,
                columns: jacobian.columns(first, count).into_owned(),
                ranges: range
                    .clone()
                    .map(|k| [info[k].low - at(k), info[k].high - at(k)])
                    .collect(),
                precision: range.map(|k| precision(&info[k])).collect(),
            });
            first += count;
        }
        Self {
            residual,
            always,
            whitener,
            always_precision,
            known: n_known,
            blocks,
        }
    }

    /// Residual and traces with what is free taken out: with the cameras free, and without.
    fn views(&self) -> [View; 2] {
        [self.always.ncols(), self.known].map(|count| {
            let free = self.always.columns(0, count).into_owned();
            let solver = Projector::new(free, &self.always_precision[..count]);
            let of_own =
                |columns: &DMatrix<f64>| solver.coefficients(columns).rows(0, self.known).into_owned();
            let all = self.blocks.iter().map(|block| &block.columns);
            View {
                own: all.clone().map(of_own).collect(),
                residual_own: of_own(&DMatrix::from_columns(std::slice::from_ref(&self.residual))),
                traces: all.map(|columns| solver.remove(columns)).collect(),
                residual: solver.remove_vector(&self.residual),
                solver,
            }
        })
    }

    /// Scores all candidates. `over_noise` is the estimated discretisation error of every row's prediction over the row's
    /// standard error, `discretisation_mm` what [`discretisation_mm`] makes of it.
    pub fn table(&self, over_noise: DVector<f64>, discretisation_mm: f64, seed: u64) -> ScoreTable {
        let views = self.views();
        let whitened = whitened_vector(&self.whitener, over_noise);
        let thresholds = self.thresholds(&views, &whitened, seed);
        let solved: Vec<Solved> = (0..self.blocks.len())
            .map(|b| Solved::of(&self.blocks[b], &views[self.blocks[b].view()], b))
            .collect();
        let subsets = subsets::subsets(&self.blocks, &views, &thresholds);
        let mut scores: Vec<Score> = (0..self.blocks.len())
            .map(|b| self.score(b, &views, &solved, thresholds[b]))
            .collect();
        scores.sort_by(|a, b| b.statistic.total_cmp(&a.statistic));
        ScoreTable {
            scores,
            subsets,
            discretisation_mm,
            untested: Vec::new(),
        }
    }

    /// One-step estimate and standard error of the parameters of every candidate, each effect alone: what
    /// these data say about effects that the model lacks. Errors hold the noise only.
    pub fn intervals(&self) -> Vec<(usize, Vec<f64>, Vec<f64>)> {
        let views = self.views();
        let solved = |(b, block): (usize, &Block)| {
            let solved = Solved::of(block, &views[self.blocks[b].view()], b);
            (block.effect, solved.estimate, solved.standard_error)
        };
        self.blocks.iter().enumerate().map(solved).collect()
    }

    /// Mean square of the whitened residual with what is free taken out, at least one.
    pub fn misfit(&self) -> f64 {
        let [free, _] = self.views();
        (free.residual.norm_squared() / free.residual.len() as f64).max(1.0)
    }

    fn score(&self, index: usize, views: &[View; 2], solved: &[Solved], threshold: f64) -> Score {
        let (block, own) = (&self.blocks[index], &solved[index]);
        // Two effects are compared in the view without cameras where one of them is the cameras'.
        let cosine = |other: usize| {
            let view = &views[block.view().max(self.blocks[other].view())];
            let (a, b) = (
                &view.traces[index] * &own.direction,
                &view.traces[other] * &solved[other].direction,
            );
            a.dot(&b) / (a.norm() * b.norm()).max(f64::MIN_POSITIVE)
        };
        let name = |b: usize| -> String { effects::ALL[self.blocks[b].effect].id.into() };
        let mut alike: Vec<(usize, f64)> = (0..self.blocks.len())
            .filter(|&b| b != index)
            .map(|b| (b, cosine(b)))
            .collect();
        alike.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
        let mine = &views[block.view()].traces[index] * &own.direction;
        let raw = &block.columns * &own.direction;
        Score {
            id: name(index),
            statistic: own.statistic,
            threshold,
            estimate: own.estimate.clone(),
            standard_error: own.standard_error.clone(),
            own_change: views[block.view()].own_change([(index, &own.estimate[..])].into_iter()),
            absorbed_share: 1.0 - mine.norm_squared() / raw.norm_squared().max(f64::MIN_POSITIVE),
            nearest_rival: alike.first().map(|&(b, _)| name(b)),
            rival_cosine: alike.first().map_or(0.0, |&(_, c)| c),
            family: alike
                .iter()
                .filter(|(_, c)| c.abs() >= FAMILY_COSINE)
                .map(|&(b, _)| name(b))
                .collect(),
        }
    }

    /// Thresholds such that in 95 % of pseudo-data, which hold noise plus discretisation error, no score
    /// exceeds its own. Each is the effect's own 95 % point times a common factor, so that effects with
    /// many parameters do not raise the bar for the others (Westfall and Young 1993, balanced
    /// max-T).
    fn thresholds(&self, views: &[View; 2], discretisation: &DVector<f64>, seed: u64) -> Vec<f64> {
        let scores: Vec<Vec<f64>> = pseudo_data(discretisation, seed)
            .map(|pseudo| {
                let seen = views.each_ref().map(|view| view.solver.remove_vector(&pseudo));
                (0..self.blocks.len())
                    .map(|b| {
                        let view = self.blocks[b].view();
                        self.blocks[b]
                            .normal(&views[view].traces[b], &seen[view])
                            .solve()
                            .0
                    })
                    .collect()
            })
            .collect();
        let own: Vec<f64> = (0..self.blocks.len())
            .map(|b| quantile(scores.iter().map(|set| set[b]).collect()))
            .collect();
        let largest = scores.iter().map(|set| {
            let ratios = set
                .iter()
                .zip(&own)
                .filter(|(_, q)| **q > 0.0)
                .map(|(s, q)| s / q);
            ratios.fold(0.0, f64::max)
        });
        let factor = quantile(largest.collect());
        own.iter().map(|q| q * factor).collect()
    }
}

/// Data without any effect, made white: noise and the discretisation error. Its sign is random, because only its shape is
/// known.
fn pseudo_data(discretisation: &DVector<f64>, seed: u64) -> impl Iterator<Item = DVector<f64>> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    (0..PSEUDO_SETS).map(move |set| {
        let sign = if set % 2 == 0 { 1.0 } else { -1.0 };
        let noise = DVector::from_fn(discretisation.len(), |_, _| standard_normal(&mut random));
        discretisation * sign + noise
    })
}

/// The point that [`QUANTILE`] of the values do not exceed.
fn quantile(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[(QUANTILE * values.len() as f64) as usize]
}

/// The problem after what is free has been taken out.
struct View {
    solver: Projector,
    traces: Vec<DMatrix<f64>>,
    residual: DVector<f64>,
    /// What of the traces, and of the residual, the model's own parameters do.
    own: Vec<DMatrix<f64>>,
    residual_own: DMatrix<f64>,
}

impl View {
    /// By how much the model's own parameters change with blocks of these values.
    fn own_change<'a>(&self, values: impl Iterator<Item = (usize, &'a [f64])>) -> Vec<f64> {
        let mut change = self.residual_own.column(0).into_owned();
        for (block, values) in values {
            change -= &self.own[block] * DVector::from_column_slice(values);
        }
        change.data.into()
    }
}

/// The solution of one block alone.
struct Solved {
    statistic: f64,
    estimate: Vec<f64>,
    standard_error: Vec<f64>,
    /// The combination of its parameters that the estimate asks for; all alike where it is zero.
    direction: DVector<f64>,
}

impl Solved {
    fn of(block: &Block, view: &View, index: usize) -> Self {
        let normal = block.normal(&view.traces[index], &view.residual);
        let (statistic, estimate) = normal.solve();
        let direction = if estimate.iter().any(|e| *e != 0.0) {
            DVector::from_vec(estimate.clone())
        } else {
            DVector::from_element(estimate.len(), 1.0)
        };
        Self {
            statistic,
            estimate,
            standard_error: normal.errors(),
            direction,
        }
    }
}

impl Block {
    /// Which view it is scored in: with the cameras free, or without.
    fn view(&self) -> usize {
        usize::from(self.without_cameras)
    }

    /// Its normal equations. A parameter may not lie on the side of its vanishing value where nothing is physical; how far
    /// it goes on the other is not limited, because a slope there says little of the end of its range.
    fn normal(&self, trace: &DMatrix<f64>, residual: &DVector<f64>) -> Normal {
        let sides = self.ranges.iter().map(|&[low, high]| {
            [
                if low >= 0.0 { 0.0 } else { f64::NEG_INFINITY },
                if high <= 0.0 { 0.0 } else { f64::INFINITY },
            ]
        });
        Normal::of((trace, residual), self.precision.clone(), sides.collect())
    }
}

/// Normal equations of some parameters within ranges.
struct Normal {
    hessian: DMatrix<f64>,
    right: DVector<f64>,
    precision: Vec<f64>,
    ranges: Vec<[f64; 2]>,
}

impl Normal {
    fn of(
        (traces, residual): (&DMatrix<f64>, &DVector<f64>),
        precision: Vec<f64>,
        ranges: Vec<[f64; 2]>,
    ) -> Self {
        Self {
            hessian: normal_matrix(traces, &precision),
            right: traces.tr_mul(residual),
            precision,
            ranges,
        }
    }

    /// Drop of the sum of squares, and estimate: parameters whose estimate leaves its range are held where it does, one
    /// after another.
    fn solve(&self) -> (f64, Vec<f64>) {
        let n = self.right.len();
        let mut free: Vec<usize> = (0..n).collect();
        let mut estimate = DVector::zeros(n);
        while !free.is_empty() {
            let held = &self.right - &self.hessian * &estimate;
            let Some(factor) = self.hessian.select_rows(&free).select_columns(&free).cholesky() else {
                return (0.0, vec![0.0; n]);
            };
            let solution = factor.solve(&held.select_rows(&free));
            let out = (0..free.len()).find_map(|i| {
                let [low, high] = self.ranges[free[i]];
                let within = solution[i].clamp(low, high);
                (within != solution[i]).then_some((i, within))
            });
            let Some((i, end)) = out else {
                free.iter()
                    .zip(&solution)
                    .for_each(|(&k, &value)| estimate[k] = value);
                break;
            };
            estimate[free.remove(i)] = end;
        }
        let drop = 2.0 * self.right.dot(&estimate) - (&self.hessian * &estimate).dot(&estimate);
        (drop, estimate.data.into())
    }

    /// Standard errors where nothing is held: what is held later keeps them.
    fn errors(&self) -> Vec<f64> {
        match self.hessian.clone().cholesky() {
            Some(factor) => factor.inverse().diagonal().iter().map(|v| v.sqrt()).collect(),
            None => self.precision.iter().map(|p| p.powf(-0.5)).collect(),
        }
    }
}

/// Root mean square of the simulation's own error, mm, that the parameters of a structure do not follow: `over_noise` holds
/// it along every row of an evaluation, whose first slopes are theirs, over the row's standard error.
pub(super) fn discretisation_mm(
    evaluation: &Evaluation,
    structure: &Structure,
    over_noise: &DVector<f64>,
) -> f64 {
    let precisions: Vec<f64> = structure.parameters().iter().map(precision).collect();
    let slopes = evaluation.whitened_jacobian();
    let own = slopes.columns(0, precisions.len()).into_owned();
    1e3 * evaluation.rms_of_m(&Projector::new(own, &precisions).remove_vector(over_noise))
}

fn precision(info: &ParameterInfo) -> f64 {
    1.0 / (info.prior_sd * info.prior_sd)
}
