//! The controller as a pure step: inputs and the time go in, a target and a status come out. No
//! clock, no transport, no allocation; the same inputs give the same outputs bit for bit.
//!
//! ```text
//!            measured pose at rest          goal accepted
//!  Waiting ───────────────────────► Idle ───────────────► Homing ► Approach ► Grasp ► Drag
//!     ▲  ▲      arm silent           │ ▲                                                │
//!     │  └───────────────────────────┘ └──── Retreat ◄ Release (open) ◄ Dwell ◄─────────┘
//!     │                                ▲
//!     │ reset,                         │ cancelled, at rest
//!     │ arm at rest      at rest       │
//!    Fault ◄────────────────────── Stopping ◄── any state: emergency stop, following error, arm's
//!   (no targets)                                error, guard; while moving: cancelled, arm or
//!                                               goal's client silent, targets unread
//!
//!  A shutdown leads through Stopping to Ended; where nothing moves, Ended and Fault are reached at once.
//! ```

mod judge;

use crate::constants::{
    FOLLOWING_ERROR_MAX_RAD, GOAL_AGE_MAX_NS, GOAL_AHEAD_MAX_NS, STALL_PERIODS, STATUS_EVERY_NS,
};
use crate::guard::{Brake, Guard};
pub use crate::interface::{Inputs, Output, Setup};
use crate::plan::{LEGS, Plan, Start};
use crate::promise::Promise;
use crate::readiness;
use crate::survey::Survey;
use shared::arm::Joints;
use shared::messages::{
    COMMAND_MAGIC, Command, CommandKind, Goal, Gripper, JointTarget, Phase, ROBOT_MAGIC, Reason, RobotState,
    STATUS_MAGIC, Status, TARGET_MAGIC, all_finite,
};

/// What follows a stop.
#[derive(Clone, Copy, Debug, PartialEq)]
enum After {
    Latch(Reason),
    Idle,
    End,
}

// The largest variant is the one in use most of the time, and a box would allocate in the loop.
#[allow(clippy::large_enum_variant)]
enum Mode {
    Waiting,
    Idle,
    Running {
        plan: Plan,
        leg: usize,
        target: u32,
        promise: Option<Promise>,
    },
    Stopping {
        brake: Brake,
        after: After,
    },
    Fault,
    Ended,
}

/// A plan made ahead of the step that may need it. A plan depends on nothing but the goal and the start.
struct Prepared {
    goal: Goal,
    start: Start,
    outcome: Result<Plan, Reason>,
}

/// The state between two cycles.
pub struct Controller {
    setup: Setup,
    survey: Option<Survey>,
    period_s: f64,
    mode: Mode,
    /// `None` until the first measured pose.
    guard: Option<Guard>,
    /// Whether the present stream's first target, the measured pose, is out.
    stream_begun: bool,
    gripper: Gripper,
    prepared: Option<Prepared>,
    robot: RobotState,
    silent_cycles: u64,
    /// When the newest emergency stop was sent, ns: a reset sent before it does not undo it.
    stop_sent_ns: u64,
    /// When the newest emergency stop or cancel was sent, ns: a goal sent before it is not served.
    drop_sent_ns: u64,
    accepted_id: u64,
    accepted_stamp_ns: u64,
    cycles_to_target: u32,
    /// When the newest target was due, ns.
    due_ns: u64,
    targets_sent: u64,
    sent_before_stream: u64,
    status: Status,
    status_changed: bool,
}

impl Controller {
    /// A controller that waits for the arm's pose. Surveys the task, which takes milliseconds.
    pub fn new(setup: Setup) -> Self {
        Self {
            period_s: (setup.cycle_ns * u64::from(setup.cycles_per_target)) as f64 * 1e-9,
            survey: Survey::new(&setup.blob),
            mode: Mode::Waiting,
            guard: None,
            stream_begun: false,
            gripper: Gripper::Open,
            prepared: None,
            robot: RobotState::default(),
            // Silent until heard.
            silent_cycles: setup.silent_cycles_max,
            stop_sent_ns: 0,
            drop_sent_ns: 0,
            accepted_id: 0,
            accepted_stamp_ns: 0,
            cycles_to_target: 1,
            due_ns: 0,
            targets_sent: 0,
            sent_before_stream: 0,
            status: Status {
                magic: STATUS_MAGIC,
                degraded: setup.degraded,
                ..Status::default()
            },
            status_changed: true,
            setup,
        }
    }

