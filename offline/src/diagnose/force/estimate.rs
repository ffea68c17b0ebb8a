//! The force along a demonstration's rope: the smoothest one that takes away what any takes away, or all but noise.
//!
//! To first order what is measured changes linearly with the force, so it is a least-squares problem with a roughness
//! penalty (Tikhonov 1963). The penalty is the largest with which the noise, or nearly all that any force takes
//! away, is reached (discrepancy principle, Morozov 1966): the noise is known here, and choosing by left-out frames
//! would reward forces that follow noise which hangs together in time.

use super::motion::{Motion, motions};
use super::{BLOCKS, DemoForce};
use crate::demo::RopeEnd;
use crate::diagnose::noise::Noise;
use crate::diagnose::score::{Projector, whitened_vector};
use crate::fit::{Evaluation, FitError, KNOTS, Problem, Pushes};
use crate::model::Structure;
use crate::observe::Row;
use crate::sim::Scene;
use crate::sim::physics::GRAVITY_M_S2;
use nalgebra::{DMatrix, DVector};

/// Penalties tried, as powers of ten of the mean square slope, from the smoothest force on.
const PENALTIES: [i32; 2] = [4, -6];
/// Of what the roughest force takes away, a smoother one has to take away so much.
const ENOUGH: f64 = 0.9;

/// A demonstration's force, and what it was found from.
pub(super) struct Estimated {
    pub(super) force: DemoForce,
    /// How the rope moves, by block and knot.
    pub(super) motions: Vec<[Motion; KNOTS]>,
    /// Whitened residual, what the model's own parameters do taken out.
    pub(super) residual: DVector<f64>,
    /// Whitened slopes by component, the same taken out.
    pub(super) slopes: DMatrix<f64>,
    /// Block of time of every row.
    pub(super) blocks: Vec<usize>,
    /// Sum of squared offsets above the noise's, m²: of the model, and simulated under the force.
    pub(super) excess_m2: [f64; 2],
    /// Weight of a metre of rope, N.
    pub(super) weight_n_m: f64,
}

/// The force of a problem's one demonstration.
pub(super) fn estimate(
    problem: &Problem,
    structure: &Structure,
    theta: &[f64],
    noise: &Noise,
) -> Result<Estimated, FitError> {
    let scene = &problem.scenes[0];
    let pushes = pushes(scene);
    let evaluation = problem.evaluate(structure, theta)?;
    let rows = &evaluation.rows[0];
    let slopes = problem.push_slopes(0, structure, theta, &pushes, rows)?;
    let whitener = noise.whitener(&evaluation);
    let free = Projector::of_model(&evaluation, structure, &whitener, false);
    let residual = free.remove_vector(&whitened_vector(&whitener, evaluation.whitened()));
    let slopes = free.remove(&whitener.apply(&evaluation.over_noise(slopes)));
    let force = smoothest(&slopes, &residual);
    let alone = problem.predict_under(0, structure, theta, None)?;
    let pushed = problem.predict_under(0, structure, theta, Some((&pushes, force.as_slice())))?;
    let under = problem.residuals_of(theta, &[pushed])?;
    let at = |block: usize, knot: usize| std::array::from_fn(|k| force[3 * (block * KNOTS + knot) + k]);
    Ok(Estimated {
        motions: motions(scene, &alone, &pushes),
        force: DemoForce {
            demo: problem.demos[0].name.clone(),
            block_s: pushes.block_s,
            knots_m: pushes.knots_m,
            force_n_m: (0..BLOCKS)
                .map(|block| std::array::from_fn(|knot| at(block, knot)))
                .collect(),
        },
        blocks: rows
            .iter()
            .map(|row| block_of(scene.frame_times_s[row.frame], &pushes))
            .collect(),
        excess_m2: [excess_m2(&evaluation), excess_m2(&under)],
        residual,
        slopes,
        weight_n_m: scene.rope.mass_kg / scene.rope.length_m * GRAVITY_M_S2,
    })
}

/// The block of time in which something at `t_s` counts.
pub(super) fn block_of(t_s: f64, pushes: &Pushes) -> usize {
    ((t_s / pushes.block_s) as usize).min(pushes.blocks - 1)
}

fn pushes(scene: &Scene) -> Pushes {
    let gripped = |end: RopeEnd| {
        let grip = scene.grips.iter().find(|grip| grip.end == end);
        grip.map_or(0.0, |grip| grip.length_m)
    };
    let first_m = gripped(RopeEnd::Start);
    let last_m = scene.rope.length_m - gripped(RopeEnd::End);
    Pushes {
        block_s: scene.duration_s / BLOCKS as f64,
        blocks: BLOCKS,
        knots_m: std::array::from_fn(|k| first_m + (last_m - first_m) * k as f64 / (KNOTS - 1) as f64),
    }
}

