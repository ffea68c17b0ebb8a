//! For programs that talk to a running controller: connect, send goals and commands, watch targets
//! and statuses, or play the arm.
//!
//! ```no_run
//! use controller::client::Client;
//! use std::time::Duration;
//!
//! let mut client = Client::connect("genorm", Duration::from_secs(2))?;
//! let id = client.send_goal(0, 0.33)?;
//! while let Some(status) = client.wait_status(Duration::from_secs(1))? {
//!     println!("goal {id}: state {}", status.state);
//! }
//! # Ok::<(), controller::services::ServiceError>(())
//! ```

use crate::clock;
use crate::services::{self, COMMANDS, GOALS, NewestReader, Payload, ROBOT, STATUS, ServiceError, TARGETS};
use crate::session::Instance;
use crate::sweeper::Sweeper;
use iceoryx2::node::Node;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::ipc;
use shared::messages::{
    COMMAND_MAGIC, Command, CommandKind, GOAL_MAGIC, Goal, JointTarget, ROBOT_MAGIC, RobotState,
    STATUS_MAGIC, Status, TARGET_MAGIC,
};
use std::time::{Duration, Instant};

const PAUSE: Duration = Duration::from_millis(1);

/// A connection to a running controller. When its statuses stop, connect again: a restarted
/// controller is another session.
pub struct Client {
    goals: Publisher<ipc::Service, Goal, ()>,
    commands: Publisher<ipc::Service, Command, ()>,
    targets: Subscriber<ipc::Service, JointTarget, ()>,
    status: Subscriber<ipc::Service, Status, ()>,
    last_id: u64,
    instance: Instance,
    // Dropped last: the ports above live in it.
    node: Node<ipc::Service>,
}

/// The arm's side of the connection, for drivers and simulated arms.
pub struct ArmPort {
    states: Publisher<ipc::Service, RobotState, ()>,
    newest: NewestReader,
    seq: u64,
    target_seq: u64,
}

fn failed(what: &'static str, reason: impl std::fmt::Debug) -> ServiceError {
    ServiceError::Transport {
        what,
        name: "a message".to_string(),
        reason: format!("{reason:?}"),
    }
}

impl Client {
    /// Connects to the controller called `instance`, waiting up to `patience` for it to be there. A
    /// controller of another version is not waited for.
    pub fn connect(instance: &str, patience: Duration) -> Result<Self, ServiceError> {
        let instance = Instance::new(instance)?;
        // The controller sweeps too, but may be killed at any time.
        let _sweeper = Sweeper::start(&instance);
        let start = Instant::now();
        loop {
            match Self::connect_now(&instance) {
                Err(error) if error.may_pass() && start.elapsed() < patience => {
                    std::thread::sleep(10 * PAUSE);
                }
                outcome => return outcome,
            }
        }
    }

    fn connect_now(instance: &Instance) -> Result<Self, ServiceError> {
        let node = services::node(&instance.running_config()?)?;
        Ok(Self {
            goals: GOALS.publisher(&node, false)?,
            commands: COMMANDS.publisher(&node, false)?,
            targets: TARGETS.subscriber(&node, false)?,
            status: STATUS.subscriber(&node, false)?,
            last_id: clock::now_ns(),
            instance: instance.clone(),
            node,
        })
    }

    /// Sends the goal "rope number `rope`, tip at `x_m`" and returns the id that statuses name it by.
    pub fn send_goal(&mut self, rope: u32, x_m: f64) -> Result<u64, ServiceError> {
        self.send_watched_goal(rope, x_m, 0)
    }

    /// The same with the promise to call [`Self::keep_alive`] at least every `keep_alive_ms` until the goal
    /// has ended: when this program dies or hangs, the arm stops. 0 promises nothing.
    pub fn send_watched_goal(
        &mut self,
        rope: u32,
        x_m: f64,
        keep_alive_ms: u32,
    ) -> Result<u64, ServiceError> {
        let goal = Goal {
            magic: GOAL_MAGIC,
            stamp_ns: clock::now_ns(),
            id: self.next_id(),
            x_m,
            rope,
            keep_alive_ms,
        };
        self.send_raw_goal(goal)?;
        Ok(goal.id)
    }

