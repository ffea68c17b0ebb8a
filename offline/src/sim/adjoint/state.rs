//! Derivatives of the result with respect to state and masses of the particles.

use crate::sim::lanes::Lanes;
use crate::sim::real::{Arithmetic, Real};
use crate::sim::tensor::{Mat3, Vec3};

/// Derivatives with respect to one member of as many slices as a register has lanes.
#[derive(Clone, Copy)]
pub(super) struct StateCotangent<L> {
    pub(super) deformation_gradient: Mat3<L>,
    pub(super) position: Vec3<L>,
    pub(super) velocity: Vec3<L>,
    /// With respect to dx Ḟ.
    pub(super) rate: Mat3<L>,
}

impl<L: Arithmetic> StateCotangent<L> {
    pub(super) fn zero() -> Self {
        let zero = [L::zero(); 3];
        Self {
            deformation_gradient: [zero; 3],
            position: zero,
            velocity: zero,
            rate: [zero; 3],
        }
    }
}

/// Derivatives with respect to the particles' masses.
pub(super) struct MassBars {
    /// Particle by particle, 1/kg.
    pub(super) by_particle: Vec<f64>,
    /// Members of a slice.
    pub(super) section: usize,
    /// Slices of the rope.
    pub(super) slices: usize,
}

impl MassBars {
    /// Adds values of a register, one per slice of a block, to those of a member.
    #[inline(always)]
    pub(super) fn add<L: Lanes>(&mut self, block: usize, member: usize, values: L) {
        let first = block * L::COUNT;
        let lanes = values.to_lanes();
        for (lane, value) in lanes.iter().enumerate().take(L::COUNT.min(self.slices - first)) {
            self.by_particle[(first + lane) * self.section + member] += value.value();
        }
    }
}

/// Sum over the lanes.
#[inline(always)]
pub(super) fn total<L: Lanes>(register: L) -> f64 {
    register.to_lanes().into_iter().map(Real::value).sum()
}