fn excess_m2(evaluation: &Evaluation) -> f64 {
    let square = |row: &Row| row.offset_m.powi(2) - row.sigma_m.powi(2);
    evaluation.all_rows().map(square).sum::<f64>().max(0.0)
}

/// The smoothest force that reaches what [`ENOUGH`] asks for.
fn smoothest(slopes: &DMatrix<f64>, residual: &DVector<f64>) -> DVector<f64> {
    let (hessian, gradient) = (slopes.tr_mul(slopes), slopes.tr_mul(residual));
    let scale = hessian.trace() / hessian.nrows() as f64;
    let roughness = roughness();
    let solve = |power: i32| {
        let penalty = &roughness * (scale * 10f64.powi(power));
        let factor = (&hessian + penalty).cholesky();
        factor.map_or_else(|| DVector::zeros(gradient.len()), |f| f.solve(&gradient))
    };
    let left = |force: &DVector<f64>| (residual - slopes * force).norm_squared();
    let [smooth, rough] = PENALTIES;
    let roughest = solve(rough);
    let before = residual.norm_squared();
    let wanted = (before - ENOUGH * (before - left(&roughest))).max(residual.len() as f64);
    let mut smoother = (rough + 1..=smooth).rev().map(solve);
    smoother.find(|force| left(force) <= wanted).unwrap_or(roughest)
}

/// Squares of the components and of their changes from block to block and from knot to knot.
fn roughness() -> DMatrix<f64> {
    let count = 3 * BLOCKS * KNOTS;
    let mut matrix = DMatrix::identity(count, count);
    let mut alike = |a: usize, b: usize| {
        matrix[(a, a)] += 1.0;
        matrix[(b, b)] += 1.0;
        matrix[(a, b)] -= 1.0;
        matrix[(b, a)] -= 1.0;
    };
    for component in 0..count {
        let knot = component / 3 % KNOTS;
        if component + 3 * KNOTS < count {
            alike(component, component + 3 * KNOTS);
        }
        if knot + 1 < KNOTS {
            alike(component, component + 3);
        }
    }
    matrix
}

#[cfg(test)]
mod tests {
    use super::super::super::revise::tests::{YOUNG_PA, options, recorded};
    use super::*;

    /// Slopes of rows that see one component each, with many rows per component.
    fn seen(rows: usize) -> DMatrix<f64> {
        let count = 3 * BLOCKS * KNOTS;
        DMatrix::from_fn(rows * count, count, |i, k| if i % count == k { 5.0 } else { 0.0 })
    }

    #[test]
    fn a_force_that_noise_does_not_hide_is_found() {
        let slopes = seen(4);
        let truth = DVector::from_element(slopes.ncols(), 2.0);
        let found = smoothest(&slopes, &(&slopes * &truth));
        assert!(
            (&found - &truth).norm() < 0.35 * truth.norm(),
            "{}",
            (&found - &truth).norm()
        );
    }

    /// Two thirds of the tangents do for a planar motion, and are the same ones.
    #[test]
    fn a_planar_motion_is_not_asked_what_pushes_it_across_its_plane() {
        let mut demo = recorded(&[])[0].clone();
        let (structure, theta) = (Structure::default(), [YOUNG_PA.ln(), 0.3]);
        demo.spec.planar = true;
        let problem = Problem::new(&[&demo], options().resolution).unwrap();
        let rows = problem.residuals(&structure, &theta).unwrap().rows.remove(0);
        let pushes = Pushes {
            block_s: problem.scenes[0].duration_s,
            blocks: 1,
            ..pushes(&problem.scenes[0])
        };
        let planar = problem
            .push_slopes(0, &structure, &theta, &pushes, &rows)
            .unwrap();
        demo.spec.planar = false;
        let problem = Problem::new(&[&demo], options().resolution).unwrap();
        let all = problem
            .push_slopes(0, &structure, &theta, &pushes, &rows)
            .unwrap();
        for (k, (planar, all)) in planar.column_iter().zip(all.column_iter()).enumerate() {
            if k % 3 == 1 {
                assert_eq!(planar.amax(), 0.0);
            } else {
                assert!(
                    all.amax() > 0.0 && (planar - all).amax() <= 1e-3 * all.amax(),
                    "{k}"
                );
            }
        }
    }

    #[test]
    fn noise_needs_no_force() {
        let slopes = seen(4);
        let noise = DVector::from_fn(slopes.nrows(), |i, _| if i % 2 == 0 { 1.0 } else { -1.0 });
        assert!(smoothest(&slopes, &noise).norm() < 1e-3);
    }
}
