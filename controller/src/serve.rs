//! The running controller: starts the session, the loop's thread and the bridge, and ends them in order.

use crate::bridge::Bridge;
use crate::constants::{BRIDGE_PAUSE_US, LOOP_RATE_MAX_HZ, LOOP_RATE_MIN_HZ, TARGET_RATE_MAX_HZ};
use crate::cycle::{Cycle, Queues};
use crate::policy_file::{self, PolicyFile};
use crate::recorder::Header;
use crate::rt;
use crate::services;
use crate::session::Instance;
use crate::step::{Controller, Setup};
use crate::timing::Timing;
use anyhow::{Context, Result, anyhow};
use iceoryx2::prelude::Config;
use shared::messages::{Phase, Reason, Status, degraded};
use std::fs::File;
use std::io::BufWriter;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread::JoinHandle;
use std::time::Duration;

/// What can be chosen about a run.
#[derive(Clone, Debug)]
pub struct Options {
    /// The policy file.
    pub policy: PathBuf,
    /// Cycles of the loop per second; see [`Rate`].
    pub rate: Rate,
    /// No target leaves the program; the arm is imagined.
    pub dry_run: bool,
    /// Name that clients connect by.
    pub instance: String,
    /// Silence of the arm after which a motion is stopped, ms.
    pub robot_timeout_ms: u64,
    /// Where to write a recording.
    pub record: Option<PathBuf>,
}

/// Cycles per second: 100 to 250, or a whole multiple of 250 up to 1000, so that every target falls on
/// a cycle and the arm gets at most 250 a second.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rate(u32);

impl std::str::FromStr for Rate {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let hz: u32 = text.parse().map_err(|_| "not a whole number".to_string())?;
        let slow = (LOOP_RATE_MIN_HZ..=TARGET_RATE_MAX_HZ).contains(&hz);
        let fast = hz <= LOOP_RATE_MAX_HZ && hz != 0 && hz.is_multiple_of(TARGET_RATE_MAX_HZ);
        if slow || fast {
            Ok(Self(hz))
        } else {
            Err("use 100 to 250, or 500, 750 or 1000 (the arm takes 250 targets a second)".to_string())
        }
    }
}

impl Rate {
    /// Time of one cycle, ns.
    pub fn cycle_ns(self) -> u64 {
        1_000_000_000 / u64::from(self.0)
    }

    /// Cycles to one target.
    pub fn cycles_per_target(self) -> u32 {
        self.0.div_ceil(TARGET_RATE_MAX_HZ)
    }
}

fn setup(options: &Options, policy: &PolicyFile, degraded: u32) -> Setup {
    let cycle_ns = options.rate.cycle_ns();
    Setup {
        blob: policy.blob.clone(),
        cycle_ns,
        cycles_per_target: options.rate.cycles_per_target(),
        silent_cycles_max: options.robot_timeout_ms * 1_000_000 / cycle_ns,
        degraded,
    }
}

/// Runs until a signal ends it.
pub fn serve(options: &Options) -> Result<()> {
    let policy = policy_file::read(&options.policy)?;
    let session = Instance::new(&options.instance)?.start()?;
    let queues = Arc::new(Queues::new(options.record.is_some()));
    end_on_signal(&queues)?;
    let (report, ready) = mpsc::channel();
    let (go, start) = mpsc::channel();
    let thread = spawn_loop(options, policy, session.config(), &queues, report, start)?;
    let header = ready
        .recv()
        .map_err(|_| anyhow!("the loop's thread did not start"))?
        .context("the loop cannot start")?;
    let recording = options
        .record
        .as_ref()
        .map(|path| create_recording(path, &header))
        .transpose()?;
    let node = services::node(session.config())?;
    let mut bridge = Bridge::new(&node, recording)?;
    go.send(())
        .map_err(|_| anyhow!("the loop's thread ended early"))?;
    session.announce()?;
    eprintln!(
        "controller: instance {} ready, {} cycles of {} us to a target; {}",
        options.instance,
        header.cycles_per_target,
        header.cycle_ns / 1000,
        rt::describe(header.degraded)
    );
    let mut newest = Status::default();
    while !queues.ended.load(Ordering::Acquire) && !thread.is_finished() {
        bridge.round(&queues, &mut |status| tell(status, &mut newest));
        std::thread::sleep(Duration::from_micros(BRIDGE_PAUSE_US));
    }
    bridge.round(&queues, &mut |status| tell(status, &mut newest));
    let timing = thread.join().map_err(|_| anyhow!("the loop's thread panicked"))?;
    summarise(&timing, &newest);
    Ok(())
}

