//! A rope that leaves its clamp at an angle to the recorded direction: pads that hold it askew, a gripper whose axis was
//! recorded somewhat off, a soft rod that was pushed in crookedly. The gripped piece is turned about the clamp's
//! recorded place, and moves with the clamp from there on.
//!
//! The turn is by the vector of Rodrigues whose components are the tangents of half the angles, so that each angle is
//! exact where the other is nothing. Side and up are those of the rope's first frame in the clamp (for a rope along x:
//! y and z). Of two clamps it is the first; and only a rope that hangs when a recording begins shows it: one that lies
//! straight was gripped as it lay.

use super::{EffectSpec, ParameterSpec, Quantity, Slope};
use crate::sim::{Physics, Real};

/// What the effect is.
pub const SPEC: EffectSpec = EffectSpec {
    id: "grip_angle",
    title: "grip angle",
    equation: "t_rope = R_clamp(t) R(angles) t_recorded",
    source: "rigid motion; vector of Rodrigues as in Argyris, An excursion into large rotations (1982)",
    nuisance: false,
    // Nobody sees how a soft rope lies between the pads.
    of_the_rig: false,
    only_seen: false,
    quantity: Quantity::Itself,
    at_its_end: None,
    parameters: &[angle("toward_side_rad", true), angle("toward_up_rad", false)],
};

const fn angle(name: &'static str, sideways: bool) -> ParameterSpec {
    ParameterSpec {
        name,
        unit: "rad",
        vanishes_at: 0.0,
        low: -0.6,
        high: 0.6,
        smallest_of_interest: 0.01,
        slope: Slope::Tangent,
        sideways,
    }
}

/// Adds the effect to a physics.
pub fn add_to<T: Real>(values: &[T], physics: &mut Physics<T>) {
    physics.grip_tilt = Some([values[0], values[1]].map(|angle| {
        let (sin, cos) = angle.sin_cos();
        sin / (T::one() + cos)
    }));
}
