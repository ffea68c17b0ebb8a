//! Scores of all effects that the model lacks, from one pass of tangents.

use crate::effects;
use crate::fit::Evaluation;
use crate::model::{ParameterInfo, Structure};
use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// How well one effect would explain the residual, to first order.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// Index into [`effects::ALL`].
    #[serde(skip)]
    pub effect: usize,
    /// Name of the effect.
    pub id: String,
    /// Predicted drop of the whitened sum of squares.
    pub statistic: f64,
    /// One-step estimate per parameter.
    pub estimate: Vec<f64>,
    /// Its standard error, noise only.
    pub standard_error: Vec<f64>,
    /// Share of the effect's trace that base parameters and camera pose can imitate.
    pub absorbed_share: f64,
    /// The other effect whose remaining trace is most alike.
    pub nearest_rival: Option<String>,
    /// Cosine between the two.
    pub rival_cosine: f64,
}

/// Scores and their calibration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScoreTable {
    /// Best first.
    pub scores: Vec<Score>,
    /// What the best score reaches in 95 % of pseudo-data without any effect.
    pub threshold: f64,
    /// Root mean square of the estimated discretisation error after the base fit, mm.
    pub discretisation_mm: f64,
}

/// Number of pseudo-data sets.
const PSEUDO_SETS: usize = 500;
/// Quantile of the largest score over pseudo-data that an effect has to exceed.
const QUANTILE: f64 = 0.95;
/// Standard deviation of the camera's position error that is projected out, m.
const CAMERA_SHIFT_M: f64 = 0.005;
/// Standard deviation of the camera's rotation error that is projected out, rad.
const CAMERA_TURN_RAD: f64 = 0.01;

/// Least-squares problem of a round: whitened residual, columns that are always free, and a block of
/// columns per candidate effect.
pub struct ScoreProblem {
    residual: DVector<f64>,
    always: DMatrix<f64>,
    always_precision: Vec<f64>,
    blocks: Vec<Block>,
}

struct Block {
    effect: usize,
    columns: DMatrix<f64>,
    low: Vec<f64>,
    high: Vec<f64>,
    precision: Vec<f64>,
}

impl ScoreProblem {
    /// From an evaluation of the structure with every remaining effect appended at its vanishing
    /// value; `known` is the structure without them.
    pub fn new(wide: &Evaluation, wide_structure: &Structure, known: &Structure) -> Self {
        let residual = wide.whitened();
        let jacobian = wide.whitened_jacobian();
        let info = wide_structure.parameters();
        let n_known = known.parameters().len();
        let cameras = camera_columns(wide);
        let mut always = DMatrix::zeros(residual.len(), n_known + cameras.ncols());
        always
            .columns_mut(0, n_known)
            .copy_from(&jacobian.columns(0, n_known));
        always.columns_mut(n_known, cameras.ncols()).copy_from(&cameras);
        let mut always_precision: Vec<f64> = info[..n_known].iter().map(precision).collect();
        for k in 0..cameras.ncols() {
            let sd = if k % 6 < 3 {
                CAMERA_SHIFT_M
            } else {
                CAMERA_TURN_RAD
            };
            always_precision.push(1.0 / (sd * sd));
        }
        let mut first = n_known;
        let mut blocks = Vec::new();
        for &effect in &wide_structure.effects[known.effects.len()..] {
            let count = effects::ALL[effect].parameters.len();
            let range: Range<usize> = first..first + count;
            let at = |k: usize| wide.theta[k];
            blocks.push(Block {
                effect,
                columns: jacobian.columns(first, count).into_owned(),
                low: range.clone().map(|k| info[k].low - at(k)).collect(),
                high: range.clone().map(|k| info[k].high - at(k)).collect(),
                precision: range.map(|k| precision(&info[k])).collect(),
            });
            first += count;
        }
        Self {
            residual,
            always,
            always_precision,
            blocks,
        }
    }

