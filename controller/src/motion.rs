//! Paths as functions of time: a joint motion from rest to rest, and a straight line of the task that
//! follows the simulator's profile through inverse kinematics. Both are checked when they are planned.

use crate::constants::{HOMING_FLANGE_SPEED_M_S, HOMING_SHARE, LINE_SAMPLES, LINE_SHARE};
use shared::arm::{
    self, ACCELERATION_MAX_RAD_S2, FLANGE_SPEED_MAX_M_S, FlangePose, JERK_MAX_RAD_S3, JOINTS, Joints,
    SPEED_MAX_RAD_S,
};
use shared::blob::TaskFrame;
use shared::ik::{self, IkError};
use shared::profile::{LineProfile, MINIMUM_JERK_PEAKS as PEAKS, MinimumJerk, MotionLimits};

/// Minimum-jerk motion of all joints from rest to rest in one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointMove {
    from_rad: Joints,
    to_rad: Joints,
    law: MinimumJerk,
}

impl JointMove {
    /// The fastest such motion within the planning shares of the arm's limits.
    pub fn new(from_rad: Joints, to_rad: Joints) -> Self {
        let mut farthest = 0.0f64;
        for i in 0..JOINTS {
            farthest = farthest.max((to_rad[i] - from_rad[i]).abs());
        }
        let limits = [SPEED_MAX_RAD_S, ACCELERATION_MAX_RAD_S2, JERK_MAX_RAD_S3];
        let limits = std::array::from_fn(|order| HOMING_SHARE[order] * limits[order]);
        let by_flange = PEAKS[0] * steepest_flange_m(&from_rad, &to_rad) / HOMING_FLANGE_SPEED_M_S;
        Self {
            from_rad,
            to_rad,
            law: MinimumJerk::within(farthest, limits).lasting(by_flange),
        }
    }

    /// Time from rest to rest, s.
    pub fn duration_s(&self) -> f64 {
        self.law.duration_s()
    }

    /// Lowest height of the flange on the way, m.
    pub fn lowest_flange_m(&self) -> f64 {
        let heights = along::<33>(&self.from_rad, &self.to_rad).map(|q| arm::flange(&q).position_m[2]);
        heights.fold(f64::INFINITY, f64::min)
    }

    /// Joint angles at time `t_s` after the start, rad.
    pub fn joints_rad(&self, t_s: f64) -> Joints {
        let s = self.law.share(t_s);
        std::array::from_fn(|i| self.from_rad[i] + s * (self.to_rad[i] - self.from_rad[i]))
    }

    /// What is left of the motion after `t_s`, as [`MinimumJerk::left_after`] has it.
    pub fn left_after(&self, t_s: f64) -> Self {
        Self {
            from_rad: self.joints_rad(t_s),
            law: self.law.left_after(t_s),
            ..*self
        }
    }
}

/// Joint angles at so many points of the straight joint path, from one end to the other.
fn along<const SAMPLES: usize>(from: &Joints, to: &Joints) -> impl Iterator<Item = Joints> {
    (0..SAMPLES).map(move |k| {
        let share = k as f64 / (SAMPLES - 1) as f64;
        std::array::from_fn(|i| from[i] + share * (to[i] - from[i]))
    })
}

/// Largest flange travel per share of the straight joint path, m: its speed at one path length a second.
fn steepest_flange_m(from: &Joints, to: &Joints) -> f64 {
    let mut steepest = 0.0f64;
    // The speed varies slowly along the path, and what is planned lies far below what the guard allows.
    for q in along::<9>(from, to) {
        let (_, jacobian) = arm::flange_and_jacobian(&q);
        let mut travel = nalgebra::Vector3::zeros();
        for i in 0..JOINTS {
            travel += jacobian.fixed_view::<3, 1>(0, i) * (to[i] - from[i]);
        }
        steepest = steepest.max(travel.norm());
    }
    steepest
}

/// Why a line cannot be followed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LineError {
    /// A pose of the line has no joint angles.
    Pose(IkError),
    /// A joint or the flange would have to move faster than the planning share of its limits.
    TooFast,
}

/// A profile between two points (x, z) of the task plane; its y is zero throughout.
pub fn profile_in_plane(from_m: [f64; 2], to_m: [f64; 2], limits: &MotionLimits) -> LineProfile {
    LineProfile::new([from_m[0], 0.0, from_m[1]], [to_m[0], 0.0, to_m[1]], limits)
}

