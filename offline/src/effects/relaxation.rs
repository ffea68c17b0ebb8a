//! A material that gives way slowly: under a sudden bend it is stiffer than at rest, and relaxes. Two springs and dashpots
//! in series (Maxwell) beside the elastic solid, with its elastic constants and with relaxation times a decade apart
//! (Prony series): S = Σ gᵢ τᵢ (2 μ E' + λ tr(E') I), where E' follows the rate of the Green strain with the delay τᵢ.
//! The solid's own modulus is that at rest.
//!
//! Times are fixed, as is usual where a series is fitted, because shares at given times change the stress in proportion. A
//! time shorter than a tenth of a second is internal damping, one longer than the recording a stiffer rope.

use super::{EffectSpec, ParameterSpec, Quantity, Slope};
use crate::sim::physics::Maxwell;
use crate::sim::{Physics, Real};

/// Relaxation times τ₁, τ₂, s.
const TIMES_S: [f64; 2] = [0.1, 1.0];

/// What the effect is.
pub const SPEC: EffectSpec = EffectSpec {
    id: "relaxation",
    title: "relaxation",
    equation: "S = Σ gᵢ τᵢ (2 μ Eᵢ' + λ tr(Eᵢ') I), τᵢ dEᵢ'/dt = dE/dt - Eᵢ', τ = 0.1 s, 1 s",
    source: "generalised Maxwell solid, Prony series; Simo and Hughes, Computational Inelasticity (1998), 10.3",
    nuisance: false,
    of_the_rig: false,
    only_seen: false,
    quantity: Quantity::Itself,
    at_its_end: None,
    parameters: &[share("share_of_100_ms"), share("share_of_1_s")],
};

const fn share(name: &'static str) -> ParameterSpec {
    ParameterSpec {
        name,
        unit: "1",
        vanishes_at: 0.0,
        low: 0.0,
        high: 5.0,
        smallest_of_interest: 0.02,
        slope: Slope::Tangent,
        sideways: false,
    }
}

/// Adds the effect to a physics.
pub fn add_to<T: Real>(values: &[T], physics: &mut Physics<T>) {
    for (&share, time_s) in values.iter().zip(TIMES_S) {
        physics.memory_laws.push(Maxwell {
            share,
            time_s: T::of(time_s),
        });
    }
}
