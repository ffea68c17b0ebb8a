//! The running controller: starts the session, the loop's thread, the bridge and the recorder, and ends
//! them in order.

use crate::bridge::Bridge;
use crate::constants::{LOOP_RATE_MAX_HZ, LOOP_RATE_MIN_HZ, TARGET_RATE_MAX_HZ};
use crate::cycle::{Cycle, Queues};
use crate::policy_file::{self, PolicyFile};
use crate::recorder::{self, Recorder};
use crate::rt;
use crate::services;
use crate::session::Instance;
use crate::step::{Controller, Setup};
use crate::sweeper::Sweeper;
use crate::timing::Timing;
use crate::voice::{self, Event, Summary, Voice};
use anyhow::{Context, Result, anyhow, bail};
use iceoryx2::prelude::Config;
use shared::blob::Blob;
use shared::messages::{Status, degraded};
use shared::recording::Header;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread::JoinHandle;

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
    /// Time that the gripper takes to let go, ms; it is told to open that much before the release.
    pub gripper_latency_ms: u64,
    /// Where to write a recording.
    pub record: Option<PathBuf>,
    /// Events as JSON lines on standard output; as text on standard error otherwise.
    pub json: bool,
}

/// Cycles per second, 100 to 1000. Every target falls on a cycle, and the arm gets at most 250 a second:
/// exactly 250 at 250, 500, 750 and 1000, else the largest part of the rate that is a whole number of
/// cycles apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rate(u32);

impl std::str::FromStr for Rate {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.parse() {
            Ok(hz) if (LOOP_RATE_MIN_HZ..=LOOP_RATE_MAX_HZ).contains(&hz) => Ok(Self(hz)),
            _ => Err("use a whole number from 100 to 1000".to_string()),
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