/// The flange on a line of the task plane at time `t_s` after its start.
pub fn pose_on_line(frame: &TaskFrame, profile: &LineProfile, t_s: f64) -> FlangePose {
    let [x, _, z] = profile.position_m(t_s);
    arm::task_pose(frame, [x, z])
}

/// Plans the straight line between two points of the task plane and checks it: every sampled pose has
/// joint angles and the derivatives along the line keep the limits at the profile's peaks.
pub fn plan_line(
    frame: &TaskFrame,
    from_m: [f64; 2],
    to_m: [f64; 2],
    limits: &MotionLimits,
) -> Result<LineProfile, LineError> {
    let profile = profile_in_plane(from_m, to_m, limits);
    let mut poses = [[0.0; JOINTS]; LINE_SAMPLES];
    let mut seed = None;
    for (k, pose) in poses.iter_mut().enumerate() {
        let share = k as f64 / (LINE_SAMPLES - 1) as f64;
        let point = [0, 1].map(|axis| from_m[axis] + share * (to_m[axis] - from_m[axis]));
        let target = arm::task_pose(frame, point);
        *pose = match seed {
            None => ik::solve(&target),
            Some(near) => ik::solve_near(&target, &near),
        }
        .map_err(LineError::Pose)?;
        seed = Some(*pose);
    }
    let length_m = (to_m[0] - from_m[0]).hypot(to_m[1] - from_m[1]);
    let duration_s = profile.duration_s();
    if (2..LINE_SAMPLES - 2).all(|k| within_limits(&Variation::at(&poses, k), length_m, duration_s)) {
        Ok(profile)
    } else {
        Err(LineError::TooFast)
    }
}

/// Sizes of the derivatives of the joint angles along a path, up to third order.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Variation {
    /// First derivatives.
    pub first: Joints,
    /// Second derivatives.
    pub second: Joints,
    /// Third derivatives.
    pub third: Joints,
}

impl Variation {
    /// By the share of a line, at sample `k` of its poses, by central differences.
    fn at(poses: &[Joints; LINE_SAMPLES], k: usize) -> Self {
        let h = 1.0 / (LINE_SAMPLES - 1) as f64;
        let mut variation = Self::default();
        for i in 0..JOINTS {
            let q = |offset: isize| poses[k.wrapping_add_signed(offset)][i];
            variation.first[i] = ((q(1) - q(-1)) / (2.0 * h)).abs();
            variation.second[i] = ((q(1) - 2.0 * q(0) + q(-1)) / (h * h)).abs();
            variation.third[i] = ((q(2) - 2.0 * q(1) + 2.0 * q(-1) - q(-2)) / (2.0 * h * h * h)).abs();
        }
        variation
    }

    /// From derivatives per metre to those by the share of a line of this length.
    pub fn along(&self, length_m: f64) -> Self {
        Self {
            first: self.first.map(|d| d * length_m),
            second: self.second.map(|d| d * length_m * length_m),
            third: self.third.map(|d| d * length_m * length_m * length_m),
        }
    }
}

/// Whether a line on which the joints vary like this keeps the limits. With s the share of the line and
/// q(s): dq = q' ṡ, ddq = q'' ṡ² + q' s̈ and dddq = q''' ṡ³ + 3 q'' ṡ s̈ + q' s⃛, each bounded with all of
/// the profile's peaks at once.
pub fn within_limits(variation: &Variation, length_m: f64, duration_s: f64) -> bool {
    if duration_s <= 0.0 {
        return true;
    }
    let rate = PEAKS[0] / duration_s;
    let change = PEAKS[1] / duration_s.powi(2);
    let jolt = PEAKS[2] / duration_s.powi(3);
    let mut within = length_m * rate <= LINE_SHARE * FLANGE_SPEED_MAX_M_S;
    for i in 0..JOINTS {
        let (first, second, third) = (variation.first[i], variation.second[i], variation.third[i]);
        let jerk = third * rate.powi(3) + 3.0 * second * rate * change + first * jolt;
        within &= first * rate <= LINE_SHARE * SPEED_MAX_RAD_S;
        within &= second * rate * rate + first * change <= LINE_SHARE * ACCELERATION_MAX_RAD_S2;
        within &= jerk <= LINE_SHARE * JERK_MAX_RAD_S3;
    }
    within
}
