//! What travels between the controller, its clients and the arm: fixed layouts that any language can
//! read. A layout that changes gets a new type name and a new magic word, so that old and new never
//! misread each other. Times are CLOCK_MONOTONIC of this machine in ns; angles rad, lengths m.
//!
//! `controller/clients/README.md` explains them to people who write clients; a test compares it, the
//! Python module and the C header beside it with this file.

use crate::arm::{JOINTS, Joints};
use iceoryx2_bb_derive_macros::ZeroCopySend;
use iceoryx2_bb_elementary_traits::zero_copy_send::ZeroCopySend;

/// Goes up whenever a type name below changes; the controller announces it, so that a client of another
/// version is told so in one line instead of failing to open a service.
pub const PROTOCOL: u32 = 2;

/// First word of a [`Goal`]: the bytes `GENGOAL1`.
pub const GOAL_MAGIC: u64 = u64::from_le_bytes(*b"GENGOAL1");
/// First word of a [`Command`]: the bytes `GENCMND1`.
pub const COMMAND_MAGIC: u64 = u64::from_le_bytes(*b"GENCMND1");
/// First word of a [`RobotState`]: the bytes `GENROBO2`.
pub const ROBOT_MAGIC: u64 = u64::from_le_bytes(*b"GENROBO2");
/// First word of a [`JointTarget`]: the bytes `GENTARG1`.
pub const TARGET_MAGIC: u64 = u64::from_le_bytes(*b"GENTARG1");
/// First word of a [`Status`]: the bytes `GENSTAT1`.
pub const STATUS_MAGIC: u64 = u64::from_le_bytes(*b"GENSTAT1");

/// Client to controller: swing the tip of this rope to this x.
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("genorm.Goal.v1")]
pub struct Goal {
    /// [`GOAL_MAGIC`].
    pub magic: u64,
    /// When the client sent it, ns; a goal older than half a second is refused.
    pub stamp_ns: u64,
    /// The client's name for this goal; not zero and not the id of the goal that was accepted last.
    pub id: u64,
    /// Where the tip shall reach, x in the task frame, m.
    pub x_m: f64,
    /// Which rope of the policy file, from 0.
    pub rope: u32,
    /// How often the client promises a [`CommandKind::KeepAlive`] while this goal is served, ms: when it
    /// falls silent for longer, the arm stops and a fault is latched. 0 promises nothing.
    pub keep_alive_ms: u32,
}

/// Client to controller: stop, or go on after a stop.
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("genorm.Command.v1")]
pub struct Command {
    /// [`COMMAND_MAGIC`].
    pub magic: u64,
    /// When the client sent it, ns. A stop is obeyed however old it is.
    pub stamp_ns: u64,
    /// The client's name for this command, not zero; for a keep-alive the id of its goal.
    pub id: u64,
    /// A [`CommandKind`].
    pub kind: u32,
    /// Zero.
    pub reserved: u32,
}

/// The arm's driver to controller: what the arm measures.
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("genorm.RobotState.v2")]
pub struct RobotState {
    /// [`ROBOT_MAGIC`].
    pub magic: u64,
    /// Counts up by one per message.
    pub seq: u64,
    /// When the joints were measured, ns.
    pub stamp_ns: u64,
    /// [`JointTarget::seq`] of the newest target that the driver has read; 0 before the first.
    pub target_seq: u64,
    /// Measured joint angles, rad.
    pub q_rad: [f64; JOINTS],
    /// Measured joint speeds, rad/s.
    pub dq_rad_s: [f64; JOINTS],
    /// Error code of the control box (2 and so on); 0 is none.
    pub error_code: u32,
    /// A [`Gripper`]: what the gripper reports.
    pub gripper: u32,
}

/// Controller to the arm's driver: where the joints shall be now.
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("genorm.JointTarget.v1")]
pub struct JointTarget {
    /// [`TARGET_MAGIC`]; anything else (the blackboard before the first target, and while none are sent) is no
    /// target.
    pub magic: u64,
    /// Counts up by one per target from 1.
    pub seq: u64,
    /// The instant on the controller's grid that this target is for, ns.
    pub stamp_ns: u64,
    /// The goal being served; 0 when none is.
    pub goal_id: u64,
    /// Joint angles, rad.
    pub q_rad: [f64; JOINTS],
    /// Joint speeds that lead from the target before to this one, rad/s.
    pub dq_rad_s: [f64; JOINTS],
    /// Counts up when targets begin anew at a measured pose; limits hold between targets of one stream.
    pub stream: u32,
    /// The [`Phase`] that made it.
    pub phase: u32,
    /// A [`Gripper`].
    pub gripper: u32,
    /// Zero.
    pub reserved: u32,
}

