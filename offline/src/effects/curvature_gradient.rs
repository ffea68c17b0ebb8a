//! A rope that is bent when nothing acts on it, the more the farther from its start: its natural curvature grows in
//! proportion to arc length, so that it rests as a clothoid. With a rest curvature, a cable is bent as freely as a
//! straight line over arc length allows. Components as for [`super::rest_curvature`].

use super::{EffectSpec, ParameterSpec, Quantity, Slope};
use crate::sim::physics::ShapeLaw;
use crate::sim::{Physics, Real};

/// What the effect is.
pub const SPEC: EffectSpec = EffectSpec {
    id: "curvature_gradient",
    title: "curvature gradient",
    equation: "ψ = ψ(F G⁻¹), G = diag(1 - s k'·y, 1, 1)",
    source: "curvature affine in arc length, Stella et al. 2023; stress-free gradient as for rest curvature",
    nuisance: false,
    of_the_rig: false,
    only_seen: false,
    quantity: Quantity::Itself,
    at_its_end: None,
    parameters: &[
        parameter("toward_side_per_m2", true),
        parameter("toward_up_per_m2", false),
    ],
};

const fn parameter(name: &'static str, sideways: bool) -> ParameterSpec {
    ParameterSpec {
        name,
        unit: "1/m²",
        vanishes_at: 0.0,
        low: -40.0,
        high: 40.0,
        smallest_of_interest: 0.5,
        slope: Slope::Tangent,
        sideways,
    }
}

struct CurvatureGradient<T> {
    growth_per_m2: [T; 2],
}

impl<T: Real> ShapeLaw<T> for CurvatureGradient<T> {
    fn curvature_per_m(&self, arc_m: f64) -> [T; 2] {
        self.growth_per_m2.map(|growth| growth.scale(arc_m))
    }
}

/// Adds the effect to a physics.
pub fn add_to<T: Real>(values: &[T], physics: &mut Physics<T>) {
    physics.shape_laws.push(Box::new(CurvatureGradient {
        growth_per_m2: [values[0], values[1]],
    }));
}
