//! Evaluation of a policy: its answers are swung, and what they reach is compared with the goals.

use crate::collect::{Stopped, SwingRefusal, Swinger, Watch, count_refusals, stream};
use crate::paper_units::METRES_PER_UNIT;
use crate::reach::{Practice, ReachTable};
use crate::tell::Progress;
use rand::RngExt;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use shared::policy::Policy;
use shared::task::Interval;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Random streams of evaluation lie above those of rollouts and of training, so its ropes are unseen.
const FIRST_STREAM: u64 = 1 << 50;

/// One goal, the policy's answer, and what it led to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Attempt {
    /// Goal and rope.
    pub goal: Practice,
    /// The policy's release point (x, z), m.
    pub release_m: [f64; 2],
    /// Largest x of the tip in m, or why there is none.
    pub reached_m: Result<f64, SwingRefusal>,
}

/// |goal − reached| over attempts.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MissSummary {
    /// Attempts with a score.
    pub count: usize,
    /// Mean, mm.
    pub mean_mm: f64,
    /// Standard deviation, mm; 0 for a single attempt.
    pub spread_mm: f64,
    /// Median, mm.
    pub median_mm: f64,
    /// 90th percentile, mm.
    pub p90_mm: f64,
    /// Largest, mm.
    pub max_mm: f64,
    /// Mean in the paper's units.
    pub mean_paper: f64,
    /// Standard deviation in the paper's units.
    pub spread_paper: f64,
}

/// How well a policy reaches goals.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// Summary; none where every attempt was refused.
    pub miss: Option<MissSummary>,
    /// Refusals by reason.
    pub refusals: BTreeMap<String, usize>,
    /// Everything, in order.
    pub attempts: Vec<Attempt>,
}

impl Evaluation {
    /// Whether it holds what a policy answers to these goals, and to no others.
    pub fn is_of(&self, policy: &Policy, goals: &[Practice]) -> bool {
        let answered = |attempt: &Attempt, goal: &Practice| {
            let release_m = policy.release_point_m(goal.goal_x_m, goal.young_pa, goal.poisson);
            attempt.goal == *goal && attempt.release_m == release_m
        };
        self.attempts.len() == goals.len()
            && self
                .attempts
                .iter()
                .zip(goals)
                .all(|(attempt, goal)| answered(attempt, goal))
    }
}

/// `goals` goals for each of `ropes` random ropes of the table's ranges, within what each rope reaches.
pub fn unseen(reach: &ReachTable, ropes: usize, goals: usize, seed: u64) -> Vec<Practice> {
    let mut practice = Vec::with_capacity(ropes * goals);
    for rope in 0..ropes {
        let mut rng = stream(seed, FIRST_STREAM + rope as u64);
        let (young_pa, poisson) = reach.draw_rope(&mut rng);
        let range = reach.reachable_m(young_pa, poisson);
        // One goal in each of equal parts of the range, at the same random place in all parts.
        let place = rng.random::<f64>();
        for k in 0..goals {
            practice.push(Practice {
                goal_x_m: range.at((k as f64 + place) / goals as f64),
                young_pa,
                poisson,
            });
        }
    }
    practice
}

/// `goals` evenly spaced goals for one rope, the ends of `range` (m) included.
pub fn along(range: &Interval, young_pa: f64, poisson: f64, goals: usize) -> Vec<Practice> {
    let steps = goals.saturating_sub(1).max(1) as f64;
    let goal = |k: usize| Practice {
        goal_x_m: range.at(k as f64 / steps),
        young_pa,
        poisson,
    };
    (0..goals).map(goal).collect()
}

/// Swings the policy's answer to each goal.
pub fn evaluate(
    policy: &Policy,
    swinger: &dyn Swinger,
    goals: &[Practice],
    watch: Watch,
) -> Result<Evaluation, Stopped> {
    evaluate_told(
        policy,
        swinger,
        goals,
        &|goal| (goal.young_pa, goal.poisson),
        watch,
    )
}