/// Controller to everybody: on every change and every 100 ms.
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("genorm.Status.v1")]
pub struct Status {
    /// [`STATUS_MAGIC`].
    pub magic: u64,
    /// Counts up by one per status.
    pub seq: u64,
    /// When it was made, ns.
    pub stamp_ns: u64,
    /// The goal that was judged last, and `judged_reason` says how.
    pub judged_goal_id: u64,
    /// The goal being served; 0 when none is.
    pub active_goal_id: u64,
    /// The goal that ended last, and `finished_reason` says how.
    pub finished_goal_id: u64,
    /// The command that was judged last, and `command_reason` says how.
    pub command_id: u64,
    /// Cycles of the loop since start.
    pub cycles: u64,
    /// Cycles that could not be run in time; the grid was kept and none was caught up.
    pub missed_deadlines: u64,
    /// Goals accepted since start.
    pub goals_accepted: u64,
    /// Goals refused since start.
    pub goals_refused: u64,
    /// Messages ignored because they were malformed or not finite.
    pub messages_ignored: u64,
    /// Messages dropped between the threads because a queue was full.
    pub messages_lost: u64,
    /// Targets sent since start.
    pub targets_sent: u64,
    /// The [`Phase`] now.
    pub state: u32,
    /// A [`Reason`]: `Accepted`, or why the goal was refused.
    pub judged_reason: u32,
    /// A [`Reason`]: `Done`, or what ended the goal.
    pub finished_reason: u32,
    /// A [`Reason`]: `Accepted`, or why the command was refused.
    pub command_reason: u32,
    /// A [`Reason`]: what latched the fault; `Accepted` (0) when none is latched.
    pub latch_reason: u32,
    /// Bits of [`degraded`]: what the machine did not permit.
    pub degraded: u32,
    /// The stream of targets, as in [`JointTarget::stream`].
    pub stream: u32,
    /// A [`Gripper`]: what was commanded last.
    pub gripper: u32,
}

/// Bits of [`Status::degraded`]. Zero means that the loop runs with everything it asked for.
pub mod degraded {
    /// No real-time scheduling (SCHED_FIFO): other programs can delay the loop.
    pub const NO_FIFO: u32 = 1;
    /// The loop is not bound to one processor.
    pub const NO_AFFINITY: u32 = 2;
    /// Memory is not locked: a page fault can delay the loop.
    pub const NO_MEMLOCK: u32 = 4;
    /// Denormal numbers are not flushed to zero.
    pub const NO_FLUSH_TO_ZERO: u32 = 8;
    /// Dry run: no target leaves the program, the arm is imagined.
    pub const DRY_RUN: u32 = 16;
    /// Processors may fall into deep sleep (`/dev/cpu_dma_latency` not held), from which they wake late.
    pub const MAY_SLEEP: u32 = 32;
}

