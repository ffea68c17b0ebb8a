//! The simulation's own error: how far predictions move on a finer grid or with other particles, and how far that may
//! have moved the parameters.

use super::problem::{Evaluation, FitError, Problem};
use super::uncertainty::shift_by;
use crate::model::Structure;
use crate::observe::{Row, bracket, interpolate};
use crate::sim::{Rollout, Scene};
use nalgebra::DVector;
use rayon::prelude::*;

/// Cells across the rope of a finer grid that tells the simulation's own error, over those of the fit's.
pub const FINER: f64 = 1.4;

/// Estimated discretisation error of a prediction, m.
pub struct GridError {
    arcs_m: Vec<f64>,
    frames: Vec<Vec<[f64; 3]>>,
}

/// Prediction on the finer grid minus prediction on the fit's, scaled up to the error that a method
/// of first order has left: a grid refined r times shows only 1 − 1/r of it.
///
/// # Errors
/// A simulation stopped.
pub fn grid_errors(
    [fit, finer]: [&Problem; 2],
    structure: &Structure,
    theta: &[f64],
) -> Result<Vec<GridError>, FitError> {
    let ratio = finer.scenes[0].grid.spacing_m / fit.scenes[0].grid.spacing_m;
    let (coarse, fine) = rayon::join(
        || fit.predict(structure, theta),
        || finer.predict(structure, theta),
    );
    Ok(differences(&coarse?, &fine?, 1.0 / (1.0 - ratio)))
}

/// How far other predictions lie from the usual ones, times a scale.
fn differences(usual: &[Rollout<f32>], other: &[Rollout<f32>], scale: f64) -> Vec<GridError> {
    let pairs = usual.iter().zip(other);
    pairs.map(|(u, o)| difference(u, o, scale)).collect()
}

/// The same of one demonstration.
pub(super) fn difference(usual: &Rollout<f32>, other: &Rollout<f32>, scale: f64) -> GridError {
    let of_frame = |(frame, other_frame): (&Vec<[f32; 3]>, &Vec<[f32; 3]>)| {
        let apart = |(point, &s): (&[f32; 3], &f64)| {
            let there = interpolate(other_frame, bracket(&other.arc_m, s));
            std::array::from_fn(|k| scale * (there[k] - f64::from(point[k])))
        };
        frame.iter().zip(&usual.arc_m).map(apart).collect()
    };
    GridError {
        arcs_m: usual.arc_m.clone(),
        frames: usual.frames.iter().zip(&other.frames).map(of_frame).collect(),
    }
}

/// The errors along the direction of each row of an evaluation, over its standard error.
pub fn over_noise(evaluation: &Evaluation, errors: &[GridError]) -> DVector<f64> {
    let of_demo = |(rows, error): (&Vec<Row>, &GridError)| -> Vec<f64> {
        let along = |row: &Row| {
            let error = interpolate(&error.frames[row.frame], bracket(&error.arcs_m, row.arc_m));
            (0..3).map(|k| row.direction[k] * error[k]).sum::<f64>() / row.sigma_m
        };
        rows.iter().map(along).collect()
    };
    let along: Vec<f64> = evaluation.rows.iter().zip(errors).flat_map(of_demo).collect();
    DVector::from_vec(along)
}

/// A change of how a scene is divided that is as good as none.
type Division = fn(&mut Scene);

/// Other divisions of the rope and of space, each as good as the fit's: a finer grid, thinner slices, another place
/// between the nodes. What each changes is one part of the simulation's own error. It is not scaled up as if it fell
/// with a power of the spacing, because from 1.5 to 4 cells it hardly does (`offline verify`, sag of a cantilever).
const DIVISIONS: [Division; 3] = [
    |scene| scene.lay_grid(FINER * scene.rope.diameter_m / scene.grid.spacing_m),
    |scene| scene.sampling.slice_cells /= 1.2,
    |scene| scene.grid.shift_cells = scene.grid.shift_cells.map(|shift| shift + 0.25),
];

/// How far the simulation's own error may have moved each entry of θ, as one standard error: how far each of the other
/// divisions of the scene would move it, to first order, added in squares as the independent errors that they are, and
/// with them what the noise of a start in motion would. What
/// lies between two divisions that are equally good has twice the variance of either's error, but the time step's error
/// and that of how cameras see a rope are in none: with half the squares the 95 % interval of E held the truth in 180 of
/// 200 demonstrations before noisy cameras (`offline reproduce coverage`).
///
/// # Errors
/// A simulation stopped.
pub fn grid_shift(
    problem: &Problem,
    structure: &Structure,
    evaluation: &Evaluation,
) -> Result<Vec<f64>, FitError> {
    let theta = &evaluation.theta;
    let problem = problem.settled(structure, theta)?;
    let usual = problem.predict_as_begun(structure, theta)?;
    let shift = |divide: &Division| {
        let mut other = problem.clone();
        other.scenes.iter_mut().for_each(divide);
        let errors = differences(&usual, &other.predict(structure, theta)?, 1.0);
        Ok(shift_by(evaluation, structure, &over_noise(evaluation, &errors)))
    };
    let mut shifts: Vec<Vec<f64>> = DIVISIONS.par_iter().map(shift).collect::<Result<_, FitError>>()?;
    for begun in problem.begun_again(structure, theta, &usual)? {
        let mut errors = differences(&usual, &usual, 0.0);
        for (d, error) in begun {
            errors[d] = error;
        }
        shifts.push(shift_by(evaluation, structure, &over_noise(evaluation, &errors)));
    }
    let of_entry = |k: usize| shifts.iter().map(|shift| shift[k].powi(2)).sum::<f64>().sqrt();
    Ok((0..theta.len()).map(of_entry).collect())
}
