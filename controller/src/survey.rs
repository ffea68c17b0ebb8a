//! How the joint angles vary over the task, surveyed once before the loop starts: bounds of their
//! derivatives over the whole region. A straight line inside it is then known to be reachable and
//! within the limits from its length and duration alone, without inverse kinematics while the arm waits.

use crate::motion::{self, Variation};
use shared::arm::{self, JOINTS, Joints};
use shared::blob::Blob;
use shared::ik;
use shared::profile::LineProfile;
use shared::task::{Interval, STANDOFF_M};

/// Distance of the surveyed poses, m.
const PITCH_M: f64 = 0.01;

/// Poses surveyed beyond the region on each side, for the differences at its edge.
const EDGE: usize = 2;

/// Allows for derivatives between the surveyed poses being larger than at them; those of the arm vary
/// over decimetres, so over half a pitch by less.
const BETWEEN: f64 = 1.1;

/// What was found.
#[derive(Clone, Debug, PartialEq)]
pub struct Survey {
    x_m: Interval,
    z_m: Interval,
    /// Per metre, in whatever direction.
    largest: Variation,
}

/// Joint angles on a grid of points (x, z) of the task plane.
struct Grid {
    columns: usize,
    rows: usize,
    q_rad: Vec<Joints>,
}

impl Grid {
    /// `None` when a pose has no joint angles.
    fn new(blob: &Blob, x_m: &Interval, z_m: &Interval) -> Option<Self> {
        let cells = |range: &Interval| ((range.high - range.low) / PITCH_M).ceil() as usize + 1;
        let (columns, rows) = (cells(x_m) + 2 * EDGE, cells(z_m) + 2 * EDGE);
        let mut q_rad: Vec<Joints> = Vec::with_capacity(columns * rows);
        for row in 0..rows {
            for column in 0..columns {
                let at = |low: f64, k: usize| low + (k as f64 - EDGE as f64) * PITCH_M;
                let pose = arm::task_pose(&blob.frame, [at(x_m.low, column), at(z_m.low, row)]);
                let seed = if column > 0 { q_rad.last() } else { None };
                let q = match seed {
                    Some(near) => ik::solve_near(&pose, near),
                    None => ik::solve(&pose),
                };
                q_rad.push(q.ok()?);
            }
        }
        Some(Self { columns, rows, q_rad })
    }

    /// Derivatives of joint `i` at a pose up to third order, by central differences; each order's largest
    /// over all directions is at most the norm of its components.
    fn variation(&self, column: usize, row: usize, i: usize) -> [f64; 3] {
        let h = PITCH_M;
        let q = |dx: isize, dz: isize| {
            let (x, z) = (column.wrapping_add_signed(dx), row.wrapping_add_signed(dz));
            self.q_rad[z * self.columns + x][i]
        };
        let xx = |dz: isize| (q(1, dz) - 2.0 * q(0, dz) + q(-1, dz)) / (h * h);
        let zz = |dx: isize| (q(dx, 1) - 2.0 * q(dx, 0) + q(dx, -1)) / (h * h);
        let first = [(q(1, 0) - q(-1, 0)) / (2.0 * h), (q(0, 1) - q(0, -1)) / (2.0 * h)];
        let xz = (q(1, 1) - q(1, -1) - q(-1, 1) + q(-1, -1)) / (4.0 * h * h);
        let third = [
            (q(2, 0) - 2.0 * q(1, 0) + 2.0 * q(-1, 0) - q(-2, 0)) / (2.0 * h * h * h),
            (q(0, 2) - 2.0 * q(0, 1) + 2.0 * q(0, -1) - q(0, -2)) / (2.0 * h * h * h),
            (xx(1) - xx(-1)) / (2.0 * h),
            (zz(1) - zz(-1)) / (2.0 * h),
        ];
        let norm = |parts: &[(f64, f64)]| parts.iter().map(|(n, d)| n * d * d).sum::<f64>().sqrt();
        [
            norm(&[(1.0, first[0]), (1.0, first[1])]),
            norm(&[(1.0, xx(0)), (2.0, xz), (1.0, zz(0))]),
            norm(&[(1.0, third[0]), (1.0, third[1]), (3.0, third[2]), (3.0, third[3])]),
        ]
    }
}

impl Survey {
    /// Surveys every line that a goal can ask for; `None` when a part of the region cannot be reached, so
    /// that every line has to be checked by itself.
    pub fn new(blob: &Blob) -> Option<Self> {
        let task = &blob.task;
        let (mut x_m, mut z_m) = (task.release_x_m, task.release_z_m);
        for rope in &blob.ropes {
            let [x, z] = task.hanging_tip_m(rope.length_m);
            x_m = Interval {
                low: x_m.low.min(x),
                high: x_m.high.max(x),
            };
            z_m = Interval {
                low: z_m.low.min(z),
                high: z_m.high.max(z),
            };
        }
        x_m.low -= STANDOFF_M;
        let grid = Grid::new(blob, &x_m, &z_m)?;
        let mut largest = Variation::default();
        for row in EDGE..grid.rows - EDGE {
            for column in EDGE..grid.columns - EDGE {
                for i in 0..JOINTS {
                    let [first, second, third] = grid.variation(column, row, i);
                    largest.first[i] = largest.first[i].max(BETWEEN * first);
                    largest.second[i] = largest.second[i].max(BETWEEN * second);
                    largest.third[i] = largest.third[i].max(BETWEEN * third);
                }
            }
        }
        Some(Self { x_m, z_m, largest })
    }

    /// Whether the line is certainly reachable and within the limits; where not, it may still be.
    pub fn vouches_for(&self, from_m: [f64; 2], to_m: [f64; 2], profile: &LineProfile) -> bool {
        let inside = |[x, z]: [f64; 2]| self.x_m.contains(x) && self.z_m.contains(z);
        let length_m = (to_m[0] - from_m[0]).hypot(to_m[1] - from_m[1]);
        let along = self.largest.along(length_m);
        inside(from_m) && inside(to_m) && motion::within_limits(&along, length_m, profile.duration_s())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample;
    use proptest::prelude::*;
    use shared::profile::MotionLimits;

    #[test]
    fn the_sample_task_is_vouched_for_and_an_unreachable_one_is_not() {
        let mut blob = sample::blob();
        assert!(Survey::new(&blob).is_some());
        blob.frame.origin_m[0] = 0.9;
        assert_eq!(Survey::new(&blob), None);
    }

    proptest! {
        /// Whatever the survey vouches for, the check by inverse kinematics finds right as well.
        #[test]
        fn it_never_vouches_for_a_line_that_the_check_refuses(
            from in (0.0f64..0.25, 0.03f64..0.30), to in (0.0f64..0.25, 0.03f64..0.30), speed in 0.05f64..1.0,
        ) {
            let blob = sample::blob();
            let survey = Survey::new(&blob).unwrap();
            let (from_m, to_m) = ([from.0, from.1], [to.0, to.1]);
            let limits = MotionLimits { speed_m_s: speed, acceleration_m_s2: 20.0 * speed, jerk_m_s3: 200.0 * speed };
            let profile = motion::profile_in_plane(from_m, to_m, &limits);
            let checked = motion::plan_line(&blob.frame, from_m, to_m, &limits);
            if survey.vouches_for(from_m, to_m, &profile) {
                prop_assert_eq!(checked, Ok(profile));
            }
        }
    }
}
