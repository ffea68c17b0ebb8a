//! A grip that gives: its soft pads let the rope turn by an angle in proportion to its bending moment at the mouth
//! ([`crate::sim::pads`]).
//!
//! What did not pay: a soft piece of rope outside the mouth, 1.6 diameters of it, in which rope and hinge are in series.
//! It turned with the moment nine tenths of a diameter further out, and left the rope in front of there straight: on the
//! independent rod compliances came out 50 to 80 % too large, and 1.2 to 3 mm were left.

use super::{EffectSpec, ParameterSpec, Quantity, Slope};
use crate::sim::{Physics, Real};

/// What the effect is.
pub const SPEC: EffectSpec = EffectSpec {
    id: "clamp_compliance",
    title: "clamp compliance",
    equation: "θ = C M at the mouth of every grip",
    source: "rotational spring at the root of a beam; Roark, Formulas for Stress and Strain, table 8.1 (spring-supported end)",
    nuisance: false,
    of_the_rig: false,
    only_seen: false,
    quantity: Quantity::Itself,
    at_its_end: None,
    parameters: &[ParameterSpec {
        name: "compliance_rad_per_n_m",
        unit: "rad/(N m)",
        vanishes_at: 0.0,
        low: 0.0,
        high: 200.0,
        smallest_of_interest: 0.2,
        slope: Slope::Tangent,
        sideways: false,
    }],
};

/// Adds the effect to a physics.
pub fn add_to<T: Real>(values: &[T], physics: &mut Physics<T>) {
    physics.grip_compliance = Some(values[0]);
}
