//! `controller bench`: how punctual the loop is on this machine and what its parts cost.

use crate::clock;
use crate::cycle::{Cycle, Queues};
use crate::motion;
use crate::rt;
use crate::serve::Rate;
use crate::step::{Controller, Setup};
use crate::timing::{Percentiles, Timing, histogram};
use shared::blob::Blob;
use shared::ik;
use shared::messages::{GOAL_MAGIC, Goal, degraded};
use std::hint::black_box;
use std::sync::atomic::Ordering;
use std::time::Duration;

/// What was measured.
#[derive(Debug, serde::Serialize)]
pub struct Report {
    /// What the operating system refused, in words.
    pub degraded: String,
    /// Nominal period, ns.
    pub period_ns: u64,
    /// Cycles missed.
    pub missed: u64,
    /// How late the loop woke.
    pub wake: Percentiles,
    /// Time from one turn to the next.
    pub between_turns: Percentiles,
    /// How long a turn took, goals being planned and served.
    pub turn: Percentiles,
    /// One pass of the policy.
    pub policy: Percentiles,
    /// Inverse kinematics from the middle posture.
    pub ik_from_middle: Percentiles,
    /// Inverse kinematics from a neighbour 1 mm away, as along a line.
    pub ik_along_line: Percentiles,
}

/// Runs the loop for `duration` without an arm, one goal after the other, then times the parts.
pub fn run(blob: &Blob, rate: Rate, duration: Duration) -> Report {
    let queues = Queues::new(false);
    let (timing, refused, missed) = std::thread::scope(|scope| {
        let thread = scope.spawn(|| run_loop(blob, rate, &queues));
        feed(blob, &queues, duration);
        thread.join().expect("the loop's thread does not panic")
    });
    let goals = blob.ropes[0].reach_m;
    let policy = time(|k| {
        let goal = goals.at(f64::from(k % 100) * 0.01);
        black_box(
            blob.policy
                .release_point_m(goal, blob.ropes[0].young_pa, blob.ropes[0].poisson),
        );
    });
    let poses: Vec<_> = (0..100)
        .map(|k| motion::task_pose(&blob.frame, [0.05 + 0.001 * f64::from(k), 0.15]))
        .collect();
    let ik_from_middle = time(|k| {
        let _ = black_box(ik::solve(&poses[k as usize % 100]));
    });
    let mut seed = ik::solve(&poses[0]).unwrap_or_default();
    let ik_along_line = time(|k| {
        // There and back again, so that the neighbour is always 1 mm away.
        let step = k as usize % 198;
        let index = if step < 100 { step } else { 198 - step };
        if let Ok(next) = black_box(ik::solve_near(&poses[index], &seed)) {
            seed = next;
        }
    });
    Report {
        degraded: rt::describe(refused),
        period_ns: rate.cycle_ns(),
        missed,
        wake: timing.wake(),
        between_turns: timing.period(),
        turn: timing.turn(),
        policy,
        ik_from_middle,
        ik_along_line,
    }
}

fn run_loop(blob: &Blob, rate: Rate, queues: &Queues) -> (Timing, u32, u64) {
    let mut timing = Timing::default();
    let refused = rt::prepare_thread();
    let setup = Setup {
        blob: Box::new(blob.clone()),
        cycle_ns: rate.cycle_ns(),
        cycles_per_target: rate.cycles_per_target(),
        silent_cycles_max: 100,
        degraded: refused | degraded::DRY_RUN,
    };
    let mut cycle = Cycle::new(Controller::new(setup), queues, true);
    cycle.run(rate.cycle_ns(), &mut timing, &mut |_| {});
    let last = std::iter::from_fn(|| queues.statuses.pop()).last();
    let missed = last.map_or(0, |status| status.missed_deadlines);
    (timing, refused, missed)
}

/// A goal ten times a second: most are refused because the arm is busy, which costs time too.
fn feed(blob: &Blob, queues: &Queues, duration: Duration) {
    let end_ns = clock::now_ns() + duration.as_nanos() as u64;
    let mut id = 0;
    while clock::now_ns() < end_ns {
        id += 1;
        let goal = Goal {
            magic: GOAL_MAGIC,
            stamp_ns: clock::now_ns(),
            id,
            x_m: blob.ropes[0].reach_m.at((id % 10) as f64 * 0.1),
            rope: 0,
            reserved: 0,
        };
        queues.put(&queues.goals, goal);
        std::thread::sleep(Duration::from_millis(100));
    }
    queues.shutdown.store(true, Ordering::Relaxed);
}

fn time(mut part: impl FnMut(u32)) -> Percentiles {
    const ROUNDS: u32 = 20_000;
    let mut times = histogram();
    for k in 0..ROUNDS {
        let start = clock::now_ns();
        part(k);
        times.saturating_record(clock::now_ns() - start);
    }
    (&times).into()
}