/// Creates the loop's ports in its own thread (they cannot move), prepares the thread and waits for `go`.
fn spawn_loop(
    options: &Options,
    policy: PolicyFile,
    config: &Config,
    queues: &Arc<Queues>,
    report: Sender<Result<Header>>,
    go: Receiver<()>,
) -> Result<JoinHandle<Timing>> {
    let (options, config, queues) = (options.clone(), config.clone(), Arc::clone(queues));
    let body = move || {
        let mut timing = Timing::default();
        let ports = services::node(&config).and_then(|node| Ok((services::newest_writer(&node)?, node)));
        let (writer, _node) = match ports {
            Ok(ports) => ports,
            Err(error) => {
                let _ = report.send(Err(error.into()));
                return timing;
            }
        };
        let dry = if options.dry_run { degraded::DRY_RUN } else { 0 };
        let setup = setup(&options, &policy, rt::prepare_thread() | dry);
        let _ = report.send(Ok(Header::new(&setup, policy.crc)));
        let cycle_ns = setup.cycle_ns;
        let mut cycle = Cycle::new(Controller::new(setup), &queues, options.dry_run);
        if go.recv().is_ok() {
            cycle.run(cycle_ns, &mut timing, &mut |target| {
                writer.update_with_copy(*target)
            });
        }
        timing
    };
    std::thread::Builder::new()
        .name("loop".to_string())
        .spawn(body)
        .context("cannot start the loop's thread")
}

/// SIGINT and SIGTERM slow the arm down and end the program; kill -9 needs no help (see `session`).
fn end_on_signal(queues: &Arc<Queues>) -> Result<()> {
    let queues = Arc::clone(queues);
    ctrlc::set_handler(move || queues.shutdown.store(true, Ordering::Relaxed))
        .context("cannot watch for signals")
}

fn create_recording(path: &PathBuf, header: &Header) -> Result<BufWriter<File>> {
    let file =
        File::create(path).with_context(|| format!("cannot create the recording {}", path.display()))?;
    let mut file = BufWriter::new(file);
    header
        .write(&mut file)
        .with_context(|| format!("cannot write the recording {}", path.display()))?;
    Ok(file)
}

/// One line for every judged goal, ended goal, latch and change of state.
fn tell(status: &Status, before: &mut Status) {
    let text = |code| Reason::from_code(code).map_or("unknown", Reason::text);
    if status.goals_accepted + status.goals_refused != before.goals_accepted + before.goals_refused {
        eprintln!(
            "controller: goal {}: {}",
            status.judged_goal_id,
            text(status.judged_reason)
        );
    }
    if status.finished_goal_id != before.finished_goal_id {
        eprintln!(
            "controller: goal {} ended: {}",
            status.finished_goal_id,
            text(status.finished_reason)
        );
    }
    if status.latch_reason != before.latch_reason && status.latch_reason != 0 {
        eprintln!("controller: latched until a reset: {}", text(status.latch_reason));
    }
    if status.state != before.state || before.seq == 0 {
        eprintln!(
            "controller: {}",
            Phase::from_code(status.state).map_or("unknown", Phase::text)
        );
    }
    *before = *status;
}

fn summarise(timing: &Timing, last: &Status) {
    eprintln!(
        "controller: {} cycles, {} missed, {} targets, {} goals accepted, {} refused",
        last.cycles, last.missed_deadlines, last.targets_sent, last.goals_accepted, last.goals_refused
    );
    eprintln!("controller: wake-up {}", timing.wake());
    eprintln!("controller: turn    {}", timing.turn());
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_put_targets_on_cycles() {
        for (text, cycle_ns, cycles) in [
            ("100", 10_000_000, 1),
            ("250", 4_000_000, 1),
            ("500", 2_000_000, 2),
            ("750", 1_333_333, 3),
            ("1000", 1_000_000, 4),
        ] {
            let rate: Rate = text.parse().unwrap();
            assert_eq!((rate.cycle_ns(), rate.cycles_per_target()), (cycle_ns, cycles));
        }
        for text in ["0", "99", "300", "1250", "-1", "fast"] {
            assert!(text.parse::<Rate>().is_err(), "{text}");
        }
    }
}