    /// Time between two targets, ns.
    pub fn period_ns(&self) -> u64 {
        self.setup.cycle_ns * u64::from(self.setup.cycles_per_target)
    }

    /// One cycle. `now_ns` is the instant on the loop's grid that the cycle belongs to.
    pub fn step(&mut self, inputs: &Inputs, now_ns: u64) -> Output {
        let phase_before = self.phase();
        self.status.cycles += 1;
        self.status.missed_deadlines = inputs.missed_deadlines;
        self.status.messages_lost = inputs.messages_lost;
        self.hear_robot(inputs.robot.as_ref(), now_ns);
        self.watch_robot();
        self.watch_goal_source();
        if let Some(command) = &inputs.command {
            self.obey(command, now_ns);
        }
        if inputs.shutdown {
            self.shut_down();
        }
        self.begin_stream();
        if let Some(goal) = &inputs.goal {
            self.judge(goal, now_ns);
        }
        self.cycles_to_target -= 1;
        let mut target = None;
        if self.cycles_to_target == 0 {
            self.cycles_to_target = self.setup.cycles_per_target;
            target = self.advance(now_ns);
        }
        self.status_changed |= self.phase() != phase_before;
        Output {
            target,
            status: self.report(now_ns),
            ended: matches!(self.mode, Mode::Ended),
        }
    }

    /// The goal being served; 0 when none is.
    pub fn active_goal_id(&self) -> u64 {
        self.status.active_goal_id
    }

    /// Cycles run since start.
    pub fn cycles(&self) -> u64 {
        self.status.cycles
    }

    /// What the controller is doing.
    pub fn phase(&self) -> Phase {
        match &self.mode {
            Mode::Waiting => Phase::Waiting,
            Mode::Idle => Phase::Idle,
            Mode::Running { plan, leg, .. } => plan.legs[*leg].phase,
            Mode::Stopping { .. } => Phase::Stopping,
            Mode::Fault => Phase::Fault,
            Mode::Ended => Phase::Ended,
        }
    }

    /// Keeps the newest sensible state of the arm. One that is malformed, not finite, from the future, older than the silence
    /// allowed or older than the one before is as good as none; the same measurement once more is no news.
    fn hear_robot(&mut self, robot: Option<&RobotState>, now_ns: u64) {
        self.silent_cycles = self.silent_cycles.saturating_add(1);
        let Some(robot) = robot else { return };
        let oldest_ns = now_ns.saturating_sub(self.setup.silent_cycles_max * self.setup.cycle_ns);
        let sensible = robot.magic == ROBOT_MAGIC
            && all_finite(&robot.q_rad)
            && all_finite(&robot.dq_rad_s)
            && robot.stamp_ns >= oldest_ns.max(self.robot.stamp_ns)
            && robot.stamp_ns <= now_ns.saturating_add(GOAL_AHEAD_MAX_NS);
        if sensible {
            if robot.stamp_ns > self.robot.stamp_ns {
                self.silent_cycles = 0;
            }
            self.robot = *robot;
        } else {
            self.status.messages_ignored += 1;
        }
    }

    /// Silence, an error or a pose away from the target stops a motion and latches. Silence is counted
    /// in cycles, so that a stall of the whole machine does not count as silence of the arm.
    fn watch_robot(&mut self) {
        if matches!(self.mode, Mode::Fault | Mode::Ended) {
            return;
        }
        if self.silent() && matches!(self.mode, Mode::Waiting | Mode::Idle) {
            self.mode = Mode::Waiting;
        } else if self.silent() {
            self.stop(After::Latch(Reason::RobotSilent));
        } else if self.robot.error_code != 0 {
            self.stop(After::Latch(Reason::RobotFault));
        } else if !matches!(self.mode, Mode::Waiting) && self.distance_rad() > FOLLOWING_ERROR_MAX_RAD {
            self.stop(After::Latch(Reason::FollowingError));
        } else if matches!(self.mode, Mode::Running { .. }) && self.targets_unread() {
            self.stop(After::Latch(Reason::TargetsUnread));
        }
    }

