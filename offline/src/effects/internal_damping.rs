//! Kelvin-Voigt damping: the rate of strain adds a stress with the elastic moduli times a
//! retardation time, τ = J t (2 μ D + λ tr(D) I), D the symmetric velocity gradient.
//!
//! The stress is explicit, so the step is bounded by ρ dx²/(6 t (λ + 2μ)): long retardation times
//! are slow to simulate, but never unstable.

use super::{EffectSpec, ParameterSpec, Slope};
use crate::sim::elastic::Lame;
use crate::sim::physics::{StressLaw, StressPoint};
use crate::sim::tensor::Mat3;
use crate::sim::{Physics, Real};

/// What the effect is.
pub const SPEC: EffectSpec = EffectSpec {
    id: "internal_damping",
    title: "internal damping",
    equation: "τ = J t (2 μ D + λ tr(D) I)",
    source: "Kelvin-Voigt solid; Landau and Lifshitz, Theory of Elasticity, §34",
    nuisance: false,
    parameters: &[ParameterSpec {
        name: "retardation_time_s",
        unit: "s",
        vanishes_at: 0.0,
        low: 0.0,
        high: 0.02,
        smallest_of_interest: 0.0005,
        slope: Slope::Tangent,
    }],
};

struct KelvinVoigt<T> {
    retardation_time_s: T,
}

impl<T: Real> StressLaw<T> for KelvinVoigt<T> {
    fn kirchhoff_pa(&self, point: &StressPoint<T>) -> Mat3<T> {
        let c = point.velocity_gradient;
        let scale = self.retardation_time_s * point.volume_ratio;
        let shear = scale * point.lame.mu;
        let volume = scale * point.lame.lambda * (c[0][0] + c[1][1] + c[2][2]);
        std::array::from_fn(|a| {
            std::array::from_fn(|b| {
                let rate = shear * (c[a][b] + c[b][a]);
                if a == b { rate + volume } else { rate }
            })
        })
    }

    fn viscosity_pa_s(&self, lame: &Lame<T>) -> f64 {
        (self.retardation_time_s * lame.p_wave_modulus()).value()
    }
}

/// Adds the effect to a physics.
pub fn add_to<T: Real>(values: &[T], physics: &mut Physics<T>) {
    physics.stress_laws.push(Box::new(KelvinVoigt {
        retardation_time_s: values[0],
    }));
}
