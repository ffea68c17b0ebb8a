//! What a goal's client promised: a sign of life at least every so often, counted in cycles, so that a
//! stall of the whole machine does not count as silence of the client.

use shared::messages::Goal;

/// A promise and how long ago it was kept last.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Promise {
    cycles_max: u64,
    cycles_since: u64,
}

impl Promise {
    /// The promise that a goal makes, if it makes one.
    pub fn of(goal: &Goal, cycle_ns: u64) -> Option<Self> {
        (goal.keep_alive_ms > 0).then(|| Self {
            cycles_max: (u64::from(goal.keep_alive_ms) * 1_000_000).div_ceil(cycle_ns),
            cycles_since: 0,
        })
    }

    /// A sign of life.
    pub fn keep(&mut self) {
        self.cycles_since = 0;
    }

    /// Counts a cycle; whether the promise is broken.
    pub fn wait(&mut self) -> bool {
        self.cycles_since += 1;
        self.cycles_since > self.cycles_max
    }
}
