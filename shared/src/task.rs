//! Geometry of the swing task in the vertical plane (x, z), origin on the table: where the rope
//! hangs, where it may be released, which goals make sense. Numbers of the paper at 0.5 m a unit.

use core::fmt::{Display, Formatter};
use serde::{Deserialize, Serialize};

/// How far before a point of the task, along its x, the gripper starts its approach and ends its retreat, m.
pub const STANDOFF_M: f64 = 0.06;

struct Metres(Interval);

impl Display for Metres {
    fn fmt(&self, f: &mut Formatter<'_>) -> core::fmt::Result {
        write!(f, "{:.3} to {:.3} m", self.0.low, self.0.high)
    }
}

/// An interval, both ends included.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

impl Interval {
    /// Whether `value` lies inside; never for NaN.
    pub fn contains(&self, value: f64) -> bool {
        value >= self.low && value <= self.high
    }

    /// The value at `share` of the way from low (0) to high (1).
    pub fn at(&self, share: f64) -> f64 {
        self.low + share * (self.high - self.low)
    }

    /// The part of it inside another; where they have nothing in common, the other's end that is nearer.
    pub fn within(&self, other: &Self) -> Self {
        Self {
            low: other.clamp(self.low),
            high: other.clamp(self.high),
        }
    }

    /// A range of places for people, in whole millimetres, none of which lies outside: "0.363 to 0.411 m".
    pub fn metres(&self) -> impl Display {
        Metres(self.whole_millimetres())
    }

    /// A range of places, m, as it is told to people: its ends in whole millimetres, not outside.
    pub fn whole_millimetres(&self) -> Self {
        // 0.28 m is a little more than 280 mm.
        const ROUNDING: f64 = 1e-6;
        Self {
            low: 1e-3 * libm::ceil(1e3 * self.low - ROUNDING),
            high: 1e-3 * libm::floor(1e3 * self.high + ROUNDING),
        }
    }

    /// The nearest value inside.
    pub fn clamp(&self, value: f64) -> f64 {
        value.clamp(self.low, self.high)
    }
}

/// The swing task: a rope hangs from a fixed clamp, the gripper drags its bottom end to a release
/// point, waits and opens; the score is the largest x that the bottom tip reaches.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SwingTask {
    /// The rope's top end, (x, z) in m; the fixed clamp holds [`Self::grip_m`] of rope below it.
    pub top_m: [f64; 2],
    /// Release points, x in m.
    pub release_x_m: Interval,
    /// Release points, z in m.
    pub release_z_m: Interval,
    /// Goals for the tip's largest x, m.
    pub goal_x_m: Interval,
    /// Length of rope inside the fixed clamp and inside the gripper, m.
    pub grip_m: f64,
    /// Time between the end of the drag and the release, s.
    pub dwell_s: f64,
}

impl SwingTask {
    /// The paper's geometry (design section 4).
    pub const PAPER: Self = Self {
        top_m: [0.25, 0.275],
        release_x_m: Interval {
            low: 0.05,
            high: 0.15,
        },
        release_z_m: Interval {
            low: 0.025,
            high: 0.30,
        },
        goal_x_m: Interval {
            low: 0.275,
            high: 0.425,
        },
        grip_m: 0.02,
        dwell_s: 2.0,
    };

    /// Where the tip of a rope of free length `length_m` hangs at rest, (x, z) in m.
    pub fn hanging_tip_m(&self, length_m: f64) -> [f64; 2] {
        [self.top_m[0], self.top_m[1] - length_m]
    }

    /// The longest rope of this diameter whose tip hangs clear of the table, m. No swing of a longer one is
    /// simulated rightly, and the gripper that takes its tip would drive into the table.
    pub fn longest_rope_m(&self, diameter_m: f64) -> f64 {
        self.top_m[1] - 0.5 * diameter_m
    }

    /// Length of a rope of length `length_m` between the fixed clamp and the gripper, m.
    pub fn free_length_m(&self, length_m: f64) -> f64 {
        length_m - 2.0 * self.grip_m
    }

    /// Where the rope's bottom end would be, (x, z) in m, if fixed clamp and gripper touched: the rope leaves the one
    /// downwards and enters the other from above.
    pub fn touching_m(&self) -> [f64; 2] {
        [self.top_m[0], self.top_m[1] - 2.0 * self.grip_m]
    }

    /// Distance between the fixed clamp and a gripper that holds the rope's bottom end at `point_m`, (x, z) in m. A rope
    /// cannot span more than its free length.
    pub fn span_m(&self, point_m: [f64; 2]) -> f64 {
        let touching = self.touching_m();
        libm::hypot(point_m[0] - touching[0], point_m[1] - touching[1])
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::Interval;
    use std::string::ToString;

    #[test]
    fn no_place_that_is_printed_lies_outside() {
        let of = |low: f64, high: f64| Interval { low, high }.metres().to_string();
        assert_eq!(of(0.3622, 0.4119), "0.363 to 0.411 m");
        assert_eq!(of(0.275, 0.425), "0.275 to 0.425 m");
        assert_eq!(of(0.28, 0.28), "0.280 to 0.280 m");
    }
}
