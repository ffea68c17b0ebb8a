//! A bending stiffness that does not follow from the axial one: strands that slide on each other bend
//! more easily than a solid, a stiff sheath makes a rope bend less. Axial stiffness stays E A.

use super::{EffectSpec, ParameterSpec, Quantity, Slope};
use crate::sim::physics::BendingLaw;
use crate::sim::rope::RopeLayout;
use crate::sim::{Physics, Real};

/// What the effect is.
pub const SPEC: EffectSpec = EffectSpec {
    id: "bending_ratio",
    title: "bending to axial stiffness",
    equation: "EI = r E π R⁴/4, EA = E π R²",
    source: "Papailiou, On the bending stiffness of transmission line conductors (1997): a cable lies between sliding and solid",
    nuisance: false,
    of_the_rig: false,
    only_seen: false,
    quantity: Quantity::Itself,
    at_its_end: None,
    parameters: &[ParameterSpec {
        name: "ratio",
        unit: "1",
        vanishes_at: 1.0,
        low: 0.05,
        high: 5.0,
        smallest_of_interest: 0.05,
        slope: Slope::Tangent,
        sideways: false,
    }],
};

struct BendingRatio<T> {
    ratio: T,
}

impl<T: Real> BendingLaw<T> for BendingRatio<T> {
    fn change_stiffness(&self, _layout: &RopeLayout, stiffness: &mut [T]) {
        for slice in stiffness {
            *slice = *slice * self.ratio;
        }
    }
}

/// Adds the effect to a physics.
pub fn add_to<T: Real>(values: &[T], physics: &mut Physics<T>) {
    physics
        .bending_laws
        .push(Box::new(BendingRatio { ratio: values[0] }));
}
