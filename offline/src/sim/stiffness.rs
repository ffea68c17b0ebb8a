//! How a pose's tangent matrix is filled: the stiffness of volumes whose deformation gradient varies with nodes,
//! and springs at points between nodes.

use super::band::Band;
use super::dual::Dual;
use super::elastic::{Lame, piola_stress};
use super::real::Arithmetic;
use super::tensor::{Mat3, add, dot, scaled};
use super::widest::on_widest;
use std::collections::BTreeMap;

/// What the particles of a slice have in common, which has another stiffness where bending has its own.
#[derive(Default)]
pub(super) struct Common {
    /// Mean of the elastic deformation gradients.
    pub(super) elastic: Mat3<f64>,
    /// Its derivative with respect to each node, 1/m, by place in the matrix.
    pub(super) gradients: BTreeMap<usize, [f64; 3]>,
    /// Volume times the share of stiffness that it has for itself, m³; negative where bending is stiffer.
    pub(super) volume_m3: f64,
}

impl Common {
    pub(super) fn add(&mut self, elastic: &Mat3<f64>, at: &[usize], gradients: &[[f64; 3]], share: f64) {
        for (sum, row) in self.elastic.iter_mut().zip(elastic) {
            *sum = add(*sum, scaled(*row, share));
        }
        for (at, gradient) in at.iter().zip(gradients) {
            let sum = self.gradients.entry(*at).or_default();
            *sum = add(*sum, scaled(*gradient, share));
        }
    }
}

/// Adds the stiffness of a volume whose deformation gradient varies with the nodes at the rows `at` by `gradients`.
pub(super) fn add_stiffness(
    matrix: &mut Band,
    at: &[usize],
    gradients: &[[f64; 3]],
    slope: &[[[[f64; 3]; 3]; 3]; 3],
    volume_m3: f64,
) {
    on_widest!(add_stiffness_inlined(
        matrix: &mut Band,
        at: &[usize],
        gradients: &[[f64; 3]],
        slope: &[[[[f64; 3]; 3]; 3]; 3],
        volume_m3: f64
    ) -> ());
}

#[inline(always)]
fn add_stiffness_inlined(
    matrix: &mut Band,
    at: &[usize],
    gradients: &[[f64; 3]],
    slope: &[[[[f64; 3]; 3]; 3]; 3],
    volume_m3: f64,
) {
    for (&column, gradient) in at.iter().zip(gradients) {
        // ∂P/∂y of this node: rows (a, b), columns c, with a fourth to fill a register.
        let g = gradient.map(|x| volume_m3 * x);
        let entry = |a: usize, b: usize, c: usize| if c < 3 { dot(slope[a][b][c], g) } else { 0.0 };
        let block: [[[f64; 4]; 3]; 3] =
            std::array::from_fn(|a| std::array::from_fn(|b| std::array::from_fn(|c| entry(a, b, c))));
        for (&row, gradient) in at.iter().zip(gradients).filter(|(row, _)| **row >= column) {
            for a in 0..3 {
                let mut along = [0.0; 4];
                for b in 0..3 {
                    for c in 0..4 {
                        along[c] += gradient[b] * block[a][b][c];
                    }
                }
                let count = if row == column { a + 1 } else { 3 };
                matrix.add_row(row + a, column, &along[..count]);
            }
        }
    }
}

/// Adds a spring along some axes at a point that is a weighted mean of nodes.
pub(super) fn add_spring(
    matrix: &mut Band,
    (at, weights): (&[usize], &[f64]),
    axes: std::ops::Range<usize>,
    stiffness_n_m: f64,
) {
    for (&column, weight) in at.iter().zip(weights) {
        for (&row, other) in at.iter().zip(weights).filter(|(row, _)| **row >= column) {
            for k in axes.clone() {
                matrix.add(row + k, column + k, stiffness_n_m * weight * other);
            }
        }
    }
}

/// ∂P/∂F of the elastic rope as [a][b][c][d] = ∂P_ab/∂F_cd, Pa.
pub(super) fn stress_slope(f: &Mat3<f64>, lame: &Lame<f64>) -> [[[[f64; 3]; 3]; 3]; 3] {
    let dual: Mat3<Dual<f64, 9>> =
        std::array::from_fn(|a| std::array::from_fn(|b| Dual::input(f[a][b], 3 * a + b)));
    let lame = Lame {
        mu: Dual::of(lame.mu),
        lambda: Dual::of(lame.lambda),
    };
    let (pk1, _) = piola_stress(&dual, &lame);
    pk1.map(|row| row.map(|entry| std::array::from_fn(|c| std::array::from_fn(|d| entry.tangent[3 * c + d]))))
}