    /// Whether the arm's driver has read no target for as long as silence may last, or claims one that was never sent.
    fn targets_unread(&self) -> bool {
        let most = self.setup.silent_cycles_max / u64::from(self.setup.cycles_per_target);
        let unread = self.targets_sent.checked_sub(self.robot.target_seq);
        // A driver that started meanwhile knows of none from before the stream.
        unread.is_none_or(|unread| unread.min(self.targets_sent - self.sent_before_stream) > most)
    }

    /// A client that promised keep-alives and falls silent stops its goal.
    fn watch_goal_source(&mut self) {
        if let Mode::Running { promise, .. } = &mut self.mode
            && promise.as_mut().is_some_and(Promise::wait)
        {
            self.stop(After::Latch(Reason::GoalSourceSilent));
        }
    }

    fn keep_alive(&mut self, goal_id: u64) {
        if let Mode::Running { plan, promise, .. } = &mut self.mode
            && plan.goal_id == goal_id
            && let Some(promise) = promise
        {
            promise.keep();
        }
    }

    fn silent(&self) -> bool {
        self.silent_cycles >= self.setup.silent_cycles_max
    }

    /// Largest distance of a measured joint from the newest target, rad; infinite before the first target.
    fn distance_rad(&self) -> f64 {
        let Some(guard) = &self.guard else {
            return f64::INFINITY;
        };
        let both = self.robot.q_rad.iter().zip(guard.last_rad());
        both.map(|(now, last)| (now - last).abs()).fold(0.0, f64::max)
    }

    fn robot_at_rest(&self) -> bool {
        !self.silent() && readiness::at_rest(&self.robot)
    }

    /// An emergency stop is obeyed even without an id: what asks for it may be broken.
    fn obey(&mut self, command: &Command, now_ns: u64) {
        if command.magic != COMMAND_MAGIC {
            self.status.messages_ignored += 1;
            return;
        }
        // A stamp from the future would forbid what is sent after it.
        let sent_ns = command.stamp_ns.min(now_ns);
        let reason = match (CommandKind::from_code(command.kind), command.id) {
            (Some(CommandKind::EmergencyStop), _) => {
                // Of a stop without a sensible stamp is only known that it is here now.
                let known = now_ns - sent_ns <= GOAL_AGE_MAX_NS;
                let sent_ns = if known { sent_ns } else { now_ns };
                self.stop_sent_ns = self.stop_sent_ns.max(sent_ns);
                self.drop_sent_ns = self.drop_sent_ns.max(sent_ns);
                self.stop(After::Latch(Reason::EmergencyStop));
                Reason::Accepted
            }
            (None, _) | (_, 0) => Reason::Malformed,
            (Some(CommandKind::Cancel), _) => {
                self.drop_sent_ns = self.drop_sent_ns.max(sent_ns);
                if let Mode::Running { .. } = self.mode {
                    self.stop(After::Idle);
                }
                Reason::Accepted
            }
            (Some(CommandKind::Reset), _) if command.stamp_ns < self.stop_sent_ns => Reason::OutOfOrder,
            (Some(CommandKind::Reset), _) => self.reset(),
            // Comes often and is no news: it gets no answer, so that other answers stay readable.
            (Some(CommandKind::KeepAlive), goal_id) => return self.keep_alive(goal_id),
        };
        self.status.command_id = command.id;
        self.status.command_reason = reason.code();
        self.status_changed = true;
    }

