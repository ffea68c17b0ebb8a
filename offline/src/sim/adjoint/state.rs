//! Derivatives of the result with respect to the state of the particles, in registers.

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

/// Sum over the lanes.
#[inline(always)]
pub(super) fn total<L: Lanes>(register: L) -> f64 {
    register.to_lanes().into_iter().map(Real::value).sum()
}