    /// Targets per second.
    pub fn targets_hz(self) -> f64 {
        f64::from(self.0) / f64::from(self.cycles_per_target())
    }
}

fn setup(options: &Options, blob: &Blob, degraded: u32) -> Setup {
    let cycle_ns = options.rate.cycle_ns();
    Setup {
        blob: Box::new(blob.clone()),
        cycle_ns,
        cycles_per_target: options.rate.cycles_per_target(),
        silent_cycles_max: options.robot_timeout_ms * 1_000_000 / cycle_ns,
        gripper_lead_ns: options.gripper_latency_ms * 1_000_000,
        degraded,
    }
}

fn check_gripper(options: &Options, blob: &Blob) -> Result<()> {
    let (latency_s, dwell_s) = (options.gripper_latency_ms as f64 * 1e-3, blob.task.dwell_s);
    if latency_s > dwell_s {
        bail!(
            "the gripper's latency ({latency_s} s) exceeds the dwell before the release ({dwell_s} s): give a shorter --gripper-latency-ms"
        );
    }
    Ok(())
}

/// Runs until a signal ends it.
pub fn serve(options: &Options) -> Result<()> {
    let policy = policy_file::read(&options.policy)?;
    check_gripper(options, &policy.blob)?;
    let (_speaker, voice) = voice::start(options.json).context("cannot start the voice's thread")?;
    let instance = Instance::new(&options.instance)?;
    let session = instance.start()?;
    let _sweeper = Sweeper::start(&instance).context("cannot start the sweeper's thread")?;
    let queues = Arc::new(Queues::new(options.record.is_some()));
    end_on_signal(&queues)?;
    let awake = rt::keep_processors_awake();
    let may_sleep = if awake.is_some() { 0 } else { degraded::MAY_SLEEP };
    let (report, ready) = mpsc::channel();
    let (go, start) = mpsc::channel();
    let thread = spawn_loop(
        options,
        &policy,
        may_sleep,
        session.config(),
        &queues,
        report,
        start,
    )?;
    let header = ready
        .recv()
        .map_err(|_| anyhow!("the loop's thread did not start"))?
        .context("the loop cannot start")?;
    let node = services::node(session.config())?;
    let mut bridge = Bridge::new(&node, voice.clone())?;
    // Last of what can fail, so that a start that fails leaves no file in the way of the next.
    let recording = options.record.as_ref();
    let recorder = recording.map(|path| start_recorder(path, &header, &policy, &queues, &voice));
    let recorder = recorder.transpose()?;
    go.send(())
        .map_err(|_| anyhow!("the loop's thread ended early"))?;
    session.announce()?;
    voice.say(Event::Ready {
        instance: options.instance.clone(),
        cycles_per_target: header.cycles_per_target,
        cycle_ns: header.cycle_ns,
        targets_hz: options.rate.targets_hz(),
        machine: rt::describe(header.degraded),
    });
    for (rope, entry) in policy.blob.ropes.iter().enumerate() {
        voice.say(Event::Rope {
            rope,
            name: entry.name.as_str().to_owned(),
            reach_m: [entry.reach_m.low, entry.reach_m.high],
        });
    }
    let newest = carry(&mut bridge, &queues, &thread, &voice);
    let recorded = recorder.map_or(Ok(()), Recorder::finish);
    let timing = thread.join().map_err(|_| anyhow!("the loop's thread panicked"))?;
    voice.say(Event::Summary(Box::new(Summary::new(&timing, &newest))));
    recorded.map_err(|error| anyhow!("the recording is cut off: {error}; make room and record again"))
}

/// The work of the second thread until the loop has ended; returns the last status.
fn carry(bridge: &mut Bridge, queues: &Queues, thread: &JoinHandle<Timing>, voice: &Voice) -> Status {
    let mut newest = Status::default();
    let mut on_status = |status: &Status| {
        voice::news(status, &newest)
            .into_iter()
            .for_each(|event| voice.say(event));
        newest = *status;
    };
    rt::prefer_bridge();
    while !queues.ended.load(Ordering::Acquire) && !thread.is_finished() {
        bridge.round(queues, &mut on_status);
        bridge.rest(queues);
    }
    bridge.round(queues, &mut on_status);
    newest
}

/// Creates the loop's ports in its own thread (they cannot move), prepares the thread and waits for `go`.
fn spawn_loop(
    options: &Options,
    policy: &PolicyFile,
    degraded: u32,
    config: &Config,
    queues: &Arc<Queues>,
    report: Sender<Result<Header>>,
    go: Receiver<()>,
) -> Result<JoinHandle<Timing>> {
    let dry = if options.dry_run { degraded::DRY_RUN } else { 0 };
    let mut setup = setup(options, &policy.blob, degraded | dry);
    let (dry_run, policy_bytes) = (options.dry_run, policy.bytes.len());
    let (config, queues) = (config.clone(), Arc::clone(queues));
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
        setup.degraded |= rt::prepare_thread();
        let _ = report.send(Ok(recorder::header(&setup, policy_bytes)));
        let cycle_ns = setup.cycle_ns;
        let mut cycle = Cycle::new(Controller::new(setup), &queues, dry_run);
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

/// SIGINT, SIGTERM and SIGHUP (the terminal is closed) slow the arm down and end the program; kill -9 needs no help (see `session`).
fn end_on_signal(queues: &Arc<Queues>) -> Result<()> {
    let queues = Arc::clone(queues);
    ctrlc::set_handler(move || queues.shutdown.store(true, Ordering::Relaxed))
        .context("cannot watch for signals")
}

fn start_recorder(
    path: &Path,
    header: &Header,
    policy: &PolicyFile,
    queues: &Arc<Queues>,
    voice: &Voice,
) -> Result<Recorder> {
    Recorder::start(path, header, &policy.bytes, queues, voice.clone()).map_err(|error| {
        anyhow!(
            "cannot write the recording {}: {error}; give --record a new file in a folder that you may write to",
            path.display()
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_rate_puts_at_most_250_targets_on_cycles() {
        for (text, cycle_ns, cycles, targets_hz) in [
            ("100", 10_000_000, 1, 100.0),
            ("250", 4_000_000, 1, 250.0),
            ("300", 3_333_333, 2, 150.0),
            ("500", 2_000_000, 2, 250.0),
            ("750", 1_333_333, 3, 250.0),
            ("1000", 1_000_000, 4, 250.0),
        ] {
            let rate: Rate = text.parse().unwrap();
            assert_eq!((rate.cycle_ns(), rate.cycles_per_target()), (cycle_ns, cycles));
            assert_eq!(rate.targets_hz(), targets_hz);
        }
        for hz in LOOP_RATE_MIN_HZ..=LOOP_RATE_MAX_HZ {
            let rate: Rate = hz.to_string().parse().unwrap();
            assert!(rate.targets_hz() <= f64::from(TARGET_RATE_MAX_HZ), "{hz}");
        }
        for text in ["0", "99", "1001", "-1", "250.5", "fast"] {
            assert!(text.parse::<Rate>().is_err(), "{text}");
        }
    }
}