/// The same for a policy that is told something else of each rope: Young's modulus, Pa, and Poisson's ratio.
pub fn evaluate_told(
    policy: &Policy,
    swinger: &dyn Swinger,
    goals: &[Practice],
    told: &(dyn Fn(&Practice) -> (f64, f64) + Sync),
    watch: Watch,
) -> Result<Evaluation, Stopped> {
    let done = AtomicUsize::new(0);
    let refused = AtomicUsize::new(0);
    let attempts: Result<Vec<Attempt>, _> = goals
        .par_iter()
        .map(|goal| {
            if watch.stop.load(Ordering::Relaxed) {
                return Err(Stopped);
            }
            let attempt = attempt(policy, swinger, goal, told(goal));
            let failed = usize::from(attempt.reached_m.is_err());
            (watch.progress)(Progress {
                stage: "evaluation",
                refused: refused.fetch_add(failed, Ordering::Relaxed) + failed,
                done: done.fetch_add(1, Ordering::Relaxed) + 1,
                total: goals.len(),
            });
            Ok(attempt)
        })
        .collect();
    Ok(summarise(attempts?))
}

fn attempt(
    policy: &Policy,
    swinger: &dyn Swinger,
    goal: &Practice,
    (young_pa, poisson): (f64, f64),
) -> Attempt {
    let release_m = policy.release_point_m(goal.goal_x_m, young_pa, poisson);
    let reached_m = match swinger.reach_m(goal.young_pa, goal.poisson, release_m) {
        Ok(reach) if !reach.is_finite() => Err(SwingRefusal::Failed(format!("the tip reached x = {reach}"))),
        other => other,
    };
    Attempt {
        goal: *goal,
        release_m,
        reached_m,
    }
}

fn summarise(attempts: Vec<Attempt>) -> Evaluation {
    let scored = attempts.iter().filter_map(|attempt| {
        let reached = attempt.reached_m.as_ref().ok()?;
        Some(1e3 * (reached - attempt.goal.goal_x_m).abs())
    });
    Evaluation {
        miss: MissSummary::new(scored.collect()),
        refusals: count_refusals(
            attempts
                .iter()
                .filter_map(|attempt| attempt.reached_m.as_ref().err()),
        ),
        attempts,
    }
}

impl MissSummary {
    /// Summary of misses in mm; none of no misses.
    pub fn new(mut misses: Vec<f64>) -> Option<Self> {
        misses.sort_by(f64::total_cmp);
        let count = misses.len();
        let max_mm = *misses.last()?;
        let mean_mm = misses.iter().sum::<f64>() / count as f64;
        let square: f64 = misses.iter().map(|miss| (miss - mean_mm).powi(2)).sum();
        let spread_mm = (square / (count - 1).max(1) as f64).sqrt();
        let paper = |mm: f64| 1e-3 * mm / METRES_PER_UNIT;
        Some(Self {
            count,
            mean_mm,
            spread_mm,
            median_mm: quantile(&misses, 0.5),
            p90_mm: quantile(&misses, 0.9),
            max_mm,
            mean_paper: paper(mean_mm),
            spread_paper: paper(spread_mm),
        })
    }
}

/// Quantile of sorted values, linear between neighbours (Hyndman and Fan 1996, type 7).
fn quantile(sorted: &[f64], share: f64) -> f64 {
    let position = share * (sorted.len() - 1) as f64;
    let below = position as usize;
    let above = (below + 1).min(sorted.len() - 1);
    sorted[below] + (position - below as f64) * (sorted[above] - sorted[below])
}

/// Why a rope has no goals.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "no swing of this rope came to a goal of the task: it is too stiff, too limp or too short, or its swings were refused"
)]
pub struct NoReach;