/// Declares an enumeration that travels as a `u32`, with its code, its way back and one line of text.
macro_rules! coded {
    ($(#[$outer:meta])* $name:ident {
        $first:ident = $first_code:literal, $first_text:literal;
        $($variant:ident = $code:literal, $text:literal;)*
    }) => {
        $(#[$outer])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
        #[repr(u32)]
        pub enum $name {
            #[default]
            #[doc = $first_text]
            $first = $first_code,
            $(#[doc = $text] $variant = $code,)*
        }

        impl $name {
            /// Every value, in the order of the codes.
            pub const ALL: &[Self] = &[Self::$first $(, Self::$variant)*];

            /// The number that travels.
            pub const fn code(self) -> u32 {
                self as u32
            }

            /// The value of a number that travelled; `None` when this version does not know it.
            pub fn from_code(code: u32) -> Option<Self> {
                Self::ALL.iter().copied().find(|value| value.code() == code)
            }

            /// One line for people.
            pub const fn text(self) -> &'static str {
                match self {
                    Self::$first => $first_text,
                    $(Self::$variant => $text,)*
                }
            }
        }
    };
}

coded! {
    /// What a [`Command`] asks for.
    CommandKind {
        EmergencyStop = 1, "stop now and latch; only a reset goes on";
        Reset = 2, "clear a latched fault; the arm must stand still and report no error";
        Cancel = 3, "stop, drop the goal and be idle again";
        KeepAlive = 4, "the goal named by the id is still wanted; gets no answer";
    }
}

coded! {
    /// What the gripper is told.
    Gripper {
        Open = 0, "open";
        Closed = 1, "closed";
    }
}

coded! {
    /// What the controller is doing.
    Phase {
        Waiting = 0, "waiting for a measured pose at rest; no targets";
        Idle = 1, "holding still, ready for a goal";
        Homing = 2, "joint motion to the point before the rope's tip";
        Approach = 3, "straight line to the tip";
        Grasp = 4, "closing the gripper on the tip";
        Drag = 5, "straight line to the release point";
        Dwell = 6, "waiting until the rope is still";
        Release = 7, "gripper open, arm still";
        Retreat = 8, "straight line away from the rope";
        Stopping = 9, "slowing down within the limits";
        Fault = 10, "stopped and latched until a reset; no targets";
        Ended = 11, "the controller ends; no targets";
    }
}

coded! {
    /// Why something happened: an accepted or refused goal or command, an ended goal, a latched fault.
    Reason {
        Accepted = 0, "accepted";
        Done = 1, "done";
        Malformed = 10, "wrong magic word, zero id or unknown kind";
        NonFinite = 11, "the goal is not a finite number";
        Stale = 12, "the goal is older than half a second";
        FromFuture = 13, "the goal's stamp lies in the future: clocks differ";
        OutOfOrder = 14, "older than what came before it: than the goal accepted last, or a reset than the last stop; or the goal repeats an id";
        UnknownRope = 15, "the policy file has no such rope";
        OutOfRange = 16, "the goal lies outside what this rope was seen to reach or the policy was trained for";
        ReleaseOutOfRange = 17, "the release point lies outside the task or beyond the rope's length";
        Unreachable = 18, "the arm cannot reach a pose of the motion within its joint ranges";
        TooFast = 19, "the motion would break a limit of speed, acceleration or jerk";
        Busy = 20, "another goal is being served";
        NotReady = 21, "the arm does not report yet, or does not stand still";
        Latched = 22, "a fault is latched: reset first";
        HomingTooLow = 23, "on the way to the rope the flange would come below the height at which it touches the table";
        JointOutOfRange = 24, "a joint of the arm stands outside its range";
        EmergencyStop = 40, "emergency stop";
        RobotSilent = 41, "the arm's state stopped coming";
        FollowingError = 42, "the arm is not where it was told to be";
        RobotFault = 43, "the arm reports an error";
        GuardTripped = 44, "the guard refused a target";
        Cancelled = 45, "cancelled by a client";
        Shutdown = 46, "the controller was told to end";
        GoalSourceSilent = 47, "the client of the goal broke its promise to send keep-alives";
        TargetsUnread = 48, "the arm's driver does not read the targets";
        NothingToReset = 60, "no fault is latched";
        StillMoving = 61, "the stop is not complete";
        RobotNotAtRest = 62, "the arm moves, reports an error or is silent";
    }
}

impl Reason {
    /// What to do about it, one line for people; empty where nothing is.
    pub const fn remedy(self) -> &'static str {
        match self {
            Self::Accepted | Self::Done | Self::Cancelled | Self::Shutdown | Self::NothingToReset => "",
            Self::Malformed => "fill in every field; use a client of this version",
            Self::NonFinite => "send a number",
            Self::Stale => "send it anew; stamps are CLOCK_MONOTONIC",
            Self::FromFuture => "use CLOCK_MONOTONIC of this machine",
            Self::OutOfOrder => "give every goal a new id",
            Self::UnknownRope => "`offline inspect` lists the ropes, from 0",
            Self::OutOfRange => "`offline inspect` prints what each rope reaches",
            Self::ReleaseOutOfRange => "the policy does not fit this rope: train it with the rope",
            Self::Unreachable => {
                "freeze again with the task where the arm reaches it (`--task-origin-m`, `--task-yaw-rad`)"
            }
            Self::TooFast => {
                "freeze again with the task farther from the arm's limits (`--task-origin-m`, `--task-yaw-rad`)"
            }
            Self::Busy => "wait for `finished_goal_id`, or cancel",
            Self::NotReady => "start the arm's driver; let the arm rest",
            Self::Latched => "look at the arm, then send a reset",
            Self::HomingTooLow => "move the arm by hand to a pose from which it may go straight to the rope",
            Self::JointOutOfRange => "move the arm by hand into its joint ranges",
            Self::EmergencyStop => "look at the arm, then send a reset",
            Self::RobotSilent => "see to the arm's driver, then reset",
            Self::FollowingError => "see what holds the arm, then reset",
            Self::RobotFault => "clear the arm's error (the bridge does), then reset",
            Self::GuardTripped => "report it: what is planned should pass",
            Self::GoalSourceSilent => "see to the client, then reset",
            Self::TargetsUnread => "see to the arm's driver; reset if latched",
            Self::StillMoving => "reset again when the state is fault",
            Self::RobotNotAtRest => "clear the arm's error, let it rest, reset again",
        }
    }
}

