//! A gripper that opens later than it says. Between two time steps the delay changes nothing, so its
//! slope is always a secant.

use super::{EffectSpec, ParameterSpec, Quantity, Slope};
use crate::sim::{Physics, Real};

/// What the effect is.
pub const SPEC: EffectSpec = EffectSpec {
    id: "release_delay",
    title: "release delay",
    equation: "the grip opens at t_open + τ",
    source: "definition; grippers take some 10 ms to let go",
    nuisance: false,
    of_the_rig: false,
    only_seen: false,
    quantity: Quantity::Itself,
    at_its_end: None,
    parameters: &[ParameterSpec {
        name: "delay_s",
        unit: "s",
        vanishes_at: 0.0,
        low: 0.0,
        high: 0.3,
        smallest_of_interest: 0.01,
        slope: Slope::Secant,
        sideways: false,
    }],
};

/// Adds the effect to a physics.
pub fn add_to<T: Real>(values: &[T], physics: &mut Physics<T>) {
    physics.release_delay_s += values[0];
}