    /// Scores all candidates. `discretisation_m` is the estimated discretisation error of every row's
    /// prediction, `sigma_m` the rows' standard errors.
    pub fn table(&self, discretisation_m: &[f64], sigma_m: &[f64], seed: u64) -> ScoreTable {
        let solver = Projector::new(&self.always, &self.always_precision);
        let traces: Vec<DMatrix<f64>> = self.blocks.iter().map(|b| solver.remove(&b.columns)).collect();
        let residual = solver.remove_vector(&self.residual);
        let mut scores: Vec<Score> = (0..self.blocks.len())
            .map(|b| self.score(b, &traces, &residual))
            .collect();
        let whitened: DVector<f64> = DVector::from_iterator(
            sigma_m.len(),
            discretisation_m.iter().zip(sigma_m).map(|(d, s)| d / s),
        );
        let numerical = solver.remove_vector(&whitened);
        let discretisation_mm = 1e3
            * (numerical
                .iter()
                .zip(sigma_m)
                .map(|(d, s)| (d * s).powi(2))
                .sum::<f64>()
                / sigma_m.len() as f64)
                .sqrt();
        let threshold = self.threshold(&solver, &traces, &numerical, seed);
        scores.sort_by(|a, b| b.statistic.total_cmp(&a.statistic));
        ScoreTable {
            scores,
            threshold,
            discretisation_mm,
        }
    }

    fn score(&self, index: usize, traces: &[DMatrix<f64>], residual: &DVector<f64>) -> Score {
        let block = &self.blocks[index];
        let (statistic, estimate, standard_error) = block.solve(&traces[index], residual);
        let direction = |b: usize| -> (DVector<f64>, DVector<f64>) {
            let weights = if b == index && estimate.iter().any(|e| *e != 0.0) {
                DVector::from_vec(estimate.clone())
            } else {
                self.blocks[b].solve(&traces[b], residual).1.into()
            };
            let weights = if weights.norm() > 0.0 {
                weights
            } else {
                self.blocks[b].unit()
            };
            (&traces[b] * &weights, &self.blocks[b].columns * &weights)
        };
        let (mine, raw) = direction(index);
        let mut nearest: Option<(usize, f64)> = None;
        for b in (0..self.blocks.len()).filter(|&b| b != index) {
            let other = direction(b).0;
            let cosine = mine.dot(&other) / (mine.norm() * other.norm()).max(f64::MIN_POSITIVE);
            if nearest.is_none_or(|(_, best)| cosine.abs() > best.abs()) {
                nearest = Some((b, cosine));
            }
        }
        Score {
            effect: block.effect,
            id: effects::ALL[block.effect].id.into(),
            statistic,
            estimate,
            standard_error,
            absorbed_share: 1.0 - mine.norm_squared() / raw.norm_squared().max(f64::MIN_POSITIVE),
            nearest_rival: nearest.map(|(b, _)| effects::ALL[self.blocks[b].effect].id.into()),
            rival_cosine: nearest.map_or(0.0, |(_, c)| c),
        }
    }

    /// The largest score over all candidates that noise plus discretisation error reach in 95 % of
    /// pseudo-data. The sign of the discretisation error is random, because only its shape is known.
    fn threshold(
        &self,
        solver: &Projector,
        traces: &[DMatrix<f64>],
        numerical: &DVector<f64>,
        seed: u64,
    ) -> f64 {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut largest: Vec<f64> = (0..PSEUDO_SETS)
            .map(|set| {
                let sign = if set % 2 == 0 { 1.0 } else { -1.0 };
                let noise = DVector::from_fn(numerical.len(), |_, _| normal(&mut random));
                let pseudo = numerical * sign + solver.remove_vector(&noise);
                self.blocks
                    .iter()
                    .zip(traces)
                    .map(|(block, trace)| block.solve(trace, &pseudo).0)
                    .fold(0.0, f64::max)
            })
            .collect();
        largest.sort_by(f64::total_cmp);
        largest[(QUANTILE * PSEUDO_SETS as f64) as usize]
    }
}

