//! Inverse kinematics of the xArm7: seven joints for a flange pose, by damped least squares with a
//! bounded number of iterations. The answer is the solution nearest to a posture in the middle of
//! the joint ranges, so it depends on the pose alone and changes smoothly with it.

use crate::arm::{self, FlangePose, JOINTS, Joints, LEVEL_POSTURE_RAD};
use nalgebra::{SMatrix, SVector, Vector3};

/// Iterations allowed; a reachable pose of the task takes about ten from the seed and fewer from a neighbour.
pub const ITERATIONS_MAX: usize = 100;

/// Largest change of one joint in one iteration, rad: keeps the linearisation honest.
const STEP_MAX_RAD: f64 = 0.3;

/// The answer is taken when no joint moves more than this, rad; finite differences over 4 ms then
/// carry less than 1 % of the jerk limit as noise.
const CONVERGED_RAD: f64 = 1e-11;

/// Pose error below which a converged answer counts as reaching the pose, m and rad.
const REACHED: f64 = 1e-8;

/// Damping per squared pose error, so that it vanishes at the answer and does not bias it.
const DAMPING: f64 = 1e-2;

/// Damping that remains at the answer; bounds the step next to a singularity.
const DAMPING_FLOOR: f64 = 1e-12;

/// Why a pose has no joint angles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum IkError {
    /// The pose or the seed is not a finite number.
    #[error("the pose is not a finite number")]
    NonFinite,
    /// No joint angles put the flange there.
    #[error("the arm cannot reach the pose")]
    Unreachable,
    /// The solution lies outside the range of this joint (counted from 1).
    #[error("joint {0} would leave its range")]
    JointLimit(usize),
}

/// The posture that the redundancy is drawn towards for this pose: the level posture turned to face it, by the turn nearest
/// to where its tool points. A task that crosses the base's −x axis, where the angle to its points jumps by a whole turn, is
/// then one piece.
fn reference(target: &FlangePose) -> Joints {
    const TURN: f64 = core::f64::consts::TAU;
    let tool = target.rotation.column(2);
    let ahead = libm::atan2(tool.y, tool.x);
    let facing = libm::atan2(target.position_m.y, target.position_m.x);
    let mut q = LEVEL_POSTURE_RAD;
    q[0] = facing + TURN * libm::round((ahead - facing) / TURN);
    q
}

/// What is left from `from` to `to`: metres, then the rotation as a vector in the base frame.
fn pose_error(from: &FlangePose, to: &FlangePose) -> SVector<f64, 6> {
    let mut error = SVector::<f64, 6>::zeros();
    error
        .fixed_rows_mut::<3>(0)
        .copy_from(&(to.position_m - from.position_m));
    let mut turn = Vector3::zeros();
    for axis in 0..3 {
        turn += from.rotation.column(axis).cross(&to.rotation.column(axis));
    }
    error.fixed_rows_mut::<3>(3).copy_from(&(turn * 0.5));
    error
}

/// Joint angles for `target`, started from the middle posture. Deterministic, no allocation.
pub fn solve(target: &FlangePose) -> Result<Joints, IkError> {
    solve_near(target, &reference(target))
}

/// The same answer found faster when `seed_rad` is close to it, as along a path.
pub fn solve_near(target: &FlangePose, seed_rad: &Joints) -> Result<Joints, IkError> {
    let finite = target
        .position_m
        .iter()
        .chain(target.rotation.iter())
        .chain(seed_rad);
    if !finite.into_iter().all(|value| value.is_finite()) {
        return Err(IkError::NonFinite);
    }
    let reference = SVector::from(reference(target));
    let mut q = SVector::from(*seed_rad);
    for _ in 0..ITERATIONS_MAX {
        let (pose, jacobian) = arm::flange_and_jacobian(&q.into());
        let error = pose_error(&pose, target);
        let step = step(&jacobian, &error, &(reference - q)).ok_or(IkError::Unreachable)?;
        let largest = step.amax();
        if largest < CONVERGED_RAD {
            return accept(&pose, target, q.into());
        }
        q += step * (STEP_MAX_RAD / largest).min(1.0);
    }
    Err(IkError::Unreachable)
}

