//! Where the task stands in the arm's base frame: arguments that several commands take.

use super::WrongUse;
use super::numbers::within;
use clap::Args;
use shared::arm::DEFAULT_TASK_FRAME;
use shared::blob::{ORIGIN_MAX_M, TaskFrame, YAW_MAX_RAD};
use shared::reach::{share_of_releases, takes_tip};
use shared::task::SwingTask;

/// Where the arm stands beside the task.
#[derive(Args)]
pub struct Place {
    /// Where the flange is in the arm's base frame when the gripper holds the rope's end at the world's origin, m. For a
    /// policy that is on the table, 0.25 m from below the task's clamp towards the arm. Tool and fingers are in it.
    #[arg(long, num_args = 3, value_names = ["X", "Y", "Z"], value_parser = within([-ORIGIN_MAX_M, ORIGIN_MAX_M]),
        allow_negative_numbers = true, default_values_t = DEFAULT_TASK_FRAME.origin_m)]
    task_origin_m: Vec<f64>,
    /// Turn of the world about the arm's vertical axis, rad.
    #[arg(long, value_parser = within([-YAW_MAX_RAD, YAW_MAX_RAD]), allow_negative_numbers = true,
        default_value_t = DEFAULT_TASK_FRAME.yaw_rad)]
    task_yaw_rad: f64,
}

impl Place {
    /// The frame.
    pub fn frame(&self) -> TaskFrame {
        let origin_m = self.task_origin_m.as_slice().try_into();
        TaskFrame {
            origin_m: origin_m.expect("clap counts three values"),
            yaw_rad: self.task_yaw_rad,
        }
    }

    /// A warning where the arm does not come to all of a task's release points.
    ///
    /// # Errors
    /// It cannot take the tip of a rope that hangs `length_m` long: every goal would be refused.
    pub fn reach(&self, task: &SwingTask, length_m: f64) -> Result<Option<String>, WrongUse> {
        let frame = self.frame();
        let ([x, y, z], yaw_rad) = (frame.origin_m, frame.yaw_rad);
        let place = format!("--task-origin-m {x} {y} {z} --task-yaw-rad {yaw_rad}");
        takes_tip(&frame, task, length_m).map_err(|error| {
            WrongUse(format!(
                "{place}: the gripper cannot take the rope where its end hangs: {error}; the arm's reach is \
                 about 0.7 m: measure the origin again, or move the task"
            ))
        })?;
        let share = share_of_releases(&frame, task);
        Ok((share < 1.0).then(|| {
            format!(
                "{place}: the arm comes to {:.0} % of the release points; goals whose release it does not reach will be \
                 refused",
                100.0 * share
            )
        }))
    }
}
