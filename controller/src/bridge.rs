//! The ordinary thread between the loop and the world: it carries goals, commands and arm states to the
//! loop, targets and statuses from it. It may allocate and wait; the loop never waits for it.

use crate::clock;
use crate::constants::{BRIDGE_LEAD_US, BRIDGE_PAUSE_US};
use crate::cycle::Queues;
use crate::services::{COMMANDS, GOALS, Payload, ROBOT, STATUS, ServiceError, TARGETS};
use iceoryx2::node::Node;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::ipc;
use shared::messages::{Command, Goal, JointTarget, RobotState, Status};
use std::sync::atomic::Ordering;

/// The publish-subscribe ports of the controller.
pub struct Bridge {
    goals: Subscriber<ipc::Service, Goal, ()>,
    commands: Subscriber<ipc::Service, Command, ()>,
    robots: Subscriber<ipc::Service, RobotState, ()>,
    targets: Publisher<ipc::Service, JointTarget, ()>,
    statuses: Publisher<ipc::Service, Status, ()>,
    complained: bool,
}

impl Bridge {
    /// Creates the services and their ports.
    pub fn new(node: &Node<ipc::Service>) -> Result<Self, ServiceError> {
        Ok(Self {
            goals: GOALS.subscriber(node, true)?,
            commands: COMMANDS.subscriber(node, true)?,
            robots: ROBOT.subscriber(node, true)?,
            targets: TARGETS.publisher(node, true)?,
            statuses: STATUS.publisher(node, true)?,
            complained: false,
        })
    }

    /// Carries everything that waits, once; `on_status` sees each status as it passes.
    pub fn round(&mut self, queues: &Queues, on_status: &mut dyn FnMut(&Status)) {
        let mut failures = [
            take(&self.commands, queues, |command| queues.put_command(command)),
            take(&self.goals, queues, |goal| queues.put(&queues.goals, goal)),
            take(&self.robots, queues, |robot| queues.put(&queues.robots, robot)),
            None,
            None,
        ];
        while let Some(target) = queues.targets.pop() {
            failures[3] = failures[3].take().or(give(&self.targets, target, queues));
        }
        while let Some(status) = queues.statuses.pop() {
            on_status(&status);
            failures[4] = failures[4].take().or(give(&self.statuses, status, queues));
        }
        for failure in failures.into_iter().flatten() {
            self.complain(&failure);
        }
    }

    /// Rests between two rounds; wakes a little before the loop's next cycle if that comes sooner.
    pub fn rest(&self, queues: &Queues) {
        let now_ns = clock::now_ns();
        let usual_ns = now_ns + BRIDGE_PAUSE_US * 1000;
        let cycle_ns = queues.next_cycle_ns.load(Ordering::Relaxed);
        let before_cycle_ns = cycle_ns.saturating_sub(BRIDGE_LEAD_US * 1000);
        let sooner = now_ns < before_cycle_ns && before_cycle_ns < usual_ns;
        clock::sleep_until(if sooner { before_cycle_ns } else { usual_ns });
    }

    /// Once is enough: what goes wrong every millisecond is counted in the status.
    fn complain(&mut self, failure: &str) {
        if !self.complained {
            eprintln!("controller: {failure}; further failures are only counted (messages_lost)");
            self.complained = true;
        }
    }
}

/// From a port to where `put` puts it; what went wrong, if anything did.
fn take<T: Payload>(
    port: &Subscriber<ipc::Service, T, ()>,
    queues: &Queues,
    put: impl Fn(T),
) -> Option<String> {
    loop {
        match port.receive() {
            Ok(Some(sample)) => put(*sample),
            Ok(None) => return None,
            Err(error) => {
                queues.count_lost();
                return Some(format!("cannot receive: {error:?}"));
            }
        }
    }
}

fn give<T: Payload>(port: &Publisher<ipc::Service, T, ()>, item: T, queues: &Queues) -> Option<String> {
    match port.send_copy(item) {
        Ok(_) => None,
        Err(error) => {
            queues.count_lost();
            Some(format!("cannot send: {error:?}"))
        }
    }
}
