//! Removes shared memory that a killed process began and never gave a size. iceoryx2 0.10 waits without end
//! for the size of what it opens, so that one such file would hang every program that connects later.

use crate::session::Instance;
use std::collections::BTreeMap;
use std::os::unix::fs::MetadataExt;
use std::path::PathBuf;
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Time between two looks.
const PERIOD: Duration = Duration::from_millis(50);

/// A live process gives its file a size within microseconds; one that is held up for this long is taken for
/// dead.
const EMPTY_MAX: Duration = Duration::from_millis(500);

/// Sweeps the shared memory of an instance from a thread of its own until it is dropped.
pub struct Sweeper {
    end: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Sweeper {
    /// Starts to sweep.
    pub fn start(instance: &Instance) -> std::io::Result<Self> {
        let instance = instance.clone();
        let (end, ended) = mpsc::channel();
        let body = move || {
            let mut empty = BTreeMap::new();
            while ended.recv_timeout(PERIOD) == Err(RecvTimeoutError::Timeout) {
                sweep(&instance, &mut empty, EMPTY_MAX);
            }
        };
        let thread = std::thread::Builder::new()
            .name("sweeper".to_string())
            .spawn(body)?;
        Ok(Self {
            end: Some(end),
            thread: Some(thread),
        })
    }
}

impl Drop for Sweeper {
    fn drop(&mut self) {
        drop(self.end.take());
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Removes what has been empty since before `empty_max`; `empty` remembers since when each file, told apart
/// by name and inode, has been seen so.
fn sweep(instance: &Instance, empty: &mut BTreeMap<(PathBuf, u64), Instant>, empty_max: Duration) {
    let now: Vec<(PathBuf, u64)> = instance
        .shared_memory()
        .filter_map(|path| {
            let metadata = path.metadata().ok()?;
            (metadata.len() == 0).then(|| (path, metadata.ino()))
        })
        .collect();
    empty.retain(|file, _| now.contains(file));
    for file in now {
        let path = file.0.clone();
        if empty.entry(file).or_insert_with(Instant::now).elapsed() >= empty_max {
            let _ = std::fs::remove_file(path);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::SHARED_MEMORY;
    use std::fs;

    #[test]
    fn only_what_stays_empty_is_removed() {
        let instance = Instance::new(&format!("sweep-{}", std::process::id())).unwrap();
        let file = |name: &str| PathBuf::from(format!("{SHARED_MEMORY}/{}{name}", instance.prefix()));
        fs::write(file("half-made"), "").unwrap();
        fs::write(file("being-made"), "").unwrap();
        fs::write(file("whole"), "something").unwrap();
        let (mut empty, day) = (BTreeMap::new(), Duration::from_secs(86_400));
        sweep(&instance, &mut empty, day);
        assert_eq!((empty.len(), instance.shared_memory().count()), (2, 3));
        fs::write(file("being-made"), "something").unwrap();
        sweep(&instance, &mut empty, Duration::ZERO);
        assert!(!file("half-made").exists());
        assert!(file("being-made").exists() && file("whole").exists());
        sweep(&instance, &mut empty, day);
        assert!(empty.is_empty(), "what is gone is forgotten");
        instance
            .shared_memory()
            .for_each(|path| fs::remove_file(path).unwrap());
    }
}
