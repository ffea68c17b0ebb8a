//! A rope that is bent when nothing acts on it, as one is that came off a spool: its stress-free shape
//! has a constant curvature. The two components are towards the rope's side and up directions as it
//! lies at the start (for a rope along x: y and z); they turn with the rope.

use super::{EffectSpec, ParameterSpec, Quantity, Slope};
use crate::sim::physics::ShapeLaw;
use crate::sim::{Physics, Real};

/// What the effect is.
pub const SPEC: EffectSpec = EffectSpec {
    id: "rest_curvature",
    title: "rest curvature",
    equation: "ψ = ψ(F G⁻¹), G = diag(1 - k·y, 1, 1)",
    source: "stress-free gradient of a twist-free rod; Bishop 1975, Antman, Nonlinear Problems of Elasticity, ch. 8",
    nuisance: false,
    of_the_rig: false,
    only_seen: false,
    quantity: Quantity::Itself,
    at_its_end: None,
    parameters: &[
        ParameterSpec {
            name: "toward_side_per_m",
            unit: "1/m",
            vanishes_at: 0.0,
            low: -20.0,
            high: 20.0,
            smallest_of_interest: 0.1,
            slope: Slope::Tangent,
            sideways: true,
        },
        ParameterSpec {
            name: "toward_up_per_m",
            unit: "1/m",
            vanishes_at: 0.0,
            low: -20.0,
            high: 20.0,
            smallest_of_interest: 0.1,
            slope: Slope::Tangent,
            sideways: false,
        },
    ],
};

struct RestCurvature<T> {
    curvature_per_m: [T; 2],
}

impl<T: Real> ShapeLaw<T> for RestCurvature<T> {
    fn curvature_per_m(&self, _arc_m: f64) -> [T; 2] {
        self.curvature_per_m
    }
}

/// Adds the effect to a physics.
pub fn add_to<T: Real>(values: &[T], physics: &mut Physics<T>) {
    physics.shape_laws.push(Box::new(RestCurvature {
        curvature_per_m: [values[0], values[1]],
    }));
}
