//! The stiffness of particles that meet the same nodes, summed up in one block before it goes to a tangent matrix: a row of
//! its entries stays in registers while all of them are added, and a place in the matrix is looked for once.

use super::band::Band;
use super::grid::STENCIL;
use super::widest::on_widest;
use std::ops::Range;

/// A number for each node of a stencil, and zeros to fill whole registers.
pub(super) type PerNode = [f64; 32];
/// ∂P/∂F of a particle as [a][b][c][d] = ∂P_ab/∂F_cd, Pa.
pub(super) type StressSlope = [[[[f64; 3]; 3]; 3]; 3];
/// Axes of a force and of a motion. The matrix is symmetric, so the other three pairs are these with their nodes changed over.
const PAIRS: [[usize; 2]; 6] = [[0, 0], [1, 1], [2, 2], [1, 0], [2, 0], [2, 1]];

/// Numbers by the node that is pushed and the node that moves.
pub(super) type Rows = [PerNode; STENCIL];
pub(super) const NOTHING: Rows = [[0.0; 32]; STENCIL];

/// The stiffness of some particles, N/m.
pub(super) struct Block {
    /// By [`PAIRS`].
    rows: Vec<Rows>,
}

/// A volume whose deformation gradient varies with the nodes of a stencil.
pub(super) struct Elastic {
    /// That gradient's derivative with respect to each node, by axis, 1/m.
    pub(super) gradients: [PerNode; 3],
    pub(super) slope: StressSlope,
    pub(super) volume_m3: f64,
}

/// A number for each node of a stencil.
pub(super) fn per_node(number: impl Fn(usize) -> f64) -> PerNode {
    std::array::from_fn(|entry| if entry < STENCIL { number(entry) } else { 0.0 })
}

impl Block {
    /// Nothing.
    pub(super) fn new() -> Self {
        Self {
            rows: vec![NOTHING; PAIRS.len()],
        }
    }

    /// Nothing again.
    pub(super) fn clear(&mut self) {
        self.rows.fill(NOTHING);
    }

    /// Adds the stiffness of volumes.
    pub(super) fn add_elastic(&mut self, volumes: &[Elastic]) {
        let mut moved = vec![[[0.0; 32]; 3]; volumes.len()];
        let moved = &mut moved[..];
        for (rows, pair) in self.rows.iter_mut().zip(PAIRS) {
            on_widest!(add_pair(rows: &mut Rows, moved: &mut [[PerNode; 3]], pair: [usize; 2], volumes: &[Elastic]) -> ());
        }
    }

    /// Adds a spring along some axes at a point that is a weighted mean of the nodes.
    pub(super) fn add_spring(&mut self, axes: Range<usize>, weights: &PerNode, stiffness_n_m: f64) {
        let mut rows = NOTHING;
        for (row, weight) in rows.iter_mut().zip(weights) {
            *row = weights.map(|other| stiffness_n_m * weight * other);
        }
        self.add_along(axes, &rows);
    }

    /// Adds a stiffness that is the same along some axes.
    pub(super) fn add_along(&mut self, axes: Range<usize>, stiffness_n_m: &Rows) {
        for rows in &mut self.rows[axes] {
            for (row, more) in rows.iter_mut().zip(stiffness_n_m) {
                for (sum, more) in row.iter_mut().zip(more) {
                    *sum += more;
                }
            }
        }
    }

    /// Adds all of it to a matrix, in which the nodes have the rows `at`.
    pub(super) fn add_to(&self, matrix: &mut Band, at: &[usize; STENCIL]) {
        let [xx, yy, zz, yx, zx, zy] = &self.rows[..] else {
            unreachable!("a block has six pairs of axes");
        };
        for column in 0..STENCIL {
            for row in (0..STENCIL).filter(|&row| at[row] >= at[column]) {
                let by_motion = [
                    [xx[row][column], yx[row][column], zx[row][column]],
                    [yx[column][row], yy[row][column], zy[row][column]],
                    [zx[column][row], zy[column][row], zz[row][column]],
                ];
                for (c, forces) in by_motion.iter().enumerate() {
                    let above = if row == column { c } else { 0 };
                    matrix.add_column(at[row] + above, at[column] + c, &forces[above..]);
                }
            }
        }
    }
}

/// Adds the stiffness of volumes for one pair of axes; `moved` is room for what each volume's stress changes by.
#[inline(always)]
fn add_pair(rows: &mut Rows, moved: &mut [[PerNode; 3]], [a, c]: [usize; 2], volumes: &[Elastic]) {
    for (moved, volume) in moved.iter_mut().zip(volumes) {
        for (b, stress) in moved.iter_mut().enumerate() {
            let slope = volume.slope[a][b][c].map(|slope| volume.volume_m3 * slope);
            for (node, stress) in stress.iter_mut().enumerate() {
                let gradient = volume.gradients.each_ref().map(|along| along[node]);
                *stress = slope[0] * gradient[0] + slope[1] * gradient[1] + slope[2] * gradient[2];
            }
        }
    }
    for (node, row) in rows.iter_mut().enumerate() {
        let mut sums = *row;
        for (moved, volume) in moved.iter().zip(volumes) {
            for (stress, along) in moved.iter().zip(&volume.gradients) {
                let gradient = along[node];
                for (sum, stress) in sums.iter_mut().zip(stress) {
                    *sum += gradient * stress;
                }
            }
        }
        *row = sums;
    }
}

#[cfg(test)]
mod tests {
    use super::super::stiffness::{add_spring, add_stiffness};
    use super::*;

    /// A block adds what its volumes and springs add one by one, wherever their nodes stand in the matrix.
    #[test]
    fn a_block_is_the_sum_of_its_volumes_and_springs() {
        const SIZE: usize = 3 * 40;
        let number = |k: usize| ((k * k + 7 * k) % 101) as f64 / 101.0 - 0.4;
        let at: [usize; STENCIL] = std::array::from_fn(|entry| 3 * ((entry * 11) % 40));
        let mut slope = [[[[0.0; 3]; 3]; 3]; 3];
        for k in 0..81 {
            let [a, b, c, d] = [k / 27, k / 9 % 3, k / 3 % 3, k % 3];
            slope[a][b][c][d] = number(k.min(27 * c + 9 * d + 3 * a + b));
        }
        let volume = |seed: usize| Elastic {
            gradients: [0, 1, 2].map(|axis| per_node(|entry| number(seed + 3 * entry + axis))),
            slope,
            volume_m3: number(seed) + 1.0,
        };
        let volumes = [1, 2, 3].map(volume);
        let weights = per_node(|entry| number(5 * entry));
        let (mut expected, mut found) = (Band::new(SIZE, SIZE - 1), Band::new(SIZE, SIZE - 1));
        for volume in &volumes {
            let gradients: [[f64; 3]; STENCIL] =
                std::array::from_fn(|entry| volume.gradients.map(|along| along[entry]));
            add_stiffness(&mut expected, &at, &gradients, &slope, volume.volume_m3);
        }
        add_spring(&mut expected, (&at, &weights[..STENCIL]), 2.0);
        let mut block = Block::new();
        block.add_elastic(&volumes[..1]);
        block.clear();
        block.add_elastic(&volumes);
        block.add_spring(0..3, &weights, 2.0);
        block.add_to(&mut found, &at);
        let entries = (0..SIZE).flat_map(|j| (j..SIZE).map(move |i| (i, j)));
        for (i, j) in entries {
            let [a, b] = [&expected, &found].map(|matrix| matrix.entry(i, j));
            assert!((a - b).abs() < 1e-12, "({i}, {j}): {a} {b}");
        }
    }
}
