//! Internal damping: a spring and a dashpot in series (Maxwell) beside the elastic solid, with the solid's
//! elastic constants: S = τ (2 μ E' + λ tr(E') I), where E' follows the rate of the Green strain with
//! the delay τ/g. To motions that are slow against the delay it is Kelvin-Voigt damping with the
//! retardation time τ.
//!
//! Pure Kelvin-Voigt damping is the limit g → ∞. Its modulus grows with frequency without a bound, so
//! waves as short as a grid cell, which no camera sees, force explicit steps of ρ dx²/(6 τ (λ + 2μ)):
//! a hundredth of the elastic step at τ = 1 ms and 1 MPa. Real rubbers are bounded too (standard linear solid).
//! With g = 9 the step is at worst √10 times shorter, and a rope that sways at ω = 20 rad/s with
//! τ = 20 ms feels 99.8 % of the dissipation and is 2 % stiffer.
//!
//! A swing at ω loses tan δ = ω τ of what bends. Insulated cables that swing at 6 to 8 rad/s lose so much that τ is
//! 50 to 100 ms; the range ends where nothing would swing any more. What is slower than that relaxes (`relaxation.rs`).

use super::{EffectSpec, ParameterSpec, Quantity, Slope};
use crate::sim::physics::Maxwell;
use crate::sim::{Physics, Real};

/// g: modulus of the Maxwell element against the elastic one.
const QUICK_MODULUS: f64 = 9.0;

/// What the effect is.
pub const SPEC: EffectSpec = EffectSpec {
    id: "internal_damping",
    title: "internal damping",
    equation: "S = τ (2 μ E' + λ tr(E') I), (τ/g) dE'/dt = dE/dt - E'",
    source: "standard linear solid; Simo and Hughes, Computational Inelasticity (1998), 10.2; Kelvin-Voigt where slow",
    nuisance: false,
    of_the_rig: false,
    only_seen: false,
    quantity: Quantity::Itself,
    at_its_end: None,
    parameters: &[ParameterSpec {
        name: "retardation_time_s",
        unit: "s",
        vanishes_at: 0.0,
        low: 0.0,
        high: 0.2,
        smallest_of_interest: 0.0005,
        slope: Slope::Tangent,
        sideways: false,
    }],
};

/// Adds the effect to a physics.
pub fn add_to<T: Real>(values: &[T], physics: &mut Physics<T>) {
    physics.memory_laws.push(Maxwell {
        share: T::of(QUICK_MODULUS),
        time_s: values[0].scale(1.0 / QUICK_MODULUS),
    });
}
