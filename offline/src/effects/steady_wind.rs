//! Air that moves: what a steady, level wind adds to the drag of a rope in still air, with the drag
//! coefficient of a cylinder across the stream. The parameters are the components of q = |w| w, not of
//! the wind w, because the force on a rope at rest goes with the square of the wind: in q it has a
//! slope. Where the wind is zero that slope depends on the direction, so it is taken as a secant.

use super::air_drag::{AIR_KG_M3, quadratic};
use super::{EffectSpec, ParameterSpec, Quantity, Slope};
use crate::sim::physics::{ForceLaw, ForcePoint};
use crate::sim::tensor::{Vec3, dot, mul, scaled, sub, zero3};
use crate::sim::{Physics, Real};

/// Drag coefficient of a cylinder across the stream, Reynolds numbers 10² to 10⁵.
const NORMAL_COEFFICIENT: f64 = 1.1;

/// What the effect is.
pub const SPEC: EffectSpec = EffectSpec {
    id: "steady_wind",
    title: "steady wind",
    equation: "f = ½ ρ_air d C_n (|u| u - |v_n| v_n) per length, u = v_n - w_n, against the motion; w = q/√|q|",
    source: "Hoerner, Fluid-Dynamic Drag (1965), ch. 3, cross-flow principle",
    nuisance: false,
    of_the_rig: false,
    only_seen: false,
    quantity: Quantity::Square("a wind", "m/s"),
    at_its_end: None,
    parameters: &[
        ParameterSpec {
            name: "toward_x_m2_s2",
            unit: "m²/s²",
            vanishes_at: 0.0,
            low: -36.0,
            high: 36.0,
            smallest_of_interest: 1.0,
            slope: Slope::SecantNearZero,
            sideways: false,
        },
        ParameterSpec {
            name: "toward_y_m2_s2",
            unit: "m²/s²",
            vanishes_at: 0.0,
            low: -36.0,
            high: 36.0,
            smallest_of_interest: 1.0,
            slope: Slope::SecantNearZero,
            sideways: true,
        },
    ],
};

struct SteadyWind<T> {
    wind_m_s: Vec3<T>,
}

impl<T: Real> ForceLaw<T> for SteadyWind<T> {
    fn force_n(&self, point: &ForcePoint<T>) -> Vec3<T> {
        let across = |v: Vec3<T>| sub(v, mul(point.tangent, dot(point.tangent, v)));
        let still = quadratic(across(point.velocity_m_s));
        let moving = quadratic(across(sub(point.velocity_m_s, self.wind_m_s)));
        let area_kg_m = 0.5 * AIR_KG_M3 * point.diameter_m * point.length_m;
        scaled(sub(still, moving), area_kg_m * NORMAL_COEFFICIENT)
    }
}

/// Adds the effect to a physics.
pub fn add_to<T: Real>(values: &[T], physics: &mut Physics<T>) {
    let size = (values[0] * values[0] + values[1] * values[1]).value().sqrt();
    let wind_m_s = if size > 0.0 {
        let square = values[0] * values[0] + values[1] * values[1];
        // |w|² = |q|.
        let inverse = T::one() / square.sqrt().sqrt();
        [values[0] * inverse, values[1] * inverse, T::zero()]
    } else {
        zero3()
    };
    physics.force_laws.push(Box::new(SteadyWind { wind_m_s }));
}
