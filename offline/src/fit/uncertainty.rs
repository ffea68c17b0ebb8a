//! Standard errors of a fit, with the correlation of the residual taken into account.

use super::problem::Evaluation;
use super::solver::{normal_equations, weighted};
use crate::model::{Estimate, Structure};
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

/// How alike neighbouring residuals are, and what that does to their information.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Correlation {
    /// Between successive frames at one station.
    pub in_time: f64,
    /// Between neighbouring stations of one frame.
    pub along_rope: f64,
    /// Mean square of the whitened residual: 1 for a perfect model with the right noise.
    pub reduced_chi_square: f64,
}

impl Correlation {
    /// Measured on the whitened residual.
    pub fn of(evaluation: &Evaluation) -> Self {
        let mut sums = [(0.0, 0.0), (0.0, 0.0)];
        let mut square = 0.0;
        for rows in &evaluation.rows {
            for (i, a) in rows.iter().enumerate() {
                let ra = a.offset_m / a.sigma_m;
                square += ra * ra;
                for b in rows[i + 1..].iter().take_while(|b| b.frame <= a.frame + 1) {
                    let neighbours = [
                        b.frame == a.frame + 1 && b.station == a.station,
                        b.frame == a.frame && b.station == a.station + 1,
                    ];
                    // Rows are compared as vectors: parts along different directions do not mix.
                    let alike: f64 = (0..3).map(|k| a.direction[k] * b.direction[k]).sum();
                    let rb = b.offset_m / b.sigma_m;
                    for (sum, &neighbour) in sums.iter_mut().zip(&neighbours) {
                        if neighbour {
                            sum.0 += ra * rb * alike;
                            sum.1 += 0.5 * (ra * ra + rb * rb) * alike * alike;
                        }
                    }
                }
            }
        }
        let ratio = |(product, norm): (f64, f64)| {
            if norm > 0.0 {
                (product / norm).clamp(0.0, 0.99)
            } else {
                0.0
            }
        };
        Self {
            in_time: ratio(sums[0]),
            along_rope: ratio(sums[1]),
            reduced_chi_square: square / evaluation.len() as f64,
        }
    }

    /// Factor on variances: misfit, and the loss of effective sample size of an autoregressive
    /// residual, (1 + r)/(1 − r) in time and along the rope.
    pub fn variance_factor(&self) -> f64 {
        let loss = |r: f64| (1.0 + r) / (1.0 - r);
        self.reduced_chi_square.max(1.0) * loss(self.in_time) * loss(self.along_rope)
    }

    /// Number of independent residuals that carry the same information as `rows` correlated ones.
    pub fn effective_rows(&self, rows: usize) -> f64 {
        let keep = |r: f64| (1.0 - r) / (1.0 + r);
        rows as f64 * keep(self.in_time) * keep(self.along_rope)
    }
}

/// Covariance of θ.
pub fn covariance(evaluation: &Evaluation, structure: &Structure) -> DMatrix<f64> {
    let info = structure.parameters();
    let (mut hessian, _) = normal_equations(evaluation, &info);
    let factor = Correlation::of(evaluation).variance_factor();
    // The prior is not data: only the data's information shrinks with correlation.
    for k in 0..info.len() {
        let prior = 1.0 / info[k].prior_sd.powi(2);
        hessian[(k, k)] += prior * (factor - 1.0);
    }
    match hessian.clone().cholesky() {
        Some(factored) => factored.inverse() * factor,
        None => DMatrix::from_diagonal_element(info.len(), info.len(), f64::INFINITY),
    }
}

/// How far errors of the prediction along each row, m, move the optimum, to first order.
pub fn shift_by(evaluation: &Evaluation, structure: &Structure, errors_m: &[f64]) -> Vec<f64> {
    let (hessian, _) = normal_equations(evaluation, &structure.parameters());
    let (_, jacobian, weights) = weighted(evaluation);
    let errors = evaluation.all_rows().zip(errors_m).zip(weights.iter());
    let errors = errors.map(|((row, error), weight)| weight * error / row.sigma_m);
    let pull = jacobian.tr_mul(&DVector::from_iterator(errors_m.len(), errors));
    match hessian.cholesky() {
        Some(factored) => factored.solve(&pull).iter().copied().collect(),
        None => vec![f64::INFINITY; evaluation.theta.len()],
    }
}

/// Share of the prior's standard deviation above which a parameter counts as not identified.
const IDENTIFIED_SHARE: f64 = 0.5;

/// Root mean square by which a change of parameter `k` moves the measured offsets, m.
fn moves_m(evaluation: &Evaluation, k: usize, change: f64) -> f64 {
    evaluation.jacobian.column(k).norm() * change / (evaluation.len() as f64).sqrt()
}

/// θ with standard errors, E in Pa. A parameter counts as identified when its error is small against
/// its prior, it is not at a bound, and a change of half its prior moves the rope by more than the
/// model leaves unexplained: else that rest could pass for a value of it.
pub fn estimates(evaluation: &Evaluation, structure: &Structure) -> Vec<Estimate> {
    estimates_within(evaluation, structure, &vec![0.0; evaluation.theta.len()])
}

/// The same where each entry of θ may be off by `shift` besides, as one standard error.
pub fn estimates_within(evaluation: &Evaluation, structure: &Structure, shift: &[f64]) -> Vec<Estimate> {
    let covariance = covariance(evaluation, structure);
    let unexplained_m = (evaluation.rms_m().powi(2) - evaluation.floor_m().powi(2))
        .max(0.0)
        .sqrt();
    structure
        .parameters()
        .into_iter()
        .enumerate()
        .map(|(k, info)| {
            let se = covariance[(k, k)].sqrt().hypot(shift[k]);
            let theta = evaluation.theta[k];
            let at_bound = theta <= info.low || theta >= info.high;
            let (value, standard_error) = if k == 0 {
                (theta.exp(), theta.exp() * se)
            } else {
                (theta, se)
            };
            Estimate {
                name: info.name,
                unit: info.unit.into(),
                value,
                standard_error,
                identified: se < IDENTIFIED_SHARE * info.prior_sd
                    && !at_bound
                    && moves_m(evaluation, k, IDENTIFIED_SHARE * info.prior_sd) > unexplained_m,
            }
        })
        .collect()
}
