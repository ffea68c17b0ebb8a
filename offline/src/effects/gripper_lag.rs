//! First-order lag of the gripper behind its recorded path: T y' = p(t) − y, whose solution is
//! y(t) = ∫ p(t − T u) e^(−u) du. The integral is taken by Gauss-Laguerre quadrature, which is
//! smooth in T down to zero, where solving the differential equation step by step has no slope.

use super::{EffectSpec, ParameterSpec, Quantity, Slope};
use crate::sim::physics::{PathLaw, Pose};
use crate::sim::{Physics, Real};

/// What the effect is.
pub const SPEC: EffectSpec = EffectSpec {
    id: "gripper_lag",
    title: "gripper lag",
    equation: "T y' = p(t) - y",
    source: "first-order servo lag; Gauss-Laguerre nodes from Abramowitz and Stegun, table 25.9",
    nuisance: false,
    of_the_rig: false,
    only_seen: false,
    quantity: Quantity::Itself,
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

const NODES: [f64; 8] = [
    0.170279632305101,
    0.903701776799380,
    2.251086629866131,
    4.266700170287659,
    7.045905402393466,
    10.758516010180996,
    15.740678641278004,
    22.863131736889265,
];
const WEIGHTS: [f64; 8] = [
    0.369188589341638,
    0.418786780814343,
    0.175794986637172,
    0.033343492261215,
    0.00279453623522567,
    0.0000907650877335821,
    8.48574671627253e-7,
    1.04800117487151e-9,
];

struct Lag<T> {
    lag_s: T,
}

impl<T: Real> PathLaw<T> for Lag<T> {
    fn offset(&self, recorded: &dyn Fn(T) -> Pose<T>, t_s: T) -> Pose<T> {
        let now = recorded(t_s);
        let mut offset = [T::zero(); 7];
        for (&node, &weight) in NODES.iter().zip(&WEIGHTS) {
            let past = recorded(t_s - self.lag_s.scale(node));
            for k in 0..7 {
                offset[k] += (past[k] - now[k]).scale(weight);
            }
        }
        offset
    }
}

/// Adds the effect to a physics.
pub fn add_to<T: Real>(values: &[T], physics: &mut Physics<T>) {
    physics.path_laws.push(Box::new(Lag { lag_s: values[0] }));
}
