//! A mass at the free end (s = length): a knot, tape, a ferrule. It is spread over the last
//! diameter of the rope, where such things sit, and it has weight and inertia but no stiffness.

use super::{EffectSpec, ParameterSpec};
use crate::sim::physics::MassLaw;
use crate::sim::rope::RopeLayout;
use crate::sim::{Physics, Real};

/// What the effect is.
pub const SPEC: EffectSpec = EffectSpec {
    id: "tip_mass",
    title: "tip mass",
    equation: "m(s) = ρ A + m_tip δ(s - L)",
    source: "point mass, spread over the last diameter",
    parameters: &[ParameterSpec {
        name: "mass_kg",
        unit: "kg",
        vanishes_at: 0.0,
        low: 0.0,
        high: 0.2,
        smallest_of_interest: 0.001,
    }],
};

struct TipMass<T> {
    mass_kg: T,
}

impl<T: Real> MassLaw<T> for TipMass<T> {
    fn change_masses_kg(&self, layout: &RopeLayout, masses_kg: &mut [T]) {
        let from_m = layout.shape.length_m - layout.shape.diameter_m;
        let at_tip = |p: usize| layout.slice_of(p).arc_m >= from_m;
        let length_m: f64 = (0..masses_kg.len())
            .filter(|&p| at_tip(p))
            .map(|p| layout.particle_length_m(p))
            .sum();
        for (p, mass) in masses_kg.iter_mut().enumerate() {
            if at_tip(p) {
                *mass += self.mass_kg.scale(layout.particle_length_m(p) / length_m);
            }
        }
    }
}

/// Adds the effect to a physics.
pub fn add_to<T: Real>(values: &[T], physics: &mut Physics<T>) {
    physics.mass_laws.push(Box::new(TipMass { mass_kg: values[0] }));
}
