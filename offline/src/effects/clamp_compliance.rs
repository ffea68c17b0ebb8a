//! A grip that gives: soft pads let the rope turn by an angle in proportion to its bending moment. A
//! hinge with a spring at the mouth of the grip is in series with the rope, so a short piece outside
//! bends by as much more as the hinge would turn: 1/B' = 1/B + C/l over the length l of it that bends.
//!
//! The grid's kernel keeps the first third of a cell outside a grip straight ([`crate::sim::clamp::STIFFNESS`]), so l is
//! that much less than what is softened. Turn of the tip of a level cantilever, ten diameters long, over what C M gives
//! within l:
//!
//! | cells per diameter | C B = 0.24 diameters | 0.94 | 3.8 |
//! |---|---|---|---|
//! | 1.5 | 1.04 | 1.02 | 0.96 |
//! | 1.8 | 1.02 | 0.99 | 0.94 |
//! | 2.1 | 1.02 | 1.00 | 0.96 |
//! | 2.5 | 1.01 | 1.00 | 0.94 |
//! | 3.6 | 1.01 | 1.00 | 0.97 |
//!
//! So the grip turns with the moment nine tenths of a diameter outside it; on this short beam that is 16 % less than
//! at the mouth, and a fitted compliance is more than that of a hinge by as much. What did not pay: four slices of any
//! grid, straight third and all (0.71 to 0.82 of C M at the mouth, by grid and C; on a finer grid another compliance
//! fitted, and a large one kinked the rope until it turned inside out), fewer slices (0.03 to 0.79), slices inside the
//! grip as well (0.08 to 0.66), whole slices up to l (on 1.5 cells a compliance of 52 was fitted as 70).

use super::{EffectSpec, ParameterSpec, Quantity, Slope};
use crate::sim::physics::{BendingLaw, BendingPoint};
use crate::sim::{Physics, Real};

/// Length of rope outside a grip over which the turn is spread, in diameters: four slices of the coarsest grid.
const SOFT_DIAMETERS: f64 = 1.6;
/// How much of the rope outside a grip the grid keeps straight, cells.
const STRAIGHT_CELLS: f64 = 1.0 / 3.0;

/// What the effect is.
pub const SPEC: EffectSpec = EffectSpec {
    id: "clamp_compliance",
    title: "clamp compliance",
    equation: "θ = C M at the mouth of every grip",
    source: "rotational spring at the root of a beam; Roark, Formulas for Stress and Strain, table 8.1 (spring-supported end)",
    nuisance: false,
    of_the_rig: false,
    only_seen: false,
    quantity: Quantity::Itself,
    parameters: &[ParameterSpec {
        name: "compliance_rad_per_n_m",
        unit: "rad/(N m)",
        vanishes_at: 0.0,
        low: 0.0,
        high: 200.0,
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
        let reach_m = SOFT_DIAMETERS * point.layout.shape.diameter_m;
        let length_m = reach_m - STRAIGHT_CELLS * point.layout.spacing_m;
        for mouth in point.mouths {
            for (slice, stiffness) in point.layout.slices.iter().zip(&mut *stiffness) {
                let outside_m = (slice.arc_m - mouth.arc_m) * mouth.outwards;
                let [from_m, to_m] =
                    [-0.5, 0.5].map(|side| (outside_m + side * slice.length_m).clamp(0.0, reach_m));
                let share = (to_m - from_m) / slice.length_m;
                let turn = self.compliance_rad_per_n_m * point.solid_n_m2.scale(share / length_m);
                *stiffness = *stiffness / (T::one() + turn * *stiffness);
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
