//! What is free in every score, and what a fit leaves beside it.

use super::precision;
use crate::diagnose::noise::{Noise, Whitener};
use crate::fit::Evaluation;
use crate::model::{ParameterInfo, Structure};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Standard deviation of the camera's position error that is projected out, m.
const CAMERA_SHIFT_M: f64 = 0.005;
/// Standard deviation of the camera's rotation error that is projected out, rad.
const CAMERA_TURN_RAD: f64 = 0.01;

/// What a fit leaves in the measure of the scores: the sum of squares of its offsets, made white, with its parameters free
/// and, unless an effect does what they do, the cameras.
pub(in super::super) fn whitened_left(
    evaluation: &Evaluation,
    structure: &Structure,
    noise: &Noise,
    nuisances: bool,
) -> f64 {
    let whitener = noise.whitener(evaluation);
    let residual = whitened_vector(&whitener, evaluation.whitened());
    Projector::of_model(evaluation, structure, &whitener, nuisances)
        .remove_vector(&residual)
        .norm_squared()
}

/// Columns that are free in every score, with their priors: those of a model's own parameters, which are white already, and,
/// with `nuisances`, of the cameras' pose.
pub(super) fn always_free(
    evaluation: &Evaluation,
    whitener: &Whitener,
    (own, info): (DMatrix<f64>, &[ParameterInfo]),
    nuisances: bool,
) -> (DMatrix<f64>, Vec<f64>) {
    let mut priors: Vec<f64> = info.iter().map(precision).collect();
    if !nuisances {
        return (own, priors);
    }
    let cameras = whitener.apply(&camera_columns(evaluation));
    let sd = |k: usize| {
        if k % 6 < 3 {
            CAMERA_SHIFT_M
        } else {
            CAMERA_TURN_RAD
        }
    };
    priors.extend((0..cameras.ncols()).map(|k| sd(k).powi(-2)));
    let columns: Vec<_> = own.column_iter().chain(cameras.column_iter()).collect();
    (DMatrix::from_columns(&columns), priors)
}

pub(in super::super) fn whitened_vector(whitener: &Whitener, vector: DVector<f64>) -> DVector<f64> {
    whitener
        .apply(&DMatrix::from_columns(&[vector]))
        .column(0)
        .into_owned()
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

/// The matrix of the normal equations of some columns with priors.
pub(super) fn normal_matrix(columns: &DMatrix<f64>, precision: &[f64]) -> DMatrix<f64> {
    let mut matrix = columns.tr_mul(columns);
    for (k, p) in precision.iter().enumerate() {
        matrix[(k, k)] += p;
    }
    matrix
}

/// The same, ready to be solved.
pub(super) fn factor(normal_matrix: DMatrix<f64>) -> Cholesky<f64, Dyn> {
    normal_matrix
        .cholesky()
        .expect("a prior makes the matrix positive definite")
}

/// Removes from a vector what the always-free columns explain, their priors taken into account.
pub(in super::super) struct Projector {
    columns: DMatrix<f64>,
    factor: Cholesky<f64, Dyn>,
}

impl Projector {
    pub(in super::super) fn new(columns: DMatrix<f64>, precision: &[f64]) -> Self {
        Self {
            factor: factor(normal_matrix(&columns, precision)),
            columns,
        }
    }

    /// Of a model's own parameters and, with `nuisances`, the cameras' pose, made white.
    pub(in super::super) fn of_model(
        evaluation: &Evaluation,
        structure: &Structure,
        whitener: &Whitener,
        nuisances: bool,
    ) -> Self {
        let own = whitener.apply(&evaluation.whitened_jacobian());
        let (free, priors) = always_free(evaluation, whitener, (own, &structure.parameters()), nuisances);
        Self::new(free, &priors)
    }

    pub(in super::super) fn remove_vector(&self, v: &DVector<f64>) -> DVector<f64> {
        v - &self.columns * self.factor.solve(&self.columns.tr_mul(v))
    }

    pub(in super::super) fn remove(&self, m: &DMatrix<f64>) -> DMatrix<f64> {
        m - &self.columns * self.coefficients(m)
    }

    /// How much of each free column stands in each column of `m`.
    pub(super) fn coefficients(&self, m: &DMatrix<f64>) -> DMatrix<f64> {
        self.factor.solve(&self.columns.tr_mul(m))
    }
}

#[cfg(test)]
mod tests {
    use super::super::ScoreProblem;
    use super::*;
    use crate::bench_diagnosis::noise::{CORRELATION, correlated};
    use crate::diagnose::noise::tests::{LIKE_THE_BENCHMARKS, rows_of};
    use crate::effects;
    use crate::observe::Row;

    const FRAMES: usize = 12;
    const STATIONS: usize = 8;

    /// A rope that answers in proportion: the score of a tilt foretells what a refit with it takes away, wherever in the
    /// valley of its other parameters the refit ends.
    #[test]
    fn a_refit_takes_away_what_its_score_said_where_the_rope_answers_in_proportion() {
        let noise = |seed| correlated(FRAMES, STATIONS, 0.001, CORRELATION, seed);
        let (known, tilt) = (Structure::default(), effects::find("tilted_gravity").unwrap());
        let wide = Structure::default().with(tilt);
        // Slopes of a metre per unit: what a thousandth of a unit does is as large as the noise.
        let slope = |seed| DVector::from_vec(noise(seed).into_iter().flatten().flatten().collect()) * 1e3;
        let slopes = DMatrix::from_columns(&[1, 2, 3, 4].map(slope));
        let rows = rows_of(&noise(5), FRAMES);
        let at = |theta: [f64; 4], structure: &Structure| {
            let moved = &slopes * DVector::from_column_slice(&theta);
            let off = |(row, moved_m): (&Row, &f64)| Row {
                offset_m: row.offset_m + moved_m,
                ..*row
            };
            Evaluation {
                theta: structure.start(1e6),
                rows: vec![rows.iter().zip(&moved).map(off).collect()],
                most_rows: rows.len(),
                huber: f64::INFINITY,
                jacobian: slopes.columns(0, structure.parameters().len()).into_owned(),
            }
        };
        let (before, after) = ([2e-3, -1e-3, 3e-3, 1e-3], [1e-3, -1e-3, 5e-4, -1e-3]);
        for nuisances in [true, false] {
            let problem =
                ScoreProblem::new(&at(before, &wide), &wide, &known, &LIKE_THE_BENCHMARKS, nuisances);
            let said = problem.table(DVector::zeros(rows.len()), 0.0, 1).scores[0].statistic;
            let left = |theta, structure| {
                whitened_left(&at(theta, structure), structure, &LIKE_THE_BENCHMARKS, nuisances)
            };
            let taken_away = left(before, &known) - left(after, &wide);
            assert!(
                said > 100.0 && (taken_away / said - 1.0).abs() < 1e-2,
                "{taken_away} for {said}"
            );
        }
    }
}
