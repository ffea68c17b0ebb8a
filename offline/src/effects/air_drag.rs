//! Air drag on a slender body, split into flow across and along the rope (cross-flow principle):
//! f = −½ ρ_air d (C_n |v_n| v_n + π C_t |v_t| v_t) per length, plus a linear part −m r v.
//!
//! Slow flow of air takes about 1e-4 N s/m² per length (Lamb's 4 π μ over a logarithm): r is 0.1 1/s for a wire of 1 g/m,
//! thousandths for a rope. Its range ends at some times that. It was 5 1/s, which no air does, and the swing of a heavy
//! cable was braked by it at 3 1/s as well as by the cable's own damping.

use super::{EffectSpec, ParameterSpec, Quantity, Slope};
use crate::sim::physics::{ForceLaw, ForcePoint};
use crate::sim::tensor::{Vec3, add, dot, mul, scaled, sub, zero3};
use crate::sim::{Physics, Real};

/// Density of air at 20 °C and sea level, kg/m³.
pub(super) const AIR_KG_M3: f64 = 1.204;

/// What the effect is.
pub const SPEC: EffectSpec = EffectSpec {
    id: "air_drag",
    title: "air drag",
    equation: "f = -½ ρ_air d (C_n |v_n| v_n + π C_t |v_t| v_t) per length - m r v",
    source: "Hoerner, Fluid-Dynamic Drag (1965), ch. 3; coefficients as in MoorDyn's sample line",
    nuisance: false,
    of_the_rig: false,
    only_seen: false,
    quantity: Quantity::Itself,
    at_its_end: None,
    parameters: &[
        ParameterSpec {
            name: "normal_coefficient",
            unit: "1",
            vanishes_at: 0.0,
            low: 0.0,
            high: 2.5,
            smallest_of_interest: 0.3,
            slope: Slope::Tangent,
            sideways: false,
        },
        ParameterSpec {
            name: "tangential_coefficient",
            unit: "1",
            vanishes_at: 0.0,
            low: 0.0,
            high: 0.3,
            smallest_of_interest: 0.05,
            slope: Slope::Tangent,
            sideways: false,
        },
        ParameterSpec {
            name: "linear_rate_per_s",
            unit: "1/s",
            vanishes_at: 0.0,
            low: 0.0,
            high: 0.5,
            smallest_of_interest: 0.1,
            slope: Slope::Tangent,
            sideways: false,
        },
    ],
};

struct AirDrag<T> {
    normal: T,
    tangential: T,
    linear_rate: T,
}

impl<T: Real> ForceLaw<T> for AirDrag<T> {
    fn force_n(&self, point: &ForcePoint<T>) -> Vec3<T> {
        let v = point.velocity_m_s;
        let along = mul(point.tangent, dot(point.tangent, v));
        let across = sub(v, along);
        let area = 0.5 * AIR_KG_M3 * point.diameter_m * point.length_m;
        let normal = mul(quadratic(across), self.normal);
        let tangential = scaled(mul(quadratic(along), self.tangential), std::f64::consts::PI);
        let linear = mul(v, self.linear_rate * point.mass_kg);
        sub(scaled(add(normal, tangential), -area), linear)
    }
}

/// |v| v, whose derivative at rest is zero.
pub(super) fn quadratic<T: Real>(v: Vec3<T>) -> Vec3<T> {
    let square = dot(v, v);
    if square.value() <= f64::MIN_POSITIVE {
        return zero3();
    }
    mul(v, square.sqrt())
}

/// Adds the effect to a physics.
pub fn add_to<T: Real>(values: &[T], physics: &mut Physics<T>) {
    physics.force_laws.push(Box::new(AirDrag {
        normal: values[0],
        tangential: values[1],
        linear_rate: values[2],
    }));
}
