//! Whether an arm that reports this may be given a stream of targets, and if not, why.

use crate::constants::STILL_RAD_S;
use shared::arm;
use shared::messages::{Reason, RobotState};

/// Whether the arm stands still and reports no error.
pub fn at_rest(robot: &RobotState) -> bool {
    robot.error_code == 0 && robot.dq_rad_s.iter().all(|speed| speed.abs() < STILL_RAD_S)
}

/// What keeps a stream from beginning at the pose that the arm reports.
pub fn obstacle(robot: &RobotState) -> Option<Reason> {
    if arm::joint_out_of_range(&robot.q_rad).is_some() {
        Some(Reason::JointOutOfRange)
    } else if at_rest(robot) {
        None
    } else {
        Some(Reason::NotReady)
    }
}
