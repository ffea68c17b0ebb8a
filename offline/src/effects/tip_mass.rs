//! A mass at the free end (s = length): a knot, tape, a ferrule, a weight. It sits in the
//! last slice of the rope; it has weight and inertia but no size and no stiffness. A weight whose centre hangs beyond the end
//! has a longer lever, which takes more mass here: the rope's length is then declared up to that centre.

use super::{EffectSpec, ParameterSpec, Quantity, Slope};
use crate::sim::physics::MassLaw;
use crate::sim::rope::RopeLayout;
use crate::sim::{Physics, Real};

/// What the effect is.
pub const SPEC: EffectSpec = EffectSpec {
    id: "tip_mass",
    title: "tip mass",
    equation: "m(s) = ρ A + m_tip δ(s - L)",
    source: "point mass at the end, in the last slice",
    nuisance: false,
    of_the_rig: false,
    only_seen: false,
    quantity: Quantity::Itself,
    at_its_end: Some(
        "a weight whose centre hangs beyond the rope's end pulls with a longer lever, for which this takes more mass: declare \
         the rope's length up to the weight's centre",
    ),
    parameters: &[ParameterSpec {
        name: "mass_kg",
        unit: "kg",
        vanishes_at: 0.0,
        low: 0.0,
        // Half a kilogram: what hangs from cables that a robot carries.
        high: 0.5,
        smallest_of_interest: 0.001,
        slope: Slope::Tangent,
        sideways: false,
    }],
};

struct TipMass<T> {
    mass_kg: T,
}

impl<T: Real> MassLaw<T> for TipMass<T> {
    fn change_masses_kg(&self, layout: &RopeLayout, masses_kg: &mut [T]) {
        let members = layout.section_m.len();
        let first = masses_kg.len() - members;
        for mass in &mut masses_kg[first..] {
            *mass += self.mass_kg.scale(1.0 / members as f64);
        }
    }
}

/// Adds the effect to a physics.
pub fn add_to<T: Real>(values: &[T], physics: &mut Physics<T>) {
    physics.mass_laws.push(Box::new(TipMass { mass_kg: values[0] }));
}
