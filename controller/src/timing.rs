//! How punctual the loop is: how late it wakes, how long a turn takes, how far apart turns lie.

use hdrhistogram::Histogram;
use std::fmt;

/// Largest time that is told apart from longer ones, ns.
const LONGEST_NS: u64 = 1_000_000_000;

/// Three histograms of fixed size; recording does not allocate.
pub struct Timing {
    wake_ns: Histogram<u64>,
    turn_ns: Histogram<u64>,
    period_ns: Histogram<u64>,
    last_woke_ns: u64,
}

/// Percentiles of one quantity, ns.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct Percentiles {
    /// Median.
    pub p50_ns: u64,
    /// 99 of 100 are shorter.
    pub p99_ns: u64,
    /// 999 of 1000 are shorter.
    pub p999_ns: u64,
    /// The longest.
    pub max_ns: u64,
}

impl From<&Histogram<u64>> for Percentiles {
    fn from(times: &Histogram<u64>) -> Self {
        Self {
            p50_ns: times.value_at_quantile(0.5),
            p99_ns: times.value_at_quantile(0.99),
            p999_ns: times.value_at_quantile(0.999),
            max_ns: times.max(),
        }
    }
}

impl fmt::Display for Percentiles {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let us = |ns: u64| ns as f64 * 1e-3;
        write!(
            f,
            "p50 {:9.2}  p99 {:9.2}  p99.9 {:9.2}  max {:9.2} us",
            us(self.p50_ns),
            us(self.p99_ns),
            us(self.p999_ns),
            us(self.max_ns)
        )
    }
}

/// An empty histogram of times up to a second with three digits.
pub fn histogram() -> Histogram<u64> {
    Histogram::new_with_bounds(1, LONGEST_NS, 3).expect("the bounds are valid")
}

impl Default for Timing {
    fn default() -> Self {
        Self {
            wake_ns: histogram(),
            turn_ns: histogram(),
            period_ns: histogram(),
            last_woke_ns: 0,
        }
    }
}

impl Timing {
    /// Notes a turn for `deadline_ns` that began at `woke_ns` and ended at `done_ns`.
    pub fn note(&mut self, deadline_ns: u64, woke_ns: u64, done_ns: u64) {
        self.wake_ns
            .saturating_record(woke_ns.saturating_sub(deadline_ns));
        self.turn_ns.saturating_record(done_ns.saturating_sub(woke_ns));
        if self.last_woke_ns != 0 {
            self.period_ns
                .saturating_record(woke_ns.saturating_sub(self.last_woke_ns));
        }
        self.last_woke_ns = woke_ns;
    }

    /// How late the loop woke.
    pub fn wake(&self) -> Percentiles {
        (&self.wake_ns).into()
    }

    /// How long a turn took.
    pub fn turn(&self) -> Percentiles {
        (&self.turn_ns).into()
    }

    /// Time from one turn to the next.
    pub fn period(&self) -> Percentiles {
        (&self.period_ns).into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_are_told_apart() {
        let mut timing = Timing::default();
        timing.note(1000, 1010, 1030);
        timing.note(2000, 2005, 2025);
        assert_eq!(timing.wake().max_ns, 10);
        assert_eq!(timing.turn().p50_ns, 20);
        assert_eq!(timing.period().max_ns, 995);
    }
}
