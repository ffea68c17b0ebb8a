//! How much of a task lies within the arm's reach: better asked before hours of training than before a goal.

use crate::arm::task_pose;
use crate::blob::TaskFrame;
use crate::ik::{self, IkError};
use crate::task::{STANDOFF_M, SwingTask};

/// Release points that are tried along each side of their region.
const POINTS: u32 = 11;

/// Whether the gripper can come to where the tip of a rope of free length `length_m` hangs, m, and take it.
///
/// # Errors
/// Why it cannot.
pub fn takes_tip(frame: &TaskFrame, task: &SwingTask, length_m: f64) -> Result<(), IkError> {
    comes_to(frame, task.hanging_tip_m(length_m))
}

/// Share of the release points to which the gripper can come.
pub fn share_of_releases(frame: &TaskFrame, task: &SwingTask) -> f64 {
    let share = |k: u32| f64::from(k) / f64::from(POINTS - 1);
    let points = (0..POINTS).flat_map(|i| (0..POINTS).map(move |j| [share(i), share(j)]));
    let reached = points.filter(|[x, z]| {
        let point_m = [task.release_x_m.at(*x), task.release_z_m.at(*z)];
        comes_to(frame, point_m).is_ok()
    });
    reached.count() as f64 / f64::from(POINTS * POINTS)
}

/// Whether the gripper can be at a point of the task and before it, whence it comes and where it goes afterwards.
fn comes_to(frame: &TaskFrame, [x, z]: [f64; 2]) -> Result<(), IkError> {
    for point_m in [[x, z], [x - STANDOFF_M, z]] {
        ik::solve(&task_pose(frame, point_m))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::DEFAULT_TASK_FRAME;

    /// The paper's rope and task: in front of the arm and behind it, too far, and too near for some release points.
    #[test]
    fn a_task_is_within_reach_where_the_arm_comes_to_it() {
        let task = &SwingTask::PAPER;
        let at = |x_m: f64| TaskFrame {
            origin_m: [x_m, 0.0, 0.12],
            ..DEFAULT_TASK_FRAME
        };
        let reach = |frame: &TaskFrame| {
            (
                takes_tip(frame, task, 0.25).is_ok(),
                share_of_releases(frame, task),
            )
        };
        assert_eq!(reach(&DEFAULT_TASK_FRAME), (true, 1.0));
        assert_eq!(reach(&at(0.9)), (false, 0.0));
        let turned = TaskFrame {
            origin_m: [-0.35, 0.0, 0.12],
            yaw_rad: core::f64::consts::PI,
        };
        assert_eq!(reach(&turned), (true, 1.0), "the arm turns round");
        let (takes, share) = reach(&at(0.05));
        assert!(takes && share > 0.0 && share < 1.0, "{takes} {share}");
    }
}
