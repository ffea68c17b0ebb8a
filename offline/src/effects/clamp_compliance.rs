//! A grip that gives: soft pads let the rope turn by an angle in proportion to its bending moment. A
//! hinge with a spring at the mouth of the grip is in series with the rope, so the first slices
//! outside bend by as much more as the hinge would turn: 1/B' = 1/B + C/l over their length l.
//!
//! The hinge thus sits l/2 outside the mouth, and the grid bends less than a beam within so short a
//! piece: on 1.8 cells a rope 10 diameters long turns 22 % less than C M (two, three or six slices
//! measured: 25, 24 and 25 %), so a fitted compliance comes out too large by that much.

use super::{EffectSpec, ParameterSpec, Slope};
use crate::sim::physics::{BendingLaw, BendingPoint};
use crate::sim::{Physics, Real};

/// Number of slices over which the turn is spread.
const SLICES: usize = 4;

/// What the effect is.
pub const SPEC: EffectSpec = EffectSpec {
    id: "clamp_compliance",
    title: "clamp compliance",
    equation: "θ = C M at the mouth of every grip",
    source: "rotational spring at the root of a beam; Roark, Formulas for Stress and Strain, table 8.1 (spring-supported end)",
    nuisance: false,
    of_the_rig: false,
    only_seen: false,
    parameters: &[ParameterSpec {
        name: "compliance_rad_per_n_m",
        unit: "rad/(N m)",
        vanishes_at: 0.0,
        low: 0.0,
        high: 50.0,
        smallest_of_interest: 0.2,
        slope: Slope::Tangent,
        sideways: false,
    }],
};

struct ClampCompliance<T> {
    compliance_rad_per_n_m: T,
}

impl<T: Real> BendingLaw<T> for ClampCompliance<T> {
    fn change_stiffness(&self, point: &BendingPoint<T>, stiffness: &mut [T]) {
        let slices = &point.layout.slices;
        for mouth in point.mouths {
            let outside = |arc_m: f64| (arc_m - mouth.arc_m) * mouth.outwards > 0.0;
            let mut near: Vec<usize> = (0..slices.len()).filter(|&i| outside(slices[i].arc_m)).collect();
            if mouth.outwards < 0.0 {
                near.reverse();
            }
            near.truncate(SLICES);
            let length_m: f64 = near.iter().map(|&i| slices[i].length_m).sum();
            for i in near {
                let turn = self.compliance_rad_per_n_m * point.solid_n_m2.scale(1.0 / length_m);
                stiffness[i] = stiffness[i] / (T::one() + turn * stiffness[i]);
            }
        }
    }
}

/// Adds the effect to a physics.
pub fn add_to<T: Real>(values: &[T], physics: &mut Physics<T>) {
    physics.bending_laws.push(Box::new(ClampCompliance {
        compliance_rad_per_n_m: values[0],
    }));
}
