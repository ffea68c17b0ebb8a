//! `controller bench`: how punctual the loop is on this machine, beside cyclictest pinned the same way
//! and at the same time, and what the parts of an answer cost.

mod cyclictest;
mod live;
mod parts;

pub use parts::Parts;

use crate::rt;
use crate::serve::Rate;
use crate::timing::{Cost, Percentiles, Timing, write_hgrm};
use anyhow::{Context, Result, anyhow};
use hdrhistogram::Histogram;
use shared::blob::Blob;
use std::fs::File;
use std::hint::black_box;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Longest stretch of one measurement before the other gets its turn: what else the machine does then
/// meets both alike.
const SLICE: Duration = Duration::from_secs(2);

/// So many slices of loop and cyclictest go by before whoever waits hears again.
const TOLD_EVERY: u32 = 5;

/// What to measure.
pub struct Settings<'a> {
    /// The policy.
    pub blob: &'a Blob,
    /// Cycles per second.
    pub rate: Rate,
    /// How long the loop runs under each load, and cyclictest again.
    pub duration: Duration,
    /// Folder for the histograms.
    pub histograms: Option<&'a Path>,
    /// Hears what is measured and how long it will take.
    pub progress: &'a (dyn Fn(&str) + Sync),
}

/// What was measured.
#[derive(Debug, serde::Serialize)]
pub struct Report {
    /// What the operating system refused, in words.
    pub degraded: String,
    /// Nominal period, ns.
    pub period_ns: u64,
    /// The processor that the loop is bound to.
    pub processor: Option<usize>,
    /// The loop with nothing else to do on the machine.
    pub idle: LoopReport,
    /// The loop while every other processor is busy; none where there is no other.
    pub saturated: Option<LoopReport>,
    /// Why there is no comparison with cyclictest, if there is none.
    pub cyclictest_missing: Option<String>,
    /// Costs of the parts of an answer.
    pub parts: Parts,
}

/// The loop under one load.
#[derive(Debug, serde::Serialize)]
pub struct LoopReport {
    /// Cycles missed.
    pub missed: u64,
    /// How late the loop woke after the instant that it asked for, a little before a turn is due.
    pub wake: Percentiles,
    /// How late cyclictest woke.
    pub cyclictest: Option<Percentiles>,
    /// The loop's 99th percentile over cyclictest's.
    pub wake_p99_ratio: Option<f64>,
    /// How long the first plan after a wake-up took, cold and before the turn: without it a goal's turn would
    /// take that much longer.
    pub plan_ahead: Percentiles,
    /// How late turns began.
    pub start: Percentiles,
    /// Deviation of the time between two turns from the nominal period.
    pub jitter: Percentiles,
    /// How long a turn took, planning of goals included.
    pub turn: Percentiles,
    /// Those turns that judged a goal. Here they come ten times a second, in earnest every ten seconds.
    pub answer: Percentiles,
    /// From a client's goal to its first target, through iceoryx2 and the bridge.
    pub goal_to_first_target: Percentiles,
    /// Goals among them that waited longer than one period of the targets.
    pub goals_beyond_period: u64,
    /// What the loop asked for besides time.
    pub cost: Cost,
}

/// What the loop and cyclictest noted under one load.
struct Noted {
    timing: Timing,
    missed: u64,
    cyclictest: Option<Histogram<u64>>,
}

/// Runs the loop with a bridge, a perfect arm and a client under both loads, then times the parts.
pub fn run(settings: &Settings) -> Result<Report> {
    // Before the measurement, which takes its time, and not after it.
    if let Some(folder) = settings.histograms {
        writable(folder).map_err(|error| {
            let name = folder.display();
            anyhow!("cannot write into {name}: {error}; give --histograms a folder that you may write to")
        })?;
    }
    let _awake = rt::keep_processors_awake();
    let processors = rt::processors();
    let mut missing = None;
    let idle = measure("idle", settings, &mut missing)?;
    let (_, others) = processors.split_last().unwrap_or((&0, &[]));
    let saturated = match others {
        [] => None,
        others => Some(saturated(others, || {
            measure("saturated", settings, &mut missing)
        })?),
    };
    if let Some(folder) = settings.histograms {
        write_histograms(folder, "idle", &idle)?;
        if let Some(saturated) = &saturated {
            write_histograms(folder, "saturated", saturated)?;
        }
    }
    (settings.progress)("timing the parts");
    Ok(Report {
        degraded: rt::describe(live::refused()),
        period_ns: settings.rate.cycle_ns(),
        processor: processors.last().copied(),
        idle: idle.report(),
        saturated: saturated.map(|noted| noted.report()),
        cyclictest_missing: missing,
        parts: parts::time_all(settings.blob),
    })
}

