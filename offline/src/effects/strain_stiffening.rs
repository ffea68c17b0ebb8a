//! A rope that grows stiffer with strain along its axis: the first term of a symmetric stress-strain
//! curve beyond the linear one, σ = E ε (1 + c ε²) with ε = λ − 1 the nominal strain of the axis
//! direction, a fibre energy of the stretch λ = |F e_s| alone.

use super::{EffectSpec, ParameterSpec, Quantity, Slope};
use crate::sim::elastic::Lame;
use crate::sim::physics::AxialLaw;
use crate::sim::{Physics, Real};

/// What the effect is.
pub const SPEC: EffectSpec = EffectSpec {
    id: "strain_stiffening",
    title: "strain stiffening",
    equation: "ψ = c E (λ - 1)⁴/4",
    source: "fibre energy of the stretch as in Holzapfel, Gasser and Ogden (2000), lowest nonlinear order",
    nuisance: false,
    of_the_rig: false,
    only_seen: false,
    quantity: Quantity::Itself,
    at_its_end: None,
    parameters: &[ParameterSpec {
        name: "coefficient",
        unit: "1",
        vanishes_at: 0.0,
        low: 0.0,
        high: 200.0,
        smallest_of_interest: 1.0,
        slope: Slope::Tangent,
        sideways: false,
    }],
};

struct StrainStiffening<T> {
    coefficient: T,
}

impl<T: Real> AxialLaw<T> for StrainStiffening<T> {
    fn cubic_pa(&self, lame: &Lame<T>) -> T {
        self.coefficient * lame.young_pa()
    }
}

/// Adds the effect to a physics.
pub fn add_to<T: Real>(values: &[T], physics: &mut Physics<T>) {
    physics.axial_laws.push(Box::new(StrainStiffening {
        coefficient: values[0],
    }));
}
