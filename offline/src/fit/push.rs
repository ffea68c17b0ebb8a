//! How a rope moves when something pushes it that no effect describes: slopes of what is measured with respect to a
//! force along the rope, and the rope under such a force.

use super::problem::{FitError, Problem};
use super::sensitivity::frames_of;
use crate::model::Structure;
use crate::observe::{Row, bracket, interpolate};
use crate::sim::dual::Dual;
use crate::sim::physics::ForceField;
use crate::sim::real::{Arithmetic, Float};
use crate::sim::{Laned, Real, Rollout};
use nalgebra::DMatrix;
use rayon::prelude::*;

/// Knots along the free rope.
pub const KNOTS: usize = 4;
/// Tangents of one pass: every push of one block of time.
const OF_BLOCK: usize = 3 * KNOTS;

/// Forces per length of one demonstration, constant within blocks of time and linear in arc length between knots.
/// Their components are counted by block, knot and axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Pushes {
    /// Length of a block, s; the first starts at zero.
    pub block_s: f64,
    /// Number of blocks.
    pub blocks: usize,
    /// Arc lengths of the knots, m: the free rope's ends, and evenly between. What is gripped is not pushed.
    pub knots_m: [f64; KNOTS],
}

impl Pushes {
    /// Number of components.
    pub fn components(&self) -> usize {
        self.blocks * OF_BLOCK
    }

    /// Whether there is a force in a block.
    fn acts(&self, block: usize, force_n_m: &[f64]) -> bool {
        force_n_m[block * OF_BLOCK..][..OF_BLOCK]
            .iter()
            .any(|&f| f != 0.0)
    }

    /// Weight of a knot at an arc length.
    fn weight(&self, knot: usize, arc_m: f64) -> f64 {
        if arc_m < self.knots_m[0] || arc_m > self.knots_m[KNOTS - 1] {
            return 0.0;
        }
        let (low, share) = bracket(&self.knots_m, arc_m);
        match knot {
            k if k == low => 1.0 - share,
            k if k == low + 1 => share,
            _ => 0.0,
        }
    }

    /// The field with a value for each component; blocks for which `pushes` does not hold have none.
    fn field<T: Real>(
        &self,
        arcs_m: &[f64],
        pushes: impl Fn(usize) -> bool,
        component: impl Fn(usize) -> T,
    ) -> ForceField<T> {
        let force = |block: usize, arc_m: f64, axis: usize| {
            let mut sum = T::zero();
            for knot in 0..KNOTS {
                let weight = self.weight(knot, arc_m);
                if weight != 0.0 {
                    sum += component(block * OF_BLOCK + 3 * knot + axis).scale(weight);
                }
            }
            sum
        };
        let slices = |block: usize| {
            let at = |&arc_m: &f64| [0, 1, 2].map(|axis| force(block, arc_m, axis));
            let pushed = pushes(block).then(|| arcs_m.iter().map(at).collect());
            pushed.unwrap_or_default()
        };
        ForceField {
            block_s: self.block_s,
            force_n_m: (0..self.blocks).map(slices).collect(),
        }
    }
}

impl Problem<'_> {
    /// One demonstration under pushes, N/m by component.
    ///
    /// # Errors
    /// The simulation stopped.
    pub fn pushed(
        &self,
        demo: usize,
        structure: &Structure,
        theta: &[f64],
        (pushes, force_n_m): (&Pushes, &[f64]),
    ) -> Result<Rollout<f32>, FitError> {
        let arcs_m = self.arcs_m(demo);
        let theta: Vec<f32> = theta.iter().map(|&t| t as f32).collect();
        let acts = |block| pushes.acts(block, force_n_m);
        let field = pushes.field(&arcs_m, acts, |k| force_n_m[k] as f32);
        self.rollout_under(demo, structure, &theta, Some(field))
    }

    /// Slope of every row of one demonstration with respect to each component, m per N/m, where the rope is pushed by
    /// `force_n_m` already.
    ///
    /// # Errors
    /// A simulation stopped.
    pub fn push_slopes(
        &self,
        demo: usize,
        structure: &Structure,
        theta: &[f64],
        at: (&Pushes, &[f64]),
        rows: &[Row],
    ) -> Result<DMatrix<f64>, FitError> {
        let of_block = |block: usize| {
            if self.hangs() {
                self.slopes_of_block::<f64>(demo, structure, theta, at, (block, rows))
            } else {
                self.slopes_of_block::<f32>(demo, structure, theta, at, (block, rows))
            }
        };
        let blocks: Vec<DMatrix<f64>> = (0..at.0.blocks)
            .into_par_iter()
            .map(of_block)
            .collect::<Result<_, _>>()?;
        let mut slopes = DMatrix::zeros(rows.len(), at.0.components());
        for (block, columns) in blocks.iter().enumerate() {
            slopes.columns_mut(block * OF_BLOCK, OF_BLOCK).copy_from(columns);
        }
        Ok(slopes)
    }

    fn slopes_of_block<F: Float>(
        &self,
        demo: usize,
        structure: &Structure,
        theta: &[f64],
        (pushes, force_n_m): (&Pushes, &[f64]),
        (block, rows): (usize, &[Row]),
    ) -> Result<DMatrix<f64>, FitError>
    where
        Dual<F, OF_BLOCK>: Laned,
    {
        let arcs_m = self.arcs_m(demo);
        let first = block * OF_BLOCK;
        let acts = |other| other == block || pushes.acts(other, force_n_m);
        let field = pushes.field(&arcs_m, acts, |k| match k.checked_sub(first) {
            Some(lane) if lane < OF_BLOCK => Dual::input(force_n_m[k], lane),
            _ => Dual::of(force_n_m[k]),
        });
        let theta: Vec<Dual<F, OF_BLOCK>> = theta.iter().map(|&t| Dual::of(t)).collect();
        let rollout = self.rollout_under(demo, structure, &theta, Some(field))?;
        let mut slopes = DMatrix::zeros(rows.len(), OF_BLOCK);
        for lane in 0..OF_BLOCK {
            let frames = frames_of(&rollout.frames, lane);
            for (i, row) in rows.iter().enumerate() {
                let slope = interpolate(&frames[row.frame], bracket(&rollout.arc_m, row.arc_m));
                slopes[(i, lane)] = (0..3).map(|c| row.direction[c] * slope[c]).sum();
            }
        }
        Ok(slopes)
    }

    fn arcs_m(&self, demo: usize) -> Vec<f64> {
        self.scenes[demo]
            .layout()
            .slices
            .iter()
            .map(|s| s.arc_m)
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_knots_share_a_push_and_leave_the_grip_alone() {
        let pushes = Pushes {
            block_s: 0.1,
            blocks: 2,
            knots_m: [0.1, 0.2, 0.3, 0.4],
        };
        let field = pushes.field(&[0.05, 0.1, 0.25, 0.39, 0.4], |block| block == 1, |_| 1.0);
        assert_eq!(
            [field.block(0.05), field.block(0.15), field.block(0.25)],
            [None, Some(1), None]
        );
        let along: Vec<f64> = field.force_n_m[1].iter().map(|force| force[2]).collect();
        for (got, wanted) in along.iter().zip([0.0, 1.0, 1.0, 1.0, 1.0]) {
            assert!((got - wanted).abs() < 1e-12, "{along:?}");
        }
    }
}
