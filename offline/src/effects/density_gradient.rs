//! A rope that is heavier towards one end: its mass per length changes linearly, its mass stays.

use super::{EffectSpec, ParameterSpec, Quantity, Slope};
use crate::sim::physics::MassLaw;
use crate::sim::rope::RopeLayout;
use crate::sim::{Physics, Real};

/// What the effect is.
pub const SPEC: EffectSpec = EffectSpec {
    id: "density_gradient",
    title: "density gradient",
    equation: "m(s) = ρ A (1 + g (s/L - 1/2))",
    source: "first-order term of a density along the rope, mean unchanged",
    nuisance: false,
    of_the_rig: false,
    only_seen: false,
    quantity: Quantity::Itself,
    at_its_end: None,
    parameters: &[ParameterSpec {
        name: "relative_slope",
        unit: "1",
        vanishes_at: 0.0,
        low: -1.5,
        high: 1.5,
        smallest_of_interest: 0.05,
        slope: Slope::Tangent,
        sideways: false,
    }],
};

struct DensityGradient<T> {
    relative_slope: T,
}

impl<T: Real> MassLaw<T> for DensityGradient<T> {
    fn change_masses_kg(&self, layout: &RopeLayout, masses_kg: &mut [T]) {
        for (particle, mass) in masses_kg.iter_mut().enumerate() {
            let along = layout.slice_of(particle).arc_m / layout.shape.length_m - 0.5;
            // Masses that others have added stay; only the rope's own is spread anew.
            let own = layout.particle_volume_m3(particle) * layout.shape.density_kg_m3();
            *mass += self.relative_slope.scale(along * own);
        }
    }
}

/// Adds the effect to a physics.
pub fn add_to<T: Real>(values: &[T], physics: &mut Physics<T>) {
    physics.mass_laws.push(Box::new(DensityGradient {
        relative_slope: values[0],
    }));
}
