//! How punctual the loop is: how late it wakes and begins, how long a turn takes, how far apart turns lie, how
//! long a goal waits for its first target; and what the loop cost besides time.

use hdrhistogram::Histogram;
use std::fmt;
use std::io::{self, Write};

/// Largest time that is told apart from longer ones, ns.
const LONGEST_NS: u64 = 1_000_000_000;

/// When a turn passed its stations, ns.
#[derive(Clone, Copy, Debug)]
pub struct Stations {
    /// What the loop asked to be woken for.
    pub asked_ns: u64,
    /// When it was awake.
    pub woke_ns: u64,
    /// When the turn was due.
    pub due_ns: u64,
    /// When it began.
    pub began_ns: u64,
    /// When its target was out and everything else noted.
    pub done_ns: u64,
}

/// Histograms of fixed size; recording does not allocate.
pub struct Timing {
    wake_ns: Histogram<u64>,
    plan_ns: Histogram<u64>,
    start_ns: Histogram<u64>,
    turn_ns: Histogram<u64>,
    period_ns: Histogram<u64>,
    jitter_ns: Histogram<u64>,
    goal_ns: Histogram<u64>,
    answer_ns: Histogram<u64>,
    goals_beyond_period: u64,
    last: Option<Stations>,
    cost: Cost,
}

/// What the loop's thread asked for besides time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Cost {
    /// Calls to the allocator; `None` where they were not counted.
    pub allocator_calls: Option<u64>,
    /// Pages that were not there when they were needed.
    pub page_faults: u64,
}

impl Cost {
    /// Both together.
    pub fn plus(self, other: Self) -> Self {
        let calls = self.allocator_calls.zip(other.allocator_calls);
        Self {
            allocator_calls: calls.map(|(a, b)| a + b),
            page_faults: self.page_faults + other.page_faults,
        }
    }
}

impl fmt::Display for Cost {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.allocator_calls {
            Some(calls) => write!(f, "{calls} calls to the allocator, ")?,
            None => write!(f, "calls to the allocator not counted, ")?,
        }
        write!(f, "{} page faults in the loop", self.page_faults)
    }
}

/// Percentiles of one quantity, ns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Percentiles {
    /// Median.
    pub p50_ns: u64,
    /// 99 of 100 are shorter.
    pub p99_ns: u64,
    /// 999 of 1000 are shorter.
    pub p999_ns: u64,
    /// The longest.
    pub max_ns: u64,
    /// How many there were.
    pub count: u64,
}

