//! What goes into a step, what comes out of it, and what never changes between two.

use shared::blob::Blob;
use shared::messages::{Command, Goal, JointTarget, RobotState, Status};

/// What does not change while the controller runs.
pub struct Setup {
    /// The policy file.
    pub blob: Box<Blob>,
    /// Time between two calls of [`crate::step::Controller::step`], ns.
    pub cycle_ns: u64,
    /// Cycles to one target.
    pub cycles_per_target: u32,
    /// Cycles after which an arm without states counts as silent, and unread targets as unread for good.
    pub silent_cycles_max: u64,
    /// How long before the release the gripper is told to open, ns: the time it takes to let go.
    pub gripper_lead_ns: u64,
    /// Bits of [`shared::messages::degraded`].
    pub degraded: u32,
}

/// What arrived since the cycle before.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Inputs {
    /// The oldest goal not judged yet.
    pub goal: Option<Goal>,
    /// The oldest command not obeyed yet.
    pub command: Option<Command>,
    /// The newest state of the arm.
    pub robot: Option<RobotState>,
    /// Stop and end.
    pub shutdown: bool,
    /// Cycles missed since start.
    pub missed_deadlines: u64,
    /// Messages lost between the threads since start.
    pub messages_lost: u64,
}

/// What a cycle produced.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Output {
    /// For the arm, every `cycles_per_target` cycles once there is a stream.
    pub target: Option<JointTarget>,
    /// On every change and every 100 ms.
    pub status: Option<Status>,
    /// The controller was told to end and stands still.
    pub ended: bool,
}
