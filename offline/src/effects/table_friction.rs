//! Friction with the table other than declared: the Coulomb coefficient becomes μ + Δμ, at least nothing.

use super::{EffectSpec, ParameterSpec, Quantity, Slope};
use crate::sim::{Physics, Real};

/// What the effect is.
pub const SPEC: EffectSpec = EffectSpec {
    id: "table_friction",
    title: "table friction",
    equation: "|f_t| ≤ max(μ + Δμ, 0) f_n",
    source: "Coulomb's law; the declared μ stands in demo.toml",
    nuisance: false,
    of_the_rig: false,
    only_seen: false,
    quantity: Quantity::Itself,
    at_its_end: None,
    parameters: &[ParameterSpec {
        name: "coefficient_change",
        unit: "1",
        vanishes_at: 0.0,
        low: -0.5,
        high: 1.0,
        smallest_of_interest: 0.1,
        slope: Slope::SecantNearZero,
        sideways: false,
    }],
};

/// Adds the effect to a physics.
pub fn add_to<T: Real>(values: &[T], physics: &mut Physics<T>) {
    let changed = physics.friction + values[0];
    // Also where there is no table, whose friction counts as none: what was less than declared elsewhere stays possible.
    physics.friction = if changed.value() < 0.0 {
        T::of(0.0)
    } else {
        changed
    };
}