    fn reset(&mut self) -> Reason {
        match self.mode {
            Mode::Fault if self.robot_at_rest() => {
                self.mode = Mode::Waiting;
                self.status.latch_reason = Reason::Accepted.code();
                Reason::Accepted
            }
            Mode::Fault => Reason::RobotNotAtRest,
            Mode::Stopping { .. } => Reason::StillMoving,
            _ => Reason::NothingToReset,
        }
    }

    fn shut_down(&mut self) {
        match self.mode {
            Mode::Running { .. }
            | Mode::Stopping {
                after: After::Idle, ..
            } => self.stop(After::End),
            Mode::Stopping { .. } | Mode::Ended => {}
            Mode::Waiting | Mode::Idle | Mode::Fault => self.mode = Mode::Ended,
        }
    }

    /// Begins to slow down, or, when already slowing down, changes what follows; the first latch stays.
    fn stop(&mut self, after: After) {
        let reason = match after {
            After::Latch(reason) => reason,
            After::Idle => Reason::Cancelled,
            After::End => Reason::Shutdown,
        };
        match &mut self.mode {
            Mode::Stopping { after: present, .. } => {
                if !matches!(present, After::Latch(_)) {
                    *present = after;
                }
            }
            Mode::Fault | Mode::Ended => return,
            Mode::Waiting => self.mode = Mode::Fault,
            Mode::Idle | Mode::Running { .. } => {
                self.mode = match &self.guard {
                    Some(guard) => Mode::Stopping {
                        brake: guard.brake(),
                        after,
                    },
                    None => Mode::Fault,
                };
            }
        }
        if matches!(after, After::Latch(_)) && self.status.latch_reason == Reason::Accepted.code() {
            self.status.latch_reason = reason.code();
        }
        self.finish_goal(reason);
        self.status_changed = true;
    }

    fn finish_goal(&mut self, reason: Reason) {
        if self.status.active_goal_id != 0 {
            self.status.finished_goal_id = self.status.active_goal_id;
            self.status.finished_reason = reason.code();
            self.status.active_goal_id = 0;
            self.status_changed = true;
        }
    }

    /// From waiting to idle once the arm stands still: a stream begins at the measured pose, in a cycle whose target is
    /// due, because an arm that moved between the two would be sent back to where it was.
    fn begin_stream(&mut self) {
        let due = matches!(self.mode, Mode::Waiting) && self.cycles_to_target == 1;
        if !due || self.silent() || readiness::obstacle(&self.robot).is_some() {
            return;
        }
        // Whoever moved it while no targets were sent, nobody asked for another state.
        self.gripper = Gripper::from_code(self.robot.gripper).unwrap_or(self.gripper);
        self.guard = Some(Guard::at_rest(self.robot.q_rad, self.period_s));
        self.stream_begun = false;
        self.sent_before_stream = self.targets_sent;
        self.status.stream += 1;
        self.mode = Mode::Idle;
    }

    /// The next target, which has passed the guard; none while waiting, in fault or at the end.
    fn advance(&mut self, now_ns: u64) -> Option<JointTarget> {
        self.go_on_after_a_stall(now_ns);
        if self.stream_begun {
            self.next_leg();
        }
        let mut next = None;
        if matches!(self.mode, Mode::Running { .. }) {
            match self.joints_of_leg() {
                Ok(joints) => next = self.send_or_stop(&joints, now_ns),
                Err(reason) => self.stop(After::Latch(reason)),
            }
        }
        // What follows a complete stop begins in the same cycle: no period goes without a target.
        next.or_else(|| self.hold(now_ns))
            .or_else(|| self.slow_down(now_ns))
            .or_else(|| self.hold(now_ns))
    }

    /// Where this program was held up, the arm has come to stand at the newest target; there a motion goes on from rest, for
    /// at full speed it would be a jerk.
    fn go_on_after_a_stall(&mut self, now_ns: u64) {
        let stalled = now_ns.saturating_sub(self.due_ns) > STALL_PERIODS * self.period_ns();
        self.due_ns = now_ns;
        let Some(guard) = self.guard.as_mut().filter(|_| stalled) else {
            return;
        };
        *guard = Guard::at_rest(guard.last_rad(), self.period_s);
        match &mut self.mode {
            Mode::Running {
                plan, leg, target, ..
            } => {
                if let Some(left) = plan.legs[*leg].left_after(*target, self.period_s) {
                    (plan.legs[*leg], *target) = (left, 0);
                }
            }
            Mode::Stopping { brake, .. } => *brake = guard.brake(),
            _ => {}
        }
    }