/// The goals of one rope that rollouts confirm, m: from the smallest to the largest x that the attempts
/// reached, within what they asked for.
pub fn confirmed_reach(evaluation: &Evaluation) -> Result<Interval, NoReach> {
    let hull = |values: &mut dyn Iterator<Item = f64>| {
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
            (low.min(value), high.max(value))
        })
    };
    let scored = || {
        evaluation
            .attempts
            .iter()
            .filter(|attempt| attempt.reached_m.is_ok())
    };
    let asked = hull(&mut scored().map(|attempt| attempt.goal.goal_x_m));
    let reached = hull(&mut scored().filter_map(|attempt| attempt.reached_m.as_ref().ok().copied()));
    let range = Interval {
        low: asked.0.max(reached.0),
        high: asked.1.min(reached.1),
    };
    if range.low <= range.high {
        Ok(range)
    } else {
        Err(NoReach)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collect::stand_in::unwatched;
    use crate::freeze::tests::blob;

    /// Reaches what it is told by the release point, and refuses stiff ropes.
    struct Mirror;

    impl Swinger for Mirror {
        fn reach_m(&self, young_pa: f64, _: f64, release_m: [f64; 2]) -> Result<f64, SwingRefusal> {
            match young_pa {
                young if young > 3e6 => Err(SwingRefusal::Failed("too stiff".into())),
                young if young > 2e6 => Ok(f64::NAN),
                _ => Ok(0.2 + release_m[0]),
            }
        }
    }

    fn table() -> ReachTable {
        let interval = |low, high| Interval { low, high };
        ReachTable::new(interval(2e5, 4e6), interval(0.2, 0.4), |_, _| interval(0.28, 0.4))
    }

    #[test]
    fn unseen_goals_lie_in_reach_and_repeat() {
        let goals = unseen(&table(), 10, 3, 5);
        assert_eq!(goals, unseen(&table(), 10, 3, 5));
        assert_ne!(goals, unseen(&table(), 10, 3, 6));
        assert_eq!(goals.len(), 30);
        for three in goals.chunks(3) {
            assert!(three.iter().all(|goal| goal.young_pa == three[0].young_pa));
            assert!(
                three
                    .windows(2)
                    .all(|pair| (pair[1].goal_x_m - pair[0].goal_x_m - 0.04).abs() < 1e-9)
            );
            assert!(three.iter().all(|goal| (0.28..=0.4).contains(&goal.goal_x_m)));
        }
    }

    #[test]
    fn refusals_are_counted_and_never_scored() {
        let policy = &blob().policy;
        let goals = unseen(&table(), 30, 2, 5);
        let evaluation = evaluate(policy, &Mirror, &goals, unwatched()).unwrap();
        let miss = evaluation.miss.unwrap();
        let refused: usize = evaluation.refusals.values().sum();
        assert!(refused > 0);
        assert_eq!(miss.count + refused, 60);
        let first = evaluation
            .attempts
            .iter()
            .find(|attempt| attempt.reached_m.is_ok())
            .unwrap();
        assert_eq!(*first.reached_m.as_ref().unwrap(), 0.2 + first.release_m[0]);
        assert!((miss.mean_paper - miss.mean_mm / 500.0).abs() < 1e-12);
        let stiff = along(&Interval { low: 0.3, high: 0.4 }, 3.5e6, 0.3, 4);
        let none = evaluate(policy, &Mirror, &stiff, unwatched()).unwrap();
        assert_eq!((none.miss, confirmed_reach(&none)), (None, Err(NoReach)));
    }

    #[test]
    fn summaries_are_the_textbooks() {
        let miss = MissSummary::new(vec![4.0, 1.0, 2.0, 3.0, 5.0]).unwrap();
        assert_eq!(
            (miss.count, miss.mean_mm, miss.median_mm, miss.max_mm),
            (5, 3.0, 3.0, 5.0)
        );
        assert!((miss.spread_mm - 2.5f64.sqrt()).abs() < 1e-12);
        assert!((miss.p90_mm - 4.6).abs() < 1e-12);
        assert_eq!(MissSummary::new(vec![7.0]).unwrap().spread_mm, 0.0);
        assert_eq!(MissSummary::new(vec![]), None);
    }

    #[test]
    fn confirmed_goals_are_both_asked_for_and_reached() {
        let goals = along(&Interval { low: 0.2, high: 0.6 }, 1e6, 0.3, 5);
        assert_eq!((goals[0].goal_x_m, goals[4].goal_x_m), (0.2, 0.6));
        let evaluation = evaluate(&blob().policy, &Mirror, &goals, unwatched()).unwrap();
        let range = confirmed_reach(&evaluation).unwrap();
        assert!(range.low >= 0.25 && range.high <= 0.35, "{range:?}");
    }
}