impl Block {
    /// Drop of the sum of squares, estimate and standard error within the physical range: parameters
    /// whose estimate leaves it on the side of the vanishing value are held there.
    fn solve(&self, trace: &DMatrix<f64>, residual: &DVector<f64>) -> (f64, Vec<f64>, Vec<f64>) {
        let n = trace.ncols();
        let mut hessian = trace.tr_mul(trace);
        for k in 0..n {
            hessian[(k, k)] += self.precision[k];
        }
        let right = trace.tr_mul(residual);
        let mut free: Vec<usize> = (0..n).collect();
        // A parameter that is held later keeps the error which it has when nothing is held.
        let error: Vec<f64> = match hessian.clone().cholesky() {
            Some(factor) => (0..n).map(|k| factor.inverse()[(k, k)].sqrt()).collect(),
            None => self.precision.iter().map(|p| p.powf(-0.5)).collect(),
        };
        loop {
            let mut estimate = vec![0.0; n];
            let a = hessian.select_rows(&free).select_columns(&free);
            let b = right.select_rows(&free);
            let Some(factor) = a.cholesky() else {
                return (0.0, estimate, error);
            };
            let solution = factor.solve(&b);
            for (i, &k) in free.iter().enumerate() {
                estimate[k] = solution[i];
            }
            let wrong = free.iter().position(|&k| {
                (self.low[k] >= 0.0 && estimate[k] < 0.0) || (self.high[k] <= 0.0 && estimate[k] > 0.0)
            });
            match wrong {
                Some(i) => {
                    free.remove(i);
                    if free.is_empty() {
                        return (0.0, vec![0.0; n], error);
                    }
                }
                None => return (b.dot(&solution), estimate, error),
            }
        }
    }

    fn unit(&self) -> DVector<f64> {
        DVector::from_element(self.columns.ncols(), 1.0)
    }
}

/// Removes from a vector what the always-free columns explain, their priors taken into account.
struct Projector<'a> {
    columns: &'a DMatrix<f64>,
    factor: nalgebra::Cholesky<f64, nalgebra::Dyn>,
}

impl<'a> Projector<'a> {
    fn new(columns: &'a DMatrix<f64>, precision: &[f64]) -> Self {
        let mut hessian = columns.tr_mul(columns);
        for (k, p) in precision.iter().enumerate() {
            hessian[(k, k)] += p;
        }
        Self {
            columns,
            factor: hessian
                .cholesky()
                .expect("a prior makes the matrix positive definite"),
        }
    }

    fn remove_vector(&self, v: &DVector<f64>) -> DVector<f64> {
        v - self.columns * self.factor.solve(&self.columns.tr_mul(v))
    }

    fn remove(&self, m: &DMatrix<f64>) -> DMatrix<f64> {
        m - self.columns * self.factor.solve(&self.columns.tr_mul(m))
    }
}

fn precision(info: &ParameterInfo) -> f64 {
    1.0 / (info.prior_sd * info.prior_sd)
}

/// Six columns per demonstration: what a shift (m) and a rotation (rad) of all its cameras do.
/// Rotations are about the middle of what was seen; the lever arm is taken along the rope.
fn camera_columns(evaluation: &Evaluation) -> DMatrix<f64> {
    let mut columns = DMatrix::zeros(evaluation.len(), 6 * evaluation.rows.len());
    let mut i = 0;
    for (d, rows) in evaluation.rows.iter().enumerate() {
        let count = rows.len().max(1) as f64;
        let middle: [f64; 3] =
            std::array::from_fn(|k| rows.iter().map(|r| r.position_m[k]).sum::<f64>() / count);
        for row in rows {
            let arm: [f64; 3] = std::array::from_fn(|k| row.position_m[k] - middle[k]);
            let n = row.direction;
            let turn = [
                arm[1] * n[2] - arm[2] * n[1],
                arm[2] * n[0] - arm[0] * n[2],
                arm[0] * n[1] - arm[1] * n[0],
            ];
            for k in 0..3 {
                columns[(i, 6 * d + k)] = n[k] / row.sigma_m;
                columns[(i, 6 * d + 3 + k)] = turn[k] / row.sigma_m;
            }
            i += 1;
        }
    }
    columns
}

/// A standard normal number (Box and Muller 1958).
fn normal(random: &mut ChaCha8Rng) -> f64 {
    let (u, v): (f64, f64) = (random.random::<f64>().max(f64::MIN_POSITIVE), random.random());
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}
