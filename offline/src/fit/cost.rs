//! What a fit makes small: half the sum of squares of the whitened offsets, with Huber's weights, and the prior's.

use super::problem::Evaluation;
use crate::model::ParameterInfo;
use nalgebra::{DMatrix, DVector};

/// Whitened offsets beyond this count linearly. It is large because a model that lacks an effect
/// misses by many standard errors everywhere, which is signal; only gross outliers shall lose weight.
const DEFAULT_HUBER: f64 = 30.0;

/// Mean square of the whitened offsets, with Huber's weights.
pub(super) fn mean_square(evaluation: &Evaluation) -> f64 {
    2.0 * robust_cost(evaluation) / evaluation.len() as f64
}

/// Half the sum of squares of the whitened offsets, with Huber's weights.
pub(super) fn robust_cost(evaluation: &Evaluation) -> f64 {
    let huber = DEFAULT_HUBER;
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

/// Cost of an evaluation.
pub(super) fn total_cost(evaluation: &Evaluation, info: &[ParameterInfo]) -> f64 {
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
pub(super) fn nominal_rows(evaluation: &Evaluation) -> f64 {
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
