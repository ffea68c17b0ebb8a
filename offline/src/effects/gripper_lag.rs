//! First-order lag of the gripper behind its recorded path: T y' = p(t) − y. The path is cubic between its knots, so the
//! solution is known in closed form ([`Recorded::behind`]), smooth in T down to zero, where solving the differential
//! equation step by step has no slope.

use super::{EffectSpec, ParameterSpec, Quantity, Slope};
use crate::sim::physics::{PathLaw, Pose};
use crate::sim::recorded::Recorded;
use crate::sim::{Physics, Real};

/// What the effect is.
pub const SPEC: EffectSpec = EffectSpec {
    id: "gripper_lag",
    title: "gripper lag",
    equation: "T y' = p(t) - y",
    source: "first-order servo lag, solved exactly on the path's cubic pieces",
    nuisance: false,
    of_the_rig: false,
    only_seen: false,
    quantity: Quantity::Itself,
    at_its_end: None,
    parameters: &[ParameterSpec {
        name: "lag_s",
        unit: "s",
        vanishes_at: 0.0,
        low: 0.0,
        high: 0.3,
        smallest_of_interest: 0.005,
        slope: Slope::Tangent,
        sideways: false,
    }],
};

struct Lag<T> {
    lag_s: T,
}

impl<T: Real> PathLaw<T> for Lag<T> {
    fn offset(&self, recorded: &Recorded<T>, t_s: f64) -> Pose<T> {
        recorded.behind(self.lag_s, t_s)
    }
}

/// Adds the effect to a physics.
pub fn add_to<T: Real>(values: &[T], physics: &mut Physics<T>) {
    physics.path_laws.push(Box::new(Lag { lag_s: values[0] }));
}
