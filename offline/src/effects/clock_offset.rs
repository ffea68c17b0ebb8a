//! Two clocks: the cameras' shows more than the robot's by a constant. What a frame shows at its time t
//! happened at t − τ on the robot's clock. A rope that is first seen in motion begins by the cameras' clock: there the
//! offset changes nothing ([`crate::sim::scene::Scene::clock_offset_s`]), as is right where its clamp stands still; of one that
//! moves its path is late by the offset, which is not modelled: there a diagnosis says that it could not try this effect.

use super::{EffectSpec, ParameterSpec, Quantity, Slope};
use crate::sim::physics::ObservationLaw;
use crate::sim::{Physics, Real};

/// What the effect is.
pub const SPEC: EffectSpec = EffectSpec {
    id: "clock_offset",
    title: "clock offset",
    equation: "x_seen(t) = x(t - τ)",
    source: "definition of the clocks' difference",
    nuisance: false,
    of_the_rig: false,
    only_seen: true,
    quantity: Quantity::Itself,
    at_its_end: Some(
        "compare the clocks of gripper and cameras: so far apart they are a mistake of the recording",
    ),
    parameters: &[ParameterSpec {
        name: "offset_s",
        unit: "s",
        vanishes_at: 0.0,
        low: -0.3,
        high: 0.3,
        smallest_of_interest: 0.005,
        slope: Slope::Tangent,
        sideways: false,
    }],
};

struct ClockOffset<T> {
    offset_s: T,
}

impl<T: Real> ObservationLaw<T> for ClockOffset<T> {
    fn clock_offset_s(&self) -> T {
        self.offset_s
    }
}

/// Adds the effect to a physics.
pub fn add_to<T: Real>(values: &[T], physics: &mut Physics<T>) {
    physics
        .observation_laws
        .push(Box::new(ClockOffset { offset_s: values[0] }));
}
