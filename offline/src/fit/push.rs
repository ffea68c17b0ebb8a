//! How a rope moves when something pushes it that no effect describes: the field of such a force, and the slopes of
//! what is measured with respect to it.

use super::problem::{FitError, Problem};
use super::sensitivity::frames_of;
use crate::model::Structure;
use crate::observe::{Row, bracket};
use crate::sim::dual::Dual;
use crate::sim::physics::ForceField;
use crate::sim::real::Arithmetic;
use crate::sim::tensor::Vec3;
use crate::sim::{Real, Scene};
use nalgebra::DMatrix;
use rayon::prelude::*;

/// Knots along the free rope.
pub const KNOTS: usize = 4;
/// Components of one block of time: every axis at every knot.
const OF_BLOCK: usize = 3 * KNOTS;
/// Those of them in the plane of a planar motion.
const IN_PLANE: usize = 2 * KNOTS;

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

    /// The field of a force, N/m by component.
    pub(super) fn field<T: Real>(&self, scene: &Scene, force_n_m: &[f64]) -> ForceField<T> {
        let of_block = |block: usize| Some(std::array::from_fn(|k| T::of(force_n_m[block * OF_BLOCK + k])));
        self.field_of(&arcs_m(scene), of_block)
    }

    /// The field whose blocks have these components; a block without any has no force.
    fn field_of<T: Real>(
        &self,
        arcs_m: &[f64],
        of_block: impl Fn(usize) -> Option<[T; OF_BLOCK]>,
    ) -> ForceField<T> {
        let at = |components: &[T; OF_BLOCK], arc_m: f64| -> Vec3<T> {
            std::array::from_fn(|axis| {
                (0..KNOTS).fold(T::zero(), |sum, knot| {
                    sum + components[3 * knot + axis].scale(self.weight(knot, arc_m))
                })
            })
        };
        let slices = |block: usize| match of_block(block) {
            Some(components) => arcs_m.iter().map(|&arc_m| at(&components, arc_m)).collect(),
            None => Vec::new(),
        };
        ForceField {
            block_s: self.block_s,
            force_n_m: (0..self.blocks).map(slices).collect(),
        }
    }
}

fn arcs_m(scene: &Scene) -> Vec<f64> {
    scene.layout().slices.iter().map(|slice| slice.arc_m).collect()
}

impl Problem<'_> {
    /// Slope of every row of one demonstration with respect to each component, m per N/m, where nothing pushes. Across the
    /// plane of a rope that stays in one, nothing is known; slopes there are zero, as are those of poses at rest, which are
    /// found without pushes.
    ///
    /// # Errors
    /// A simulation stopped.
    pub fn push_slopes(
        &self,
        demo: usize,
        structure: &Structure,
        theta: &[f64],
        pushes: &Pushes,
        rows: &[Row],
    ) -> Result<DMatrix<f64>, FitError> {
        if self.rests(demo) {
            return Ok(DMatrix::zeros(rows.len(), pushes.components()));
        }
        let planar = self.stays_in_plane(demo);
        let of_block = |block: usize| {
            let asked = (block, rows);
            if planar {
                self.slopes_of_block::<IN_PLANE>(demo, structure, theta, pushes, asked)
            } else {
                self.slopes_of_block::<OF_BLOCK>(demo, structure, theta, pushes, asked)
            }
        };
        let blocks: Vec<DMatrix<f64>> = (0..pushes.blocks)
            .into_par_iter()
            .map(of_block)
            .collect::<Result<_, _>>()?;
        let mut slopes = DMatrix::zeros(rows.len(), pushes.components());
        for (block, columns) in blocks.iter().enumerate() {
            slopes.columns_mut(block * OF_BLOCK, OF_BLOCK).copy_from(columns);
        }
        Ok(slopes)
    }

    /// The same for one block, with a lane for each axis that is asked about at every knot.
    fn slopes_of_block<const N: usize>(
        &self,
        demo: usize,
        structure: &Structure,
        theta: &[f64],
        pushes: &Pushes,
        (block, rows): (usize, &[Row]),
    ) -> Result<DMatrix<f64>, FitError> {
        let axes: &[usize] = if N == IN_PLANE { &[0, 2] } else { &[0, 1, 2] };
        let component = |lane: usize| 3 * (lane / axes.len()) + axes[lane % axes.len()];
        let input = |k: usize| match (0..N).find(|&lane| component(lane) == k) {
            Some(lane) => Dual::input(0.0, lane),
            None => Dual::of(0.0),
        };
        // A block without a force costs nothing.
        let inputs = |other: usize| (other == block).then(|| std::array::from_fn(input));
        let field = pushes.field_of(&arcs_m(&self.scenes[demo]), inputs);
        let theta: Vec<Dual<f32, N>> = theta.iter().map(|&t| Dual::of(t)).collect();
        let rollout = self.rollout_under(demo, structure, &theta, Some(field))?;
        let mut slopes = DMatrix::zeros(rows.len(), OF_BLOCK);
        for lane in 0..N {
            let frames = frames_of(&rollout.frames, lane);
            for (i, row) in rows.iter().enumerate() {
                slopes[(i, component(lane))] =
                    row.along(&frames[row.frame], bracket(&rollout.arc_m, row.arc_m));
            }
        }
        Ok(slopes)
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
        let field = pushes.field_of(&[0.05, 0.1, 0.25, 0.39, 0.4], |block| {
            (block == 1).then_some([1.0; OF_BLOCK])
        });
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