    fn hold(&mut self, now_ns: u64) -> Option<JointTarget> {
        let held = matches!(self.mode, Mode::Idle).then(|| self.guard.as_ref().map(Guard::last_rad));
        self.send_or_stop(&held.flatten()?, now_ns)
    }

    fn send_or_stop(&mut self, next_rad: &Joints, now_ns: u64) -> Option<JointTarget> {
        let target = self.send(next_rad, now_ns);
        if target.is_none() {
            self.stop(After::Latch(Reason::GuardTripped));
        }
        target
    }

    /// Moves on to the next target of the motion; after the last one the goal is done.
    fn next_leg(&mut self) {
        let Mode::Running {
            plan, leg, target, ..
        } = &mut self.mode
        else {
            return;
        };
        *target += 1;
        while *leg < LEGS && *target > plan.legs[*leg].targets {
            *leg += 1;
            *target = 1;
        }
        if *leg == LEGS {
            self.mode = Mode::Idle;
            self.finish_goal(Reason::Done);
        } else if self.gripper != plan.legs[*leg].gripper {
            self.gripper = plan.legs[*leg].gripper;
            self.status_changed = true;
        }
    }

    fn joints_of_leg(&self) -> Result<Joints, Reason> {
        let guard = self.guard.as_ref().ok_or(Reason::NotReady)?;
        let Mode::Running {
            plan, leg, target, ..
        } = &self.mode
        else {
            return Err(Reason::NotReady);
        };
        if !self.stream_begun {
            return Ok(guard.last_rad());
        }
        let t_s = f64::from(*target) * self.period_s;
        plan.legs[*leg].joints_rad(&self.setup.blob.frame, t_s, &guard.last_rad())
    }

    /// The next target of a stop; when it is complete, or the guard refuses even the stop (a joint
    /// would leave its range), what follows it.
    fn slow_down(&mut self, now_ns: u64) -> Option<JointTarget> {
        let Mode::Stopping { brake, after } = &mut self.mode else {
            return None;
        };
        let after = *after;
        if let Some(next) = self.guard.as_ref().and_then(|guard| guard.next_of(brake)) {
            let target = self.send(&next, now_ns);
            if target.is_none() {
                if self.status.latch_reason == Reason::Accepted.code() {
                    self.status.latch_reason = Reason::GuardTripped.code();
                }
                self.mode = Mode::Fault;
            }
            return target;
        }
        self.mode = match after {
            After::Latch(_) => Mode::Fault,
            After::Idle => Mode::Idle,
            After::End => Mode::Ended,
        };
        None
    }

    fn send(&mut self, next_rad: &Joints, now_ns: u64) -> Option<JointTarget> {
        let dq_rad_s = self.guard.as_mut()?.pass(next_rad).ok()?;
        self.stream_begun = true;
        self.targets_sent += 1;
        Some(JointTarget {
            magic: TARGET_MAGIC,
            seq: self.targets_sent,
            stamp_ns: now_ns,
            goal_id: self.status.active_goal_id,
            q_rad: *next_rad,
            dq_rad_s,
            stream: self.status.stream,
            phase: self.phase().code(),
            gripper: self.gripper.code(),
            reserved: 0,
        })
    }

    fn report(&mut self, now_ns: u64) -> Option<Status> {
        let due = now_ns.saturating_sub(self.status.stamp_ns) >= STATUS_EVERY_NS;
        if !self.status_changed && !due {
            return None;
        }
        self.status_changed = false;
        self.status.seq += 1;
        self.status.stamp_ns = now_ns;
        self.status.targets_sent = self.targets_sent;
        self.status.state = self.phase().code();
        self.status.gripper = self.gripper.code();
        Some(self.status)
    }
}