/// dq = J# e + (I - J# J) r with J# = Jᵀ (J Jᵀ + λ²)⁻¹, written as r + J# (e - J r): the pull `r`
/// towards the reference acts only where it does not move the flange.
fn step(
    jacobian: &SMatrix<f64, 6, 7>,
    error: &SVector<f64, 6>,
    pull: &SVector<f64, JOINTS>,
) -> Option<SVector<f64, JOINTS>> {
    let damping = DAMPING * error.norm_squared() + DAMPING_FLOOR;
    let normal = jacobian * jacobian.transpose() + SMatrix::<f64, 6, 6>::identity() * damping;
    let weights = normal.cholesky()?.solve(&(error - jacobian * pull));
    Some(pull + jacobian.transpose() * weights)
}

fn accept(pose: &FlangePose, target: &FlangePose, q: Joints) -> Result<Joints, IkError> {
    // The rotation error also vanishes half a turn away; the trace tells the two apart.
    let same_side = (pose.rotation.transpose() * target.rotation).trace() > 2.0;
    if !same_side || pose_error(pose, target).amax() > REACHED {
        return Err(IkError::Unreachable);
    }
    match arm::joint_out_of_range(&q) {
        Some(joint) => Err(IkError::JointLimit(joint + 1)),
        None => Ok(q),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_answer_reaches_the_pose(
            x in 0.33f64..0.60, y in -0.2f64..0.2, z in 0.13f64..0.45, yaw in -0.5f64..0.5,
        ) {
            let target = FlangePose::level([x, y, z], yaw);
            let q = solve(&target).unwrap();
            let pose = arm::flange(&q);
            prop_assert!((pose.position_m - target.position_m).norm() < 1e-9);
            prop_assert!((pose.rotation - target.rotation).norm() < 1e-9);
            prop_assert!(arm::margin_rad(&q) > 0.0);
        }

        #[test]
        fn the_answer_does_not_depend_on_a_near_seed(
            x in 0.36f64..0.58, y in -0.1f64..0.1, z in 0.15f64..0.42, nudge in prop::array::uniform7(-0.1f64..0.1),
        ) {
            let target = FlangePose::level([x, y, z], 0.2);
            let q = solve(&target).unwrap();
            let seed: Joints = core::array::from_fn(|i| q[i] + nudge[i]);
            let again = solve_near(&target, &seed).unwrap();
            for i in 0..JOINTS {
                prop_assert!((q[i] - again[i]).abs() < 1e-9, "{q:?} {again:?}");
            }
        }
    }

    #[test]
    fn the_whole_task_is_reached_well_inside_the_ranges() {
        // From behind the lowest release point to the tip of the shortest and the longest rope.
        let frame = arm::DEFAULT_TASK_FRAME;
        let mut least = f64::INFINITY;
        for i in 0..=28 {
            for k in 0..=28 {
                let (x, z) = (-0.02 + 0.01 * i as f64, 0.02 + 0.01 * k as f64);
                let q = solve(&FlangePose::level(frame.flange_m([x, z]), frame.yaw_rad)).unwrap();
                least = least.min(arm::margin_rad(&q));
            }
        }
        assert!(least > 0.4, "margin {least} rad");
    }

    /// Joint 1 jumped by a whole turn there, and every goal of such a task was refused.
    #[test]
    fn a_task_behind_the_arm_is_reached_without_a_jump() {
        for yaw in [3.0, core::f64::consts::PI, -3.1] {
            let frame = crate::blob::TaskFrame {
                origin_m: [-0.35, -0.0212, 0.12],
                yaw_rad: yaw,
            };
            let at = |x: f64| FlangePose::level(frame.flange_m([x, 0.15]), frame.yaw_rad);
            let mut before = solve(&at(0.0)).unwrap();
            for i in 1..=200 {
                let target = at(1e-3 * i as f64);
                let q = solve(&target).unwrap();
                let along = solve_near(&target, &before).unwrap();
                for joint in 0..JOINTS {
                    assert!((q[joint] - before[joint]).abs() < 0.02, "{yaw}: {before:?} {q:?}");
                    assert!((q[joint] - along[joint]).abs() < 1e-9, "{yaw}: {along:?} {q:?}");
                }
                before = q;
            }
        }
    }

    #[test]
    fn what_cannot_be_reached_is_refused() {
        let far = FlangePose::level([2.0, 0.0, 0.3], 0.0);
        assert_eq!(solve(&far), Err(IkError::Unreachable));
        let nan = FlangePose::level([f64::NAN, 0.0, 0.3], 0.0);
        assert_eq!(solve(&nan), Err(IkError::NonFinite));
        let inside = FlangePose::level([0.05, 0.0, 0.25], 0.0);
        assert!(solve(&inside).is_err());
    }
}