    /// Says that the goal `goal_id` is still wanted.
    pub fn keep_alive(&mut self, goal_id: u64) -> Result<(), ServiceError> {
        self.command(CommandKind::KeepAlive, goal_id)
    }

    /// Sends a goal as it is, sensible or not.
    pub fn send_raw_goal(&mut self, goal: Goal) -> Result<(), ServiceError> {
        self.goals
            .send_copy(goal)
            .map(|_| ())
            .map_err(|error| failed("send", error))
    }

    /// Sends a command and returns its id.
    pub fn send_command(&mut self, kind: CommandKind) -> Result<u64, ServiceError> {
        let id = self.next_id();
        self.command(kind, id)?;
        Ok(id)
    }

    fn command(&mut self, kind: CommandKind, id: u64) -> Result<(), ServiceError> {
        let command = Command {
            magic: COMMAND_MAGIC,
            stamp_ns: clock::now_ns(),
            id,
            kind: kind.code(),
            reserved: 0,
        };
        self.commands
            .send_copy(command)
            .map(|_| ())
            .map_err(|error| failed("send", error))
    }

    /// The next target of the stream, if one has come.
    pub fn next_target(&mut self) -> Result<Option<JointTarget>, ServiceError> {
        next(&self.targets, |target| target.magic == TARGET_MAGIC)
    }

    /// The next status, if one has come.
    pub fn next_status(&mut self) -> Result<Option<Status>, ServiceError> {
        next(&self.status, |status| status.magic == STATUS_MAGIC)
    }

    /// The next status, waiting up to `patience`; a live controller sends one every 100 ms.
    pub fn wait_status(&mut self, patience: Duration) -> Result<Option<Status>, ServiceError> {
        let start = Instant::now();
        loop {
            let status = self.next_status()?;
            if status.is_some() || start.elapsed() > patience {
                return Ok(status);
            }
            std::thread::sleep(PAUSE);
        }
    }

    /// The arm's ports of this connection.
    pub fn arm(&self) -> Result<ArmPort, ServiceError> {
        let _sweeper = Sweeper::start(&self.instance);
        Ok(ArmPort {
            states: ROBOT.publisher(&self.node, false)?,
            newest: services::newest_reader(&self.node)?,
            seq: 0,
            target_seq: 0,
        })
    }

    /// Ids come from the clock, so that those of two clients hardly ever meet.
    fn next_id(&mut self) -> u64 {
        self.last_id = clock::now_ns().max(self.last_id + 1);
        self.last_id
    }
}

impl ArmPort {
    /// The newest target, once there is one. Follow only this: older ones are history.
    pub fn newest_target(&mut self) -> Option<JointTarget> {
        let target = *self.newest.get();
        if target.magic != TARGET_MAGIC {
            return None;
        }
        self.target_seq = target.seq;
        Some(target)
    }

    /// Reports what the arm measures; magic word, number and the newest target read are filled in here, and
    /// where `stamp_ns` is 0 the time now.
    pub fn send_state(&mut self, state: RobotState) -> Result<(), ServiceError> {
        self.seq += 1;
        let state = RobotState {
            magic: ROBOT_MAGIC,
            seq: self.seq,
            stamp_ns: match state.stamp_ns {
                0 => clock::now_ns(),
                measured_ns => measured_ns,
            },
            target_seq: self.target_seq,
            ..state
        };
        self.states
            .send_copy(state)
            .map(|_| ())
            .map_err(|error| failed("send", error))
    }
}

/// The next sample that `is_ours` recognises.
fn next<T: Payload>(
    port: &Subscriber<ipc::Service, T, ()>,
    is_ours: impl Fn(&T) -> bool,
) -> Result<Option<T>, ServiceError> {
    loop {
        match port.receive() {
            Ok(Some(sample)) if is_ours(&sample) => return Ok(Some(*sample)),
            Ok(Some(_)) => {}
            Ok(None) => return Ok(None),
            Err(error) => return Err(failed("receive", error)),
        }
    }
}
