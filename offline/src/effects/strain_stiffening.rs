//! A rope that grows stiffer with strain along its axis: the first term of a symmetric stress-strain
//! curve beyond the linear one, σ = E ε (1 + c ε²) with ε = λ − 1 the nominal strain of the axis
//! direction, a fibre energy of the stretch λ = |F e_s| alone.

use super::{EffectSpec, ParameterSpec, Slope};
use crate::sim::elastic::Lame;
use crate::sim::physics::{StressLaw, StressPoint};
use crate::sim::tensor::{Mat3, dot};
use crate::sim::{Physics, Real};

/// Strain up to which the time step provides for the growing stiffness.
const DESIGN_STRAIN: f64 = 0.1;

/// What the effect is.
pub const SPEC: EffectSpec = EffectSpec {
    id: "strain_stiffening",
    title: "strain stiffening",
    equation: "ψ = c E (λ - 1)⁴/4",
    source: "fibre energy of the stretch as in Holzapfel, Gasser and Ogden (2000), lowest nonlinear order",
    nuisance: false,
    only_seen: false,
    parameters: &[ParameterSpec {
        name: "coefficient",
        unit: "1",
        vanishes_at: 0.0,
        low: 0.0,
        high: 200.0,
        smallest_of_interest: 1.0,
        slope: Slope::Tangent,
    }],
};

struct StrainStiffening<T> {
    coefficient: T,
}

impl<T: Real> StressLaw<T> for StrainStiffening<T> {
    /// τ = P Fᵀ with P = c E (λ − 1)³ (F e_s/λ) ⊗ e_s.
    fn kirchhoff_pa(&self, point: &StressPoint<T>) -> Mat3<T> {
        let f = point.deformation_gradient;
        let axis = [f[0][0], f[1][0], f[2][0]];
        let stretch = dot(axis, axis).sqrt();
        let strain = stretch - T::one();
        let scale = self.coefficient * point.lame.young_pa() * strain * strain * strain / stretch;
        axis.map(|a| axis.map(|b| scale * a * b))
    }

    fn energy_j_m3(&self, point: &StressPoint<T>) -> Option<T> {
        let f = point.deformation_gradient;
        let axis = [f[0][0], f[1][0], f[2][0]];
        let strain = dot(axis, axis).sqrt() - T::one();
        let square = strain * strain;
        Some((self.coefficient * point.lame.young_pa() * square * square).scale(0.25))
    }

    fn modulus_pa(&self, lame: &Lame<T>) -> T {
        (self.coefficient * lame.young_pa()).scale(3.0 * DESIGN_STRAIN * DESIGN_STRAIN)
    }
}

/// Adds the effect to a physics.
pub fn add_to<T: Real>(values: &[T], physics: &mut Physics<T>) {
    physics.stress_laws.push(Box::new(StrainStiffening {
        coefficient: values[0],
    }));
}
