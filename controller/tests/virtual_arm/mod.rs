//! A controller on a virtual clock with an arm that follows at once: helper of the tests beside it.

// Each test program uses another part of this.
#![allow(dead_code)]

mod limit_check;

pub use limit_check::limits_hold_at;

use controller::sample;
use controller::step::{Controller, Inputs, Output, Setup};
use shared::arm::{Joints, LEVEL_POSTURE_RAD};
use shared::messages::{
    COMMAND_MAGIC, Command, CommandKind, GOAL_MAGIC, Goal, JointTarget, Phase, ROBOT_MAGIC, Reason,
    RobotState, Status,
};

pub const CYCLE_NS: u64 = 4_000_000;
pub const PERIOD_S: f64 = 0.004;
pub const SILENT_CYCLES: u64 = 50;

pub struct World {
    pub controller: Controller,
    pub now_ns: u64,
    pub next: Inputs,
    /// What the arm reports; `None` is silence.
    pub arm: Option<RobotState>,
    /// Whether the arm goes where it is told.
    pub follows: bool,
    /// Whether the arm's driver reads the targets.
    pub reads: bool,
    /// Whether the controller plans before each cycle for the goal that the cycle brings, as the loop does.
    pub plans_ahead: bool,
    cycle_ns: u64,
    pub targets: Vec<JointTarget>,
    pub status: Status,
    /// Every reason that latched.
    pub latched: Vec<Reason>,
    pub ended: bool,
    id: u64,
}

pub fn setup() -> Setup {
    Setup {
        blob: sample::blob(),
        cycle_ns: CYCLE_NS,
        cycles_per_target: 1,
        silent_cycles_max: SILENT_CYCLES,
        gripper_lead_ns: 0,
        degraded: 0,
    }
}

pub fn arm_at(q_rad: Joints) -> RobotState {
    RobotState {
        magic: ROBOT_MAGIC,
        q_rad,
        ..RobotState::default()
    }
}

impl World {
    /// The arm is there and still, but nothing has been said yet.
    pub fn new() -> Self {
        Self::with(setup())
    }

    /// The same with another setup.
    pub fn with(setup: Setup) -> Self {
        Self {
            cycle_ns: setup.cycle_ns,
            controller: Controller::new(setup),
            now_ns: 1_000_000_000,
            next: Inputs::default(),
            arm: Some(arm_at(LEVEL_POSTURE_RAD)),
            follows: true,
            reads: true,
            plans_ahead: false,
            targets: Vec::new(),
            status: Status::default(),
            latched: Vec::new(),
            ended: false,
            id: 0,
        }
    }

    /// The same after the first cycles: idle.
    pub fn idle() -> Self {
        let mut world = Self::new();
        world.run(2);
        assert_eq!(world.controller.phase(), Phase::Idle);
        world
    }

    pub fn cycle(&mut self) -> Output {
        self.now_ns += self.cycle_ns;
        if self.plans_ahead {
            let goal = self.next.goal.unwrap_or_else(|| self.controller.likely_goal());
            self.controller.prepare(&goal);
        }
        if let Some(arm) = &mut self.arm {
            arm.seq += 1;
            arm.stamp_ns = self.now_ns;
            self.next.robot = Some(*arm);
        }
        let inputs = std::mem::take(&mut self.next);
        let output = self.controller.step(&inputs, self.now_ns);
        if let Some(target) = output.target {
            self.targets.push(target);
            if let Some(arm) = &mut self.arm {
                if self.follows {
                    arm.q_rad = target.q_rad;
                }
                if self.reads {
                    arm.target_seq = target.seq;
                }
            }
        }
        if let Some(status) = output.status {
            let reason = Reason::from_code(status.latch_reason).expect("a known reason");
            if status.latch_reason != self.status.latch_reason && reason != Reason::Accepted {
                self.latched.push(reason);
            }
            self.status = status;
        }
        self.ended |= output.ended;
        output
    }

    /// Time in which the controller is held up.
    pub fn stall(&mut self, cycles: u64) {
        self.now_ns += cycles * self.cycle_ns;
    }

    pub fn run(&mut self, cycles: usize) {
        for _ in 0..cycles {
            self.cycle();
        }
    }

    /// Cycles until the phase is reached.
    pub fn run_to(&mut self, phase: Phase) {
        for _ in 0..10_000 {
            if self.controller.phase() == phase {
                return;
            }
            self.cycle();
        }
        panic!("{phase:?} was not reached; now {:?}", self.controller.phase());
    }

    pub fn goal_at(&mut self, x_m: f64) -> Goal {
        self.id += 1;
        Goal {
            magic: GOAL_MAGIC,
            stamp_ns: self.now_ns,
            id: self.id,
            x_m,
            rope: 0,
            keep_alive_ms: 0,
        }
    }

    /// Sends a goal and returns the verdict on it.
    pub fn ask(&mut self, goal: Goal) -> Reason {
        self.next.goal = Some(goal);
        self.cycle();
        assert_eq!(self.status.judged_goal_id, goal.id);
        Reason::from_code(self.status.judged_reason).unwrap()
    }

    pub fn accept(&mut self) -> u64 {
        let goal = self.goal_at(0.33);
        assert_eq!(self.ask(goal), Reason::Accepted);
        goal.id
    }

    /// Says in the next cycle that the goal is still wanted.
    pub fn keep_alive(&mut self, goal_id: u64) {
        self.next.command = Some(Command {
            id: goal_id,
            ..self.order(CommandKind::KeepAlive)
        });
    }

    /// A command that a client sends now.
    pub fn order(&mut self, kind: CommandKind) -> Command {
        self.id += 1;
        Command {
            magic: COMMAND_MAGIC,
            stamp_ns: self.now_ns,
            id: self.id,
            kind: kind.code(),
            reserved: 0,
        }
    }

    /// Sends a command and returns the verdict on it.
    pub fn command(&mut self, kind: CommandKind) -> Reason {
        let command = self.order(kind);
        self.next.command = Some(command);
        self.cycle();
        assert_eq!(self.status.command_id, command.id);
        Reason::from_code(self.status.command_reason).unwrap()
    }

    pub fn latch(&self) -> Reason {
        Reason::from_code(self.status.latch_reason).unwrap()
    }
}

/// All of `targets`, `PERIOD_S` apart.
pub fn limits_hold(targets: &[JointTarget]) -> Result<(), String> {
    limits_hold_at(targets, PERIOD_S)
}
