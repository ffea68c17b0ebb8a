//! The clock of the controller and its clients, CLOCK_MONOTONIC, and the grid of deadlines on it.

use std::mem::MaybeUninit;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

const NS_PER_S: u64 = 1_000_000_000;

/// CLOCK_MONOTONIC, ns.
pub fn now_ns() -> u64 {
    let mut time = MaybeUninit::<libc::timespec>::uninit();
    // SAFETY: the clock exists on every Linux and the structure is the kernel's to fill.
    let time = unsafe {
        libc::clock_gettime(libc::CLOCK_MONOTONIC, time.as_mut_ptr());
        time.assume_init()
    };
    time.tv_sec as u64 * NS_PER_S + time.tv_nsec as u64
}

/// Sleeps until CLOCK_MONOTONIC reads `deadline_ns`; an absolute time does not drift and a signal does
/// not shorten it.
pub fn sleep_until(deadline_ns: u64) {
    let time = libc::timespec {
        tv_sec: (deadline_ns / NS_PER_S) as libc::time_t,
        tv_nsec: (deadline_ns % NS_PER_S) as _,
    };
    // SAFETY: the structure outlives the call and no remainder is asked for.
    while unsafe {
        libc::clock_nanosleep(
            libc::CLOCK_MONOTONIC,
            libc::TIMER_ABSTIME,
            &time,
            std::ptr::null_mut(),
        )
    } == libc::EINTR
    {}
}

/// Whether `thread` ends within `patience`; waits for it that long.
pub fn ends_within<T>(thread: &JoinHandle<T>, patience: Duration) -> bool {
    let start = Instant::now();
    while !thread.is_finished() && start.elapsed() < patience {
        std::thread::sleep(Duration::from_millis(1));
    }
    thread.is_finished()
}

/// Deadlines at a fixed period. A late cycle is run once and the missed ones are counted, not caught up.
#[derive(Clone, Copy, Debug)]
pub struct Grid {
    period_ns: u64,
    next_ns: u64,
    missed: u64,
}

impl Grid {
    /// A grid whose first deadline is one period after `now_ns`.
    pub fn new(now_ns: u64, period_ns: u64) -> Self {
        Self {
            period_ns,
            next_ns: now_ns + period_ns,
            missed: 0,
        }
    }

    /// When to wake next, ns.
    pub fn next_ns(&self) -> u64 {
        self.next_ns
    }

    /// Cycles missed so far.
    pub fn missed(&self) -> u64 {
        self.missed
    }

    /// The deadline that a loop awake at `now_ns` serves: the newest that has passed.
    pub fn serve(&mut self, now_ns: u64) -> u64 {
        let late = now_ns.saturating_sub(self.next_ns) / self.period_ns;
        self.missed += late;
        let served_ns = self.next_ns + late * self.period_ns;
        self.next_ns = served_ns + self.period_ns;
        served_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn in_time_nothing_is_missed() {
        let mut grid = Grid::new(1000, 100);
        assert_eq!(grid.serve(1100), 1100);
        assert_eq!(grid.serve(1299), 1200);
        assert_eq!((grid.missed(), grid.next_ns()), (0, 1300));
    }

    #[test]
    fn a_stall_is_counted_and_the_grid_kept() {
        let mut grid = Grid::new(1000, 100);
        assert_eq!(grid.serve(1100), 1100);
        assert_eq!(grid.serve(1555), 1500);
        assert_eq!((grid.missed(), grid.next_ns()), (3, 1600));
        assert_eq!(grid.serve(1601), 1600);
        assert_eq!(grid.missed(), 3);
    }

    #[test]
    fn sleeping_until_the_past_returns_at_once() {
        let now = now_ns();
        sleep_until(now.saturating_sub(NS_PER_S));
        sleep_until(now + 1_000_000);
        assert!(now_ns() >= now + 1_000_000);
    }
}
