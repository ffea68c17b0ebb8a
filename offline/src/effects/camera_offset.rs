//! Cameras that stand elsewhere than declared: everything they report is shifted and turned, all cameras
//! as one. The turn is about where the rope's start was first, by the Cayley map of the rotation
//! vector (its angle is 2 atan(|r|/2), the vector's length up to |r|³/12).

use super::{EffectSpec, ParameterSpec, Quantity, Slope};
use crate::sim::physics::ObservationLaw;
use crate::sim::tensor::{Mat3, Vec3, add, lift3, matvec, rotation_of_rodrigues, sub};
use crate::sim::{Physics, Real};

/// What the effect is.
pub const SPEC: EffectSpec = EffectSpec {
    id: "camera_offset",
    title: "camera offset",
    equation: "p_seen = p + t + (R(r) - I)(p - p_start)",
    source: "rigid motion; Cayley map as in Argyris, An excursion into large rotations (1982)",
    nuisance: true,
    of_the_rig: true,
    only_seen: true,
    quantity: Quantity::Itself,
    at_its_end: Some("calibrate the cameras again: so far off they are no small error"),
    parameters: &[
        shift("shift_x_m", false),
        shift("shift_y_m", true),
        shift("shift_z_m", false),
        turn("turn_x_rad", true),
        turn("turn_y_rad", false),
        turn("turn_z_rad", true),
    ],
};

const fn shift(name: &'static str, sideways: bool) -> ParameterSpec {
    ParameterSpec {
        name,
        unit: "m",
        vanishes_at: 0.0,
        low: -0.05,
        high: 0.05,
        smallest_of_interest: 0.001,
        slope: Slope::Tangent,
        sideways,
    }
}

const fn turn(name: &'static str, sideways: bool) -> ParameterSpec {
    ParameterSpec {
        name,
        unit: "rad",
        vanishes_at: 0.0,
        low: -0.2,
        high: 0.2,
        smallest_of_interest: 0.005,
        slope: Slope::Tangent,
        sideways,
    }
}

struct CameraOffset<T> {
    shift_m: Vec3<T>,
    /// R − I.
    turn: Mat3<T>,
}

impl<T: Real> ObservationLaw<T> for CameraOffset<T> {
    fn displacement_m(&self, point_m: Vec3<T>, pivot_m: [f64; 3]) -> Vec3<T> {
        add(self.shift_m, matvec(&self.turn, sub(point_m, lift3(pivot_m))))
    }
}

/// Adds the effect to a physics.
pub fn add_to<T: Real>(values: &[T], physics: &mut Physics<T>) {
    let mut turn = rotation_of_rodrigues(std::array::from_fn(|k| values[3 + k].scale(0.5)));
    for k in 0..3 {
        turn[k][k] -= T::one();
    }
    physics.observation_laws.push(Box::new(CameraOffset {
        shift_m: [values[0], values[1], values[2]],
        turn,
    }));
}
