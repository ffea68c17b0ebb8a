//! Rollouts of the swing task: a random design, made in parallel, kept in shards that survive a kill.
//!
//! Every rollout depends on its own sample alone, so the dataset is the same for any number of threads
//! and for any number of interruptions. Refusals are rows like any other and are counted by reason.

mod design;
mod rows;
mod shards;
#[cfg(test)]
pub(crate) mod stand_in;
mod swinger;

pub use design::{Design, DesignError, REACH_SHARE, Sample, standard_normal, stream};
pub use rows::{Dataset, DatasetSummary, Row, count_refusals};
pub use shards::{SHARD_ROWS, Shards};
pub use swinger::{SwingRefusal, Swinger};

use crate::run_files::RunFolder;
use crate::tell::Progress;
use rayon::prelude::*;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// The user asked to stop; what is complete is on disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("stopped on request: run the same command again to go on from what is complete")]
pub struct Stopped;

/// Who watches the work and may stop it.
#[derive(Clone, Copy)]
pub struct Watch<'a> {
    /// Called after every rollout or step, from any thread.
    pub progress: &'a (dyn Fn(Progress) + Sync),
    /// Set to stop soon.
    pub stop: &'a AtomicBool,
}

/// Swings all `samples` and keeps the rows under `folder`. Shards already there are read, not made again;
/// `model` is the content hash of what swings, so that rollouts of two models never mix.
pub fn collect(
    samples: &[Sample],
    swinger: &dyn Swinger,
    folder: &Path,
    model: u64,
    watch: Watch,
) -> anyhow::Result<Dataset> {
    let shards = Shards::open(folder, samples, model)?;
    let counter = Counter::new(samples.len(), watch);
    let pieces: Vec<anyhow::Result<Vec<Row>>> = samples
        .par_chunks(SHARD_ROWS)
        .enumerate()
        .map(|(number, piece)| match shards.read(number, piece)? {
            Some(rows) => {
                counter.add(&rows);
                Ok(rows)
            }
            None => {
                let rows = swing_all(piece, swinger, &counter)?;
                shards.write(number, &rows)?;
                Ok(rows)
            }
        })
        .collect();
    let mut rows = Vec::with_capacity(samples.len());
    for piece in pieces {
        rows.extend(piece?);
    }
    Ok(Dataset { rows })
}

/// Swings the random design of a run, as [`collect`] does.
///
/// # Errors
/// The design is none, or what [`collect`] says.
pub fn collect_design(
    design: &Design,
    swinger: &dyn Swinger,
    run: &RunFolder,
    model: u64,
    watch: Watch,
) -> anyhow::Result<Dataset> {
    design.check()?;
    collect(&design.samples(), swinger, &run.rollouts(0), model, watch)
}

fn swing_all(samples: &[Sample], swinger: &dyn Swinger, counter: &Counter) -> Result<Vec<Row>, Stopped> {
    samples
        .par_iter()
        .map(|sample| {
            if counter.watch.stop.load(Ordering::Relaxed) {
                return Err(Stopped);
            }
            let row = Row {
                sample: *sample,
                reach_m: swing(sample, swinger),
            };
            counter.add(std::slice::from_ref(&row));
            Ok(row)
        })
        .collect()
}

/// One swing. A score that is no number is a failure, whatever the swinger thinks of it.
fn swing(sample: &Sample, swinger: &dyn Swinger) -> Result<f64, SwingRefusal> {
    let reach = swinger.reach_m(sample.young_pa, sample.poisson, sample.release_m)?;
    if reach.is_finite() {
        Ok(reach)
    } else {
        Err(SwingRefusal::Failed(format!("the tip reached x = {reach}")))
    }
}

struct Counter<'a> {
    done: AtomicUsize,
    refused: AtomicUsize,
    total: usize,
    watch: Watch<'a>,
}

impl<'a> Counter<'a> {
    fn new(total: usize, watch: Watch<'a>) -> Self {
        Self {
            done: AtomicUsize::new(0),
            refused: AtomicUsize::new(0),
            total,
            watch,
        }
    }

    fn add(&self, rows: &[Row]) {
        let refused = rows.iter().filter(|row| row.reach_m.is_err()).count();
        (self.watch.progress)(Progress {
            stage: "rollouts",
            done: self.done.fetch_add(rows.len(), Ordering::Relaxed) + rows.len(),
            total: self.total,
            refused: self.refused.fetch_add(refused, Ordering::Relaxed) + refused,
        });
    }
}

#[cfg(test)]
mod tests {
    use super::stand_in::{DoublePendulum, design, unwatched};
    use super::*;
    use std::fs;
    use std::path::PathBuf;