/// A joint angle array that only holds finite numbers.
pub fn all_finite(values: &Joints) -> bool {
    values.iter().all(|value| value.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::mem::{align_of, offset_of, size_of};

    #[test]
    fn golden_sizes() {
        let sizes = [
            size_of::<Goal>(),
            size_of::<Command>(),
            size_of::<RobotState>(),
            size_of::<JointTarget>(),
            size_of::<Status>(),
        ];
        assert_eq!(sizes, [40, 32, 152, 160, 144]);
        assert_eq!(align_of::<Status>(), 8);
    }

    #[test]
    fn golden_offsets() {
        assert_eq!(
            [
                offset_of!(Goal, stamp_ns),
                offset_of!(Goal, id),
                offset_of!(Goal, x_m),
                offset_of!(Goal, rope)
            ],
            [8, 16, 24, 32]
        );
        assert_eq!([offset_of!(Command, id), offset_of!(Command, kind)], [16, 24]);
        assert_eq!(
            [
                offset_of!(RobotState, target_seq),
                offset_of!(RobotState, q_rad),
                offset_of!(RobotState, dq_rad_s),
                offset_of!(RobotState, error_code),
                offset_of!(RobotState, gripper)
            ],
            [24, 32, 88, 144, 148]
        );
        assert_eq!(
            [
                offset_of!(JointTarget, goal_id),
                offset_of!(JointTarget, q_rad),
                offset_of!(JointTarget, dq_rad_s),
                offset_of!(JointTarget, stream),
                offset_of!(JointTarget, phase),
                offset_of!(JointTarget, gripper)
            ],
            [24, 32, 88, 144, 148, 152]
        );
        assert_eq!(
            [
                offset_of!(Status, judged_goal_id),
                offset_of!(Status, cycles),
                offset_of!(Status, targets_sent),
                offset_of!(Status, state),
                offset_of!(Status, latch_reason),
                offset_of!(Status, gripper)
            ],
            [24, 56, 104, 112, 128, 140]
        );
    }

    #[test]
    fn type_names_and_magic_words_carry_the_version() {
        // Whoever changes a name below raises the number.
        assert_eq!(PROTOCOL, 2);
        // SAFETY: the function is unsafe only because implementing the trait is.
        let names = unsafe {
            [
                Goal::type_name(),
                Command::type_name(),
                RobotState::type_name(),
                JointTarget::type_name(),
                Status::type_name(),
            ]
        };
        assert_eq!(
            names,
            [
                "genorm.Goal.v1",
                "genorm.Command.v1",
                "genorm.RobotState.v2",
                "genorm.JointTarget.v1",
                "genorm.Status.v1"
            ]
        );
        assert_eq!(GOAL_MAGIC.to_le_bytes(), *b"GENGOAL1");
    }

    #[test]
    fn codes_travel_both_ways() {
        for &reason in Reason::ALL {
            assert_eq!(Reason::from_code(reason.code()), Some(reason));
        }
        assert_eq!(Reason::from_code(9999), None);
        assert_eq!(Phase::from_code(10), Some(Phase::Fault));
        assert_eq!(CommandKind::from_code(0), None);
    }
}
