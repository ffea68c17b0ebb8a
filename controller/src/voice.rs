//! What the running controller says, and the thread that says it. Terminals block (Ctrl-S) and go away, and
//! neither may hold up the bridge, which carries emergency stops.

use crate::clock;
use crate::program;
use crate::timing::{Cost, Percentiles, Timing};
use crate::words::Words;
use serde::Serialize;
use shared::messages::Status;
use shared::task::Interval;
use std::fmt;
use std::io;
use std::sync::mpsc::{self, SyncSender};
use std::thread::JoinHandle;
use std::time::Duration;

/// Events that wait for a terminal which takes none; later ones are lost.
const WAITING_MAX: usize = 256;

/// How long the end waits for a terminal that does not take the rest.
const LAST_WORDS: Duration = Duration::from_secs(2);

/// Something worth saying. As JSON, `event` names which.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// The loop runs and clients may connect.
    Ready {
        /// Name that clients connect by.
        instance: String,
        /// Cycles to one target.
        cycles_per_target: u32,
        /// Time of one cycle, ns.
        cycle_ns: u64,
        /// Targets per second.
        targets_hz: f64,
        /// What the operating system refused, in words.
        machine: String,
    },
    /// A rope that goals may be for.
    Rope {
        /// What goals call it.
        rope: usize,
        /// Its name.
        name: String,
        /// Least and greatest goal that it was seen to reach, m.
        reach_m: [f64; 2],
    },
    /// A goal was accepted or refused.
    GoalJudged {
        /// Which.
        goal_id: u64,
        /// How.
        reason: Words,
    },
    /// A goal is done, or was stopped.
    GoalEnded {
        /// Which.
        goal_id: u64,
        /// Why.
        reason: Words,
    },
    /// A fault is latched until a reset.
    Latched {
        /// Why.
        reason: Words,
    },
    /// The controller does something else now.
    State {
        /// What.
        state: Words,
    },
    /// Something does not work, and the controller goes on without it.
    Failure {
        /// What, and what becomes of it.
        text: String,
    },
    /// The loop has ended.
    Summary(Box<Summary>),
}

/// Figures of a whole run.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    cycles: u64,
    missed: u64,
    targets: u64,
    goals_accepted: u64,
    goals_refused: u64,
    messages_lost: u64,
    cost: Cost,
    wake: Percentiles,
    start: Percentiles,
    turn: Percentiles,
    answer: Percentiles,
    goal_to_first_target: Percentiles,
    goals_beyond_period: u64,
}

impl Summary {
    /// Of a run with these times that ended in this status.
    pub fn new(timing: &Timing, last: &Status) -> Self {
        Self {
            cycles: last.cycles,
            missed: last.missed_deadlines,
            targets: last.targets_sent,
            goals_accepted: last.goals_accepted,
            goals_refused: last.goals_refused,
            messages_lost: last.messages_lost,
            cost: timing.cost(),
            wake: timing.wake(),
            start: timing.start(),
            turn: timing.turn(),
            answer: timing.answer(),
            goal_to_first_target: timing.goal(),
            goals_beyond_period: timing.goals_beyond_period(),
        }
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, out: &mut fmt::Formatter) -> fmt::Result {
        writeln!(
            out,
            "{} cycles, {} missed, {} targets, {} goals accepted, {} refused",
            self.cycles, self.missed, self.targets, self.goals_accepted, self.goals_refused
        )?;
        writeln!(out, "{} messages lost, {}", self.messages_lost, self.cost)?;
        writeln!(out, "wake-up {}", self.wake)?;
        writeln!(out, "begins  {} late", self.start)?;
        writeln!(out, "turn    {}", self.turn)?;
        writeln!(out, "of these, turns that judged a goal {}", self.answer)?;
        write!(
            out,
            "goal to first target {}; {} waited longer than a period",
            self.goal_to_first_target, self.goals_beyond_period
        )
    }
}

impl fmt::Display for Event {
    fn fmt(&self, out: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Ready {
                instance,
                cycles_per_target,
                cycle_ns,
                targets_hz,
                machine,
            } => write!(
                out,
                "instance {instance} ready, {cycles_per_target} cycles of {} us to a target, \
                 {targets_hz:.4} targets a second; {machine}",
                cycle_ns / 1000
            ),
            Self::Rope { rope, name, reach_m } => {
                let [low, high] = *reach_m;
                let reach = Interval { low, high };
                write!(out, "rope {rope}, {name}, reaches goals from {}", reach.metres())
            }
            Self::GoalJudged { goal_id, reason } => write!(out, "goal {goal_id}: {}", reason.text),
            Self::GoalEnded { goal_id, reason } => write!(out, "goal {goal_id} ended: {}", reason.text),
            Self::Latched { reason } => write!(out, "latched until a reset: {}", reason.text),
            Self::State { state } => out.write_str(state.text),
            Self::Failure { text } => out.write_str(text),
            Self::Summary(summary) => summary.fmt(out),
        }
    }
}

/// What is worth saying about `status`, given the one `before` it: every judged goal, ended goal, latch and
/// change of state.
pub fn news(status: &Status, before: &Status) -> Vec<Event> {
    let judged = |status: &Status| status.goals_accepted + status.goals_refused;
    let mut events = Vec::new();
    if judged(status) != judged(before) {
        events.push(Event::GoalJudged {
            goal_id: status.judged_goal_id,
            reason: Words::of_reason(status.judged_reason),
        });
    }
    if status.finished_goal_id != before.finished_goal_id {
        events.push(Event::GoalEnded {
            goal_id: status.finished_goal_id,
            reason: Words::of_reason(status.finished_reason),
        });
    }
    if status.latch_reason != before.latch_reason && status.latch_reason != 0 {
        events.push(Event::Latched {
            reason: Words::of_reason(status.latch_reason),
        });
    }
    if status.state != before.state || before.seq == 0 {
        events.push(Event::State {
            state: Words::of_state(status.state),
        });
    }
    events
}

/// Says events without ever waiting.
#[derive(Clone)]
pub struct Voice(SyncSender<Event>);

impl Voice {
    /// Hands `event` to the thread that says it; it is lost where too many wait already.
    pub fn say(&self, event: Event) {
        let _ = self.0.try_send(event);
    }
}

/// The thread that says events. When dropped it waits for the last words, but not for ever; every [`Voice`]
/// has to be gone by then.
pub struct Speaker(JoinHandle<()>);

impl Drop for Speaker {
    fn drop(&mut self) {
        clock::ends_within(&self.0, LAST_WORDS);
    }
}

/// Starts to speak: text on standard error, or JSON lines on standard output.
pub fn start(as_json: bool) -> io::Result<(Speaker, Voice)> {
    let (voice, events) = mpsc::sync_channel(WAITING_MAX);
    let body = move || events.iter().for_each(|event| speak(&event, as_json));
    let thread = std::thread::Builder::new().name("voice".to_string());
    Ok((Speaker(thread.spawn(body)?), Voice(voice)))
}

fn speak(event: &Event, as_json: bool) {
    if as_json {
        // Nobody may be reading, and the arm goes on.
        let _ = program::write_json(event);
    } else {
        let text = event.to_string();
        text.lines()
            .for_each(|line| program::tell(&format!("controller: {line}")));
    }
}