impl From<&Histogram<u64>> for Percentiles {
    fn from(times: &Histogram<u64>) -> Self {
        Self {
            p50_ns: times.value_at_quantile(0.5),
            p99_ns: times.value_at_quantile(0.99),
            p999_ns: times.value_at_quantile(0.999),
            max_ns: times.max(),
            count: times.len(),
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

/// Writes a histogram as HdrHistogram's percentile table (.hgrm), which its plotter reads; values in µs.
pub fn write_hgrm(out: &mut impl Write, times: &Histogram<u64>) -> io::Result<()> {
    const TICKS_PER_HALF: u32 = 5;
    writeln!(
        out,
        "{:>12} {:>14} {:>10} {:>14}\n",
        "Value", "Percentile", "TotalCount", "1/(1-Percentile)"
    )?;
    let us = |ns: f64| ns * 1e-3;
    for point in times.iter_quantiles(TICKS_PER_HALF) {
        let (value, share) = (us(point.value_iterated_to() as f64), point.quantile_iterated_to());
        write!(
            out,
            "{value:12.3} {share:2.12} {:10}",
            times.count_between(0, point.value_iterated_to())
        )?;
        if share < 1.0 {
            writeln!(out, " {:14.2}", 1.0 / (1.0 - share))?;
        } else {
            writeln!(out)?;
        }
    }
    writeln!(
        out,
        "#[Mean    = {:12.3}, StdDeviation   = {:12.3}]",
        us(times.mean()),
        us(times.stdev())
    )?;
    writeln!(
        out,
        "#[Max     = {:12.3}, Total count    = {:12}]",
        us(times.max() as f64),
        times.len()
    )
}

impl Default for Timing {
    fn default() -> Self {
        Self {
            wake_ns: histogram(),
            plan_ns: histogram(),
            start_ns: histogram(),
            turn_ns: histogram(),
            period_ns: histogram(),
            jitter_ns: histogram(),
            goal_ns: histogram(),
            answer_ns: histogram(),
            goals_beyond_period: 0,
            last: None,
            cost: Cost::default(),
        }
    }
}

impl Timing {
    /// Notes a turn.
    pub fn note(&mut self, turn: Stations) {
        let record = |times: &mut Histogram<u64>, from_ns: u64, to_ns: u64| {
            times.saturating_record(to_ns.saturating_sub(from_ns));
        };
        record(&mut self.wake_ns, turn.asked_ns, turn.woke_ns);
        record(&mut self.start_ns, turn.due_ns, turn.began_ns);
        record(&mut self.turn_ns, turn.began_ns, turn.done_ns);
        if let Some(last) = self.last.replace(turn) {
            let period_ns = turn.began_ns.saturating_sub(last.began_ns);
            let nominal_ns = turn.due_ns.saturating_sub(last.due_ns);
            self.period_ns.saturating_record(period_ns);
            self.jitter_ns.saturating_record(period_ns.abs_diff(nominal_ns));
        }
    }

    /// Notes that the first plan that the loop made after it woke took from `from_ns` to `to_ns`.
    pub fn note_plan(&mut self, from_ns: u64, to_ns: u64) {
        self.plan_ns.saturating_record(to_ns.saturating_sub(from_ns));
    }

    /// Notes that the turn from `began_ns` to `done_ns` judged a goal.
    pub fn note_answer(&mut self, began_ns: u64, done_ns: u64) {
        self.answer_ns.saturating_record(done_ns.saturating_sub(began_ns));
    }

    /// Notes that the first target of a goal stamped `sent_ns` was out at `done_ns`; targets are `period_ns`
    /// apart.
    pub fn note_goal(&mut self, sent_ns: u64, done_ns: u64, period_ns: u64) {
        let took_ns = done_ns.saturating_sub(sent_ns);
        self.goal_ns.saturating_record(took_ns);
        self.goals_beyond_period += u64::from(took_ns > period_ns);
    }

    /// Notes what the loop cost.
    pub fn note_cost(&mut self, cost: Cost) {
        self.cost = cost;
    }

    /// What the loop cost.
    pub fn cost(&self) -> Cost {
        self.cost
    }

    /// Adds what another loop of the same period noted after this one.
    pub fn add(&mut self, other: &Self) {
        let pairs = [
            (&mut self.wake_ns, &other.wake_ns),
            (&mut self.plan_ns, &other.plan_ns),
            (&mut self.start_ns, &other.start_ns),
            (&mut self.turn_ns, &other.turn_ns),
            (&mut self.period_ns, &other.period_ns),
            (&mut self.jitter_ns, &other.jitter_ns),
            (&mut self.goal_ns, &other.goal_ns),
            (&mut self.answer_ns, &other.answer_ns),
        ];
        for (mine, theirs) in pairs {
            mine.add(theirs).expect("all have the same bounds");
        }
        self.goals_beyond_period += other.goals_beyond_period;
        self.cost = self.cost.plus(other.cost);
    }

    /// How long the first plan after a wake-up took, whose caches are cold.
    pub fn plan(&self) -> Percentiles {
        (&self.plan_ns).into()
    }

    /// How late turns began.
    pub fn start(&self) -> Percentiles {
        (&self.start_ns).into()
    }

    /// How late turns began, in full.
    pub fn start_histogram(&self) -> &Histogram<u64> {
        &self.start_ns
    }

    /// How late the loop woke after the instant it had asked for.
    pub fn wake(&self) -> Percentiles {
        (&self.wake_ns).into()
    }

    /// How late the loop woke, in full.
    pub fn wake_histogram(&self) -> &Histogram<u64> {
        &self.wake_ns
    }

    /// How long a turn took.
    pub fn turn(&self) -> Percentiles {
        (&self.turn_ns).into()
    }

    /// How long a turn took, in full.
    pub fn turn_histogram(&self) -> &Histogram<u64> {
        &self.turn_ns
    }

    /// Time from one turn to the next.
    pub fn period(&self) -> Percentiles {
        (&self.period_ns).into()
    }

    /// How far the time from one turn to the next was from the distance of their deadlines.
    pub fn jitter(&self) -> Percentiles {
        (&self.jitter_ns).into()
    }

    /// The same in full.
    pub fn jitter_histogram(&self) -> &Histogram<u64> {
        &self.jitter_ns
    }

    /// How long those turns took that judged a goal.
    pub fn answer(&self) -> Percentiles {
        (&self.answer_ns).into()
    }

    /// Time from a goal's stamp to its first target.
    pub fn goal(&self) -> Percentiles {
        (&self.goal_ns).into()
    }

    /// Goals whose first target came later than one period of the targets.
    pub fn goals_beyond_period(&self) -> u64 {
        self.goals_beyond_period
    }

    /// Time from a goal's stamp to its first target, in full.
    pub fn goal_histogram(&self) -> &Histogram<u64> {
        &self.goal_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_are_told_apart() {
        let mut timing = Timing::default();
        for (due_ns, woke_ns, began_ns, done_ns) in [(1000, 910, 1001, 1021), (2000, 1905, 2000, 2020)] {
            timing.note(Stations {
                asked_ns: due_ns - 100,
                woke_ns,
                due_ns,
                began_ns,
                done_ns,
            });
        }
        timing.note_goal(500, 900, 400);
        assert_eq!(timing.goals_beyond_period(), 0);
        timing.note_goal(500, 901, 400);
        assert_eq!(timing.wake().max_ns, 10);
        assert_eq!(timing.turn().p50_ns, 20);
        assert_eq!(timing.start().max_ns, 1);
        assert_eq!(timing.period().max_ns, 999);
        assert_eq!(timing.jitter().max_ns, 1);
        assert_eq!((timing.goal().p50_ns, timing.goals_beyond_period()), (400, 1));
        let mut both = Timing::default();
        both.add(&timing);
        both.add(&timing);
        assert_eq!((both.wake().count, both.wake().max_ns), (4, 10));
    }

    #[test]
    fn a_percentile_table_rises_to_the_whole_count() {
        let mut times = histogram();
        for k in 1..=1000 {
            times.record(k * 1000).expect("within the bounds");
        }
        let mut text = Vec::new();
        write_hgrm(&mut text, &times).expect("a vector takes it");
        let text = String::from_utf8(text).expect("digits");
        let rows: Vec<Vec<f64>> = text
            .lines()
            .skip(2)
            .filter(|line| !line.starts_with('#'))
            .map(|line| {
                line.split_whitespace()
                    .map(|word| word.parse().expect("a number"))
                    .collect()
            })
            .collect();
        assert!(
            rows.windows(2)
                .all(|pair| pair[0][0] <= pair[1][0] && pair[0][1] <= pair[1][1])
        );
        let last = rows.last().expect("rows");
        assert_eq!((last[1], last[2]), (1.0, 1000.0));
        let median = rows.iter().find(|row| row[1] >= 0.5).expect("a median");
        assert!((median[0] - 500.0).abs() < 1.0, "{median:?}");
    }
}