/// Runs `part` while every processor of `others` is busy with ordinary work.
fn saturated<T>(others: &[usize], part: impl FnOnce() -> T) -> T {
    let done = AtomicBool::new(false);
    std::thread::scope(|scope| {
        for &cpu in others {
            let done = &done;
            scope.spawn(move || {
                rt::bind_to(&[cpu]);
                let mut value = 1.0f64;
                while !done.load(Ordering::Relaxed) {
                    for _ in 0..1000 {
                        value = black_box(value * 1.000_000_1).sqrt();
                    }
                }
            });
        }
        let value = part();
        done.store(true, Ordering::Relaxed);
        value
    })
}

/// Makes sure that files can be written into a folder.
fn writable(folder: &Path) -> io::Result<()> {
    std::fs::create_dir_all(folder)?;
    let probe = folder.join(".writable");
    File::create(&probe)?;
    std::fs::remove_file(probe)
}

/// Loop and cyclictest in turns under a load; `missing` becomes the reason why there was no cyclictest.
fn measure(load: &str, settings: &Settings, missing: &mut Option<String>) -> Result<Noted> {
    let slices = settings.duration.as_nanos().div_ceil(SLICE.as_nanos()).max(1) as u32;
    let slice = settings.duration / slices;
    let mut noted: Option<Noted> = None;
    for begun in 0..slices {
        if begun % TOLD_EVERY == 0 {
            let left_s = (2 * (slices - begun) * slice).as_secs_f64();
            (settings.progress)(&format!(
                "{load}: loop and cyclictest in turns, {left_s:.0} s left"
            ));
        }
        // In a thread of its own: the bridge keeps the priority and the processors that it asks for.
        let live = || live::run(settings.blob, settings.rate, slice);
        let live = std::thread::scope(|scope| scope.spawn(live).join());
        let (timing, missed) = live.expect("the bridge does not panic")?;
        let other = cyclictest::run(settings.rate.cycle_ns(), slice);
        let cyclictest = other.map_err(|reason| *missing = Some(reason)).ok();
        match &mut noted {
            None => {
                noted = Some(Noted {
                    timing,
                    missed,
                    cyclictest,
                });
            }
            Some(noted) => {
                noted.timing.add(&timing);
                noted.missed += missed;
                if let (Some(all), Some(more)) = (&mut noted.cyclictest, &cyclictest) {
                    all.add(more).expect("all have the same bounds");
                }
            }
        }
    }
    noted.context("there was no time to measure")
}

impl Noted {
    fn report(&self) -> LoopReport {
        let wake = self.timing.wake();
        let cyclictest = self.cyclictest.as_ref().map(Percentiles::from);
        LoopReport {
            missed: self.missed,
            wake,
            cyclictest,
            wake_p99_ratio: cyclictest.map(|other| wake.p99_ns as f64 / other.p99_ns as f64),
            plan_ahead: self.timing.plan(),
            start: self.timing.start(),
            jitter: self.timing.jitter(),
            turn: self.timing.turn(),
            answer: self.timing.answer(),
            goal_to_first_target: self.timing.goal(),
            goals_beyond_period: self.timing.goals_beyond_period(),
            cost: self.timing.cost(),
        }
    }
}

fn write_histograms(folder: &Path, load: &str, noted: &Noted) -> Result<()> {
    let timing = &noted.timing;
    let mut tables = vec![
        ("wake", timing.wake_histogram()),
        ("start", timing.start_histogram()),
        ("jitter", timing.jitter_histogram()),
        ("turn", timing.turn_histogram()),
        ("goal-to-first-target", timing.goal_histogram()),
    ];
    tables.extend(noted.cyclictest.as_ref().map(|times| ("cyclictest", times)));
    for (name, times) in tables {
        let path: PathBuf = folder.join(format!("{load}-{name}.hgrm"));
        let write = || {
            let mut file = BufWriter::new(File::create(&path)?);
            write_hgrm(&mut file, times)?;
            file.flush()
        };
        write().with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(())
}
