//! The simulation's own error: how far predictions move on a finer grid, and how far that may have moved the
//! parameters.

use crate::fit::{Evaluation, FitError, Problem, shift_by};
use crate::model::Structure;
use crate::observe::{bracket, interpolate};

/// Estimated discretisation error of a prediction, m.
pub(super) struct GridError {
    arcs_m: Vec<f64>,
    frames: Vec<Vec<[f64; 3]>>,
}

/// Prediction on the finer grid minus prediction on the fit's, scaled up to the error that a method
/// of first order has left: a grid refined r times shows only 1 − 1/r of it.
pub(super) fn grid_errors(
    [fit, finer]: [&Problem; 2],
    structure: &Structure,
    theta: &[f64],
) -> Result<Vec<GridError>, FitError> {
    let (coarse, fine) = rayon::join(
        || fit.predict(structure, theta),
        || finer.predict(structure, theta),
    );
    let (coarse, fine) = (coarse?, fine?);
    let ratio = finer.scenes[0].grid.spacing_m / fit.scenes[0].grid.spacing_m;
    let scale = 1.0 / (1.0 - ratio);
    Ok(coarse
        .iter()
        .zip(&fine)
        .map(|(c, f)| GridError {
            arcs_m: c.arc_m.clone(),
            frames: c
                .frames
                .iter()
                .zip(&f.frames)
                .map(|(cf, ff)| {
                    cf.iter()
                        .zip(&c.arc_m)
                        .map(|(point, &s)| {
                            let on_fine = interpolate(ff, bracket(&f.arc_m, s));
                            std::array::from_fn(|k| scale * (on_fine[k] - f64::from(point[k])))
                        })
                        .collect()
                })
                .collect(),
        })
        .collect())
}

/// The errors along the direction of each row of an evaluation, m.
pub(super) fn along_rows(evaluation: &Evaluation, errors: &[GridError]) -> Vec<f64> {
    let mut along = Vec::with_capacity(evaluation.len());
    for (rows, error) in evaluation.rows.iter().zip(errors) {
        along.extend(rows.iter().map(|row| {
            let frame = &error.frames[row.frame];
            let error = interpolate(frame, bracket(&error.arcs_m, row.arc_m));
            (0..3).map(|k| row.direction[k] * error[k]).sum::<f64>()
        }));
    }
    along
}

/// How far the grid's error may have moved each entry of θ: to first order, and as large as it would be if the
/// error fell with the first power of the spacing.
pub(super) fn grid_shift(
    problems: [&Problem; 2],
    structure: &Structure,
    evaluation: &Evaluation,
) -> Result<Vec<f64>, FitError> {
    let errors = grid_errors(problems, structure, &evaluation.theta)?;
    Ok(shift_by(evaluation, structure, &along_rows(evaluation, &errors)))
}
