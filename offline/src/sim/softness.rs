//! What grips whose pads give take from the stiffness of a rope at rest.
//!
//! A turn of a grip depends on all particles in it ([`super::pads`]), which would fill its part of the band of the
//! matrix. It has three numbers, though: with U the forces at the nodes per turn, and G the turn per torque, the slope of
//! the forces is that of rigid pads, K, less U G Uᵀ. Sherman, Morrison and Woodbury solve with it: with Y = K⁻¹ U,
//! (K − U G Uᵀ)⁻¹ = K⁻¹ + Y (1 − G Uᵀ Y)⁻¹ G Yᵀ, as K is symmetric.

use super::band::Factor;
use super::tensor::Mat3;
use nalgebra::{DMatrix, DVector};

/// The correction for one factorised matrix.
pub struct Softness {
    /// Y.
    moves: DMatrix<f64>,
    /// (1 − G Uᵀ Y)⁻¹ G Uᵀ, which knows the forces by what rigid pads would make of them.
    turns: DMatrix<f64>,
}

impl Softness {
    /// For the turns per torque of some grips, rad/(N m), and their forces per turn, N/rad.
    pub fn new(factor: &Factor, grips: Vec<(Mat3<f64>, [Vec<f64>; 3])>) -> Self {
        let columns: Vec<DVector<f64>> = grips
            .iter()
            .flat_map(|(_, pulls)| pulls)
            .map(|pull| DVector::from_column_slice(pull))
            .collect();
        let pulls = DMatrix::from_columns(&columns);
        let mut moves = pulls.clone();
        for mut column in moves.column_iter_mut() {
            factor.solve(column.as_mut_slice());
        }
        let mut turn_per_torque = DMatrix::zeros(columns.len(), columns.len());
        for (grip, (slope, _)) in grips.iter().enumerate() {
            for a in 0..3 {
                for b in 0..3 {
                    turn_per_torque[(3 * grip + a, 3 * grip + b)] = slope[a][b];
                }
            }
        }
        let turns = turn_per_torque * pulls.transpose();
        let own = DMatrix::identity(columns.len(), columns.len()) - &turns * &moves;
        // Singular only where the rope is in neutral equilibrium; rigid pads then lead away from there.
        let turns = own.lu().solve(&turns).unwrap_or_else(|| 0.0 * &turns);
        Self { moves, turns }
    }

    /// Makes of a solution with rigid pads the one with pads that give.
    pub fn correct(&self, x: &mut [f64]) {
        let turn = &self.turns * DVector::from_column_slice(x);
        let change = &self.moves * turn;
        for (x, change) in x.iter_mut().zip(change.iter()) {
            *x += change;
        }
    }
}
