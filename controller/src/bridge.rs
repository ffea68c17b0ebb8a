//! The second thread, between the loop and the world: it carries goals, commands and arm states to the
//! loop, targets and statuses from it. It may allocate and wait; the loop never waits for it.

use crate::clock;
use crate::constants::{BRIDGE_LAG_US, BRIDGE_LEAD_US, BRIDGE_PAUSE_US, DRIVER_SILENCE_MS, REQUEST_QUEUE};
use crate::cycle::Queues;
use crate::services::{COMMANDS, GOALS, Payload, ROBOT, STATUS, ServiceError, TARGETS};
use crate::voice::{Event, Voice};
use iceoryx2::identifiers::UniquePublisherId;
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
    driver: Heard<UniquePublisherId>,
    voice: Voice,
    complained: bool,
    /// The cycle that was due next when the bridge rested last, ns.
    cycle_ns: u64,
}

impl Bridge {
    /// Creates the services and their ports; failures are told by `voice`.
    pub fn new(node: &Node<ipc::Service>, voice: Voice) -> Result<Self, ServiceError> {
        Ok(Self {
            goals: GOALS.subscriber(node, true)?,
            commands: COMMANDS.subscriber(node, true)?,
            robots: ROBOT.subscriber(node, true)?,
            targets: TARGETS.publisher(node, true)?,
            statuses: STATUS.publisher(node, true)?,
            driver: Heard::default(),
            voice,
            complained: false,
            cycle_ns: 0,
        })
    }

    /// Carries everything that waits, once; `on_status` sees each status as it passes.
    pub fn round(&mut self, queues: &Queues, on_status: &mut dyn FnMut(&Status)) {
        let mut failures = [
            // All that there can be: behind one client's flood another's emergency stop may wait.
            take(&self.commands, COMMANDS.waiting_max(), queues, |command, _| {
                queues.put_command(command)
            }),
            take(&self.goals, REQUEST_QUEUE, queues, |goal, _| {
                queues.put(&queues.goals, goal)
            }),
            take(&self.robots, REQUEST_QUEUE, queues, |robot, driver| {
                if self.driver.counts(driver, clock::now_ns()) {
                    queues.put(&queues.robots, robot);
                }
            }),
            None,
            None,
        ];
        if self.driver.has_new_rival() {
            self.voice.say(Event::Failure {
                text: "a second driver of the arm reports; it is not heard while the first one is: stop one of them, for both \
                       move an arm"
                    .into(),
            });
        }
        for target in queues.targets.drain() {
            failures[3] = failures[3].take().or(give(&self.targets, target, queues));
        }
        for status in queues.statuses.drain() {
            on_status(&status);
            failures[4] = failures[4].take().or(give(&self.statuses, status, queues));
        }
        for failure in failures.into_iter().flatten() {
            self.complain(&failure);
        }
    }

    /// Rests between two rounds; around the start of a cycle it does not, so that what arrives until then is
    /// in time for it and its target leaves at once.
    pub fn rest(&mut self, queues: &Queues) {
        let cycle_ns = queues.next_cycle_ns.load(Ordering::Acquire);
        let turned = cycle_ns != self.cycle_ns;
        self.cycle_ns = cycle_ns;
        if let Some(until_ns) = rest_until_ns(clock::now_ns(), cycle_ns, turned) {
            clock::sleep_until(until_ns);
        }
    }

    /// Once is enough: what goes wrong every millisecond is counted in the status.
    fn complain(&mut self, failure: &str) {
        if !self.complained {
            self.voice.say(Event::Failure {
                text: format!("{failure}; further failures are only counted (messages_lost)"),
            });
            self.complained = true;
        }
    }
}

/// Who is heard of those that say the same kind of thing: the first, until it has been silent for a while.
#[derive(Debug)]
struct Heard<I> {
    who: Option<I>,
    at_ns: u64,
    rival: Rival,
}

/// What is known of others that speak beside the one who is heard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Rival {
    None,
    /// One has spoken; it may have been started in place of the one that was heard.
    Spoke,
    /// One speaks, and so does the one who is heard.
    Beside,
    /// That was told.
    Told,
}

impl<I> Default for Heard<I> {
    fn default() -> Self {
        Self {
            who: None,
            at_ns: 0,
            rival: Rival::None,
        }
    }
}

