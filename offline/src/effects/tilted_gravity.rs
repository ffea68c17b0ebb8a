//! A frame that is not level: gravity turned by an angle about y (it then has an x component) and
//! by an angle about x (a y component).

use super::{EffectSpec, ParameterSpec, Quantity, Slope};
use crate::sim::tensor::dot;
use crate::sim::{Physics, Real};

/// What the effect is.
pub const SPEC: EffectSpec = EffectSpec {
    id: "tilted_gravity",
    title: "tilted gravity",
    equation: "g = |g| (sin a cos b, sin b, -cos a cos b)",
    source: "rotation of the gravity vector in the world frame",
    nuisance: false,
    of_the_rig: true,
    only_seen: false,
    quantity: Quantity::Itself,
    at_its_end: Some("check which axis points up: so far off it is declared wrongly"),
    parameters: &[
        ParameterSpec {
            name: "toward_x_rad",
            unit: "rad",
            vanishes_at: 0.0,
            low: -0.3,
            high: 0.3,
            smallest_of_interest: 0.01,
            slope: Slope::Tangent,
            sideways: false,
        },
        ParameterSpec {
            name: "toward_y_rad",
            unit: "rad",
            vanishes_at: 0.0,
            low: -0.3,
            high: 0.3,
            smallest_of_interest: 0.01,
            slope: Slope::Tangent,
            sideways: true,
        },
    ],
};

/// Adds the effect to a physics.
pub fn add_to<T: Real>(values: &[T], physics: &mut Physics<T>) {
    let old = physics.gravity_m_s2;
    let size = dot(old, old).sqrt();
    let (sin_a, cos_a) = values[0].sin_cos();
    let (sin_b, cos_b) = values[1].sin_cos();
    physics.gravity_m_s2 = [size * sin_a * cos_b, size * sin_b, -(size * cos_a * cos_b)];
}