    fn with_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.expect("threads can be made").install(work)
    }

    /// The folders of shards under one.
    fn plans(folder: &Path) -> Vec<PathBuf> {
        let entries = fs::read_dir(folder).unwrap();
        entries.map(|entry| entry.unwrap().path()).collect()
    }

    /// The shards of the only plan under a folder.
    fn only_plan(folder: &Path) -> PathBuf {
        let [plan] = &plans(folder)[..] else {
            panic!("one plan in {}", folder.display());
        };
        plan.clone()
    }

    fn bytes(folder: &Path) -> Vec<(String, Vec<u8>)> {
        let mut files: Vec<_> = fs::read_dir(only_plan(folder))
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .map(|path| (path.display().to_string(), fs::read(&path).unwrap()))
            .collect();
        files.sort();
        files
    }

    #[test]
    fn any_number_of_threads_and_any_interruption_give_the_same_bytes() {
        let samples = design(100).samples();
        let folder = tempfile::tempdir().unwrap();
        let one = with_threads(1, || {
            collect(&samples, &DoublePendulum, folder.path(), 7, unwatched())
        })
        .unwrap();
        let before = bytes(folder.path());
        assert_eq!(before.len(), 5);
        for shard in [0, 3] {
            fs::remove_file(only_plan(folder.path()).join(format!("shard_{shard:05}.bin"))).unwrap();
        }
        let resumed = with_threads(2, || {
            collect(&samples, &DoublePendulum, folder.path(), 7, unwatched())
        })
        .unwrap();
        assert_eq!(resumed, one);
        assert_eq!(bytes(folder.path()), before);
        let other = tempfile::tempdir().unwrap();
        let two = with_threads(2, || {
            collect(&samples, &DoublePendulum, other.path(), 7, unwatched())
        })
        .unwrap();
        assert_eq!(two.hash(), one.hash());
    }

    /// What a second seed, preset or version of the program makes in a run's folder leaves the first one's rollouts there.
    #[test]
    fn another_plan_and_another_model_have_folders_of_their_own() {
        let samples = design(40).samples();
        let folder = tempfile::tempdir().unwrap();
        let collected = |samples: &[Sample], swinger: &dyn Swinger, model| {
            collect(samples, swinger, folder.path(), model, unwatched()).unwrap()
        };
        let first = collected(&samples, &DoublePendulum, 7);
        let fewer = collected(&samples[..39], &DoublePendulum, 7);
        assert_eq!(fewer.rows[..], first.rows[..39]);
        let fussy = collected(&samples, &Fussy, 8);
        assert_ne!(fussy, first);
        assert_eq!(plans(folder.path()).len(), 3);
        // Found on disk, whoever would swing them now.
        assert_eq!(collected(&samples, &Fussy, 7), first);
        assert_eq!(collected(&samples, &DoublePendulum, 8), fussy);
    }

    #[test]
    fn damage_is_refused() {
        let samples = design(40).samples();
        let folder = tempfile::tempdir().unwrap();
        let collected = || collect(&samples, &DoublePendulum, folder.path(), 7, unwatched());
        collected().unwrap();
        let damage = |file: &str, at: usize| {
            let path = only_plan(folder.path()).join(file);
            let whole = fs::read(&path).unwrap();
            let mut content = whole.clone();
            content[at] ^= 1;
            fs::write(&path, content).unwrap();
            let refusal = format!("{:#}", collected().unwrap_err());
            fs::write(&path, whole).unwrap();
            refusal
        };
        assert!(damage("shard_00001.bin", 30).contains("shard_00001.bin is damaged"));
        assert!(damage("manifest.json", 0).contains("manifest.json is damaged"));
        collected().unwrap();
    }

    /// Refuses every fourth sample, in one of two ways.
    struct Fussy;

    impl Swinger for Fussy {
        fn reach_m(&self, young_pa: f64, poisson: f64, release_m: [f64; 2]) -> Result<f64, SwingRefusal> {
            match young_pa.to_bits() % 8 {
                0 => Err(SwingRefusal::Failed("step 3".into())),
                4 => Ok(f64::NAN),
                _ => DoublePendulum.reach_m(young_pa, poisson, release_m),
            }
        }
    }

    #[test]
    fn refusals_are_rows_and_are_counted() {
        let samples = design(80).samples();
        let folder = tempfile::tempdir().unwrap();
        let last = std::sync::Mutex::new(None::<Progress>);
        let progress = |now: Progress| {
            let mut last = last.lock().unwrap();
            if last.is_none_or(|before| before.done < now.done) {
                *last = Some(now);
            }
        };
        let watch = Watch {
            progress: &progress,
            ..unwatched()
        };
        let dataset = collect(&samples, &Fussy, folder.path(), 7, watch).unwrap();
        let summary = dataset.summary();
        let refused = summary.refusals["simulation failed"];
        assert!(refused > 5, "{summary:?}");
        assert_eq!(summary.scored + refused, 80);
        assert_eq!(last.lock().unwrap().unwrap().done, 80);
        let again = collect(&samples, &DoublePendulum, folder.path(), 7, unwatched()).unwrap();
        assert_eq!(again, dataset);
    }

    #[test]
    fn a_stop_keeps_what_is_complete() {
        let samples = design(100).samples();
        let folder = tempfile::tempdir().unwrap();
        let stop = AtomicBool::new(false);
        let progress = |now: Progress| stop.store(now.done >= 50, Ordering::Relaxed);
        let watch = Watch {
            progress: &progress,
            stop: &stop,
        };
        let error =
            with_threads(1, || collect(&samples, &DoublePendulum, folder.path(), 7, watch)).unwrap_err();
        assert!(error.is::<Stopped>(), "{error:#}");
        let kept = bytes(folder.path()).len();
        assert!((2..5).contains(&kept), "{kept} files");
        let resumed = collect(&samples, &DoublePendulum, folder.path(), 7, unwatched()).unwrap();
        assert_eq!(resumed.rows.len(), 100);
    }
}