impl<I: PartialEq> Heard<I> {
    /// Whether what `who` says at `now_ns` counts.
    fn counts(&mut self, who: I, now_ns: u64) -> bool {
        let silent = now_ns.saturating_sub(self.at_ns) > DRIVER_SILENCE_MS * 1_000_000;
        let other = self.who.as_ref().is_some_and(|heard| *heard != who);
        self.rival = match self.rival {
            Rival::None if other && !silent => Rival::Spoke,
            _ if other && silent => Rival::None,
            Rival::Spoke if !other => Rival::Beside,
            as_before => as_before,
        };
        let counts = silent || !other;
        if counts {
            (self.who, self.at_ns) = (Some(who), now_ns);
        }
        counts
    }

    /// Whether another speaks beside the one who is heard, and nobody was told yet.
    fn has_new_rival(&mut self) -> bool {
        let new = self.rival == Rival::Beside;
        if new {
            self.rival = Rival::Told;
        }
        new
    }
}

/// Until when to rest at `now_ns` when the next cycle is due at `cycle_ns`; `None` for not at all: right after
/// the loop has `turned`, and from a little before a cycle until the loop has turned or is late.
fn rest_until_ns(now_ns: u64, cycle_ns: u64, turned: bool) -> Option<u64> {
    let first_ns = cycle_ns.saturating_sub(BRIDGE_LEAD_US * 1000);
    let last_ns = cycle_ns + BRIDGE_LAG_US * 1000;
    let usual_ns = now_ns + BRIDGE_PAUSE_US * 1000;
    if turned || (first_ns..last_ns).contains(&now_ns) {
        None
    } else if now_ns < first_ns {
        Some(first_ns.min(usual_ns))
    } else {
        Some(usual_ns)
    }
}

/// From a port to where `put` puts it, no more than `most`, so that a flood on one port does not keep the others waiting;
/// what went wrong, if anything did.
fn take<T: Payload>(
    port: &Subscriber<ipc::Service, T, ()>,
    most: usize,
    queues: &Queues,
    mut put: impl FnMut(T, UniquePublisherId),
) -> Option<String> {
    for _ in 0..most {
        match port.receive() {
            Ok(Some(sample)) => put(*sample, sample.origin()),
            Ok(None) => break,
            Err(error) => {
                queues.count_lost();
                return Some(format!("cannot receive: {error:?}"));
            }
        }
    }
    None
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Two drivers whose arms stand apart would else be one arm that jumps between two places.
    #[test]
    fn one_driver_is_heard_until_it_is_silent() {
        let silence_ns = DRIVER_SILENCE_MS * 1_000_000;
        let mut heard = Heard::default();
        assert!(heard.counts('a', 1000));
        assert!(!heard.counts('b', 1000 + silence_ns), "a was heard just now");
        assert!(!heard.has_new_rival(), "a may have been stopped for b");
        assert!(heard.counts('a', 2000 + silence_ns));
        assert!(heard.has_new_rival() && !heard.has_new_rival(), "told once");
        assert!(heard.counts('b', 2001 + 2 * silence_ns), "a has gone");
        assert!(!heard.counts('a', 2002 + 2 * silence_ns));
        assert!(heard.counts('b', 2003 + 2 * silence_ns));
        assert!(heard.has_new_rival(), "another one");
    }

    #[test]
    fn it_rests_except_around_the_start_of_a_cycle() {
        let cycle_ns = 100_000_000u64;
        let after = |us: i64| cycle_ns.wrapping_add_signed(us * 1000);
        let rest = |us: i64| rest_until_ns(after(us), cycle_ns, false);
        let (lead, lag, pause) = (
            BRIDGE_LEAD_US as i64,
            BRIDGE_LAG_US as i64,
            BRIDGE_PAUSE_US as i64,
        );
        assert_eq!(rest(-3000), Some(after(pause - 3000)));
        assert_eq!(
            rest(-lead - 10),
            Some(after(-lead)),
            "not past the start of its watch"
        );
        assert_eq!((rest(-lead), rest(-1), rest(lag - 1)), (None, None, None));
        assert_eq!(
            rest(lag),
            Some(after(lag + pause)),
            "a loop that is late is not waited for"
        );
        assert_eq!(
            rest_until_ns(after(-3000), cycle_ns, true),
            None,
            "what the loop has just put out is carried at once"
        );
    }
}
