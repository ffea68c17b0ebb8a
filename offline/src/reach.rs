//! Which goals of the task a rope can reach: an interval for each rope, interpolated from a grid over ln E and ν.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use shared::task::Interval;

/// Grid of ropes: ln E finely, ν coarsely since it hardly matters.
const ROPES: [usize; 2] = [24, 3];

/// A goal for a rope.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Practice {
    /// Goal, m.
    pub goal_x_m: f64,
    /// Young's modulus, Pa.
    pub young_pa: f64,
    /// Poisson's ratio.
    pub poisson: f64,
}

/// Reachable goals over ranges of ropes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReachTable {
    young_pa: Interval,
    poisson: Interval,
    cells: Vec<[Interval; ROPES[1]]>,
}

impl ReachTable {
    /// Tabulates `reach(young_pa, poisson)`, goals in m, over the given ranges.
    pub fn new(young_pa: Interval, poisson: Interval, reach: impl Fn(f64, f64) -> Interval) -> Self {
        let logs = log_range(&young_pa);
        let share = |k: usize, count: usize| k as f64 / (count - 1) as f64;
        let row = |i: usize| {
            let young = young_pa.clamp(logs.at(share(i, ROPES[0])).exp());
            std::array::from_fn(|k| reach(young, poisson.at(share(k, ROPES[1]))))
        };
        Self {
            young_pa,
            poisson,
            cells: (0..ROPES[0]).map(row).collect(),
        }
    }

    /// A random rope (E log-uniform, ν uniform) with a goal drawn uniformly from what it reaches.
    pub fn draw(&self, rng: &mut ChaCha8Rng) -> Practice {
        let (young_pa, poisson) = self.draw_rope(rng);
        Practice {
            goal_x_m: self.reachable_m(young_pa, poisson).at(rng.random::<f64>()),
            young_pa,
            poisson,
        }
    }

    /// A random rope: Young's modulus, Pa, log-uniform, and Poisson's ratio, uniform.
    pub fn draw_rope(&self, rng: &mut ChaCha8Rng) -> (f64, f64) {
        let logs = log_range(&self.young_pa);
        (
            self.young_pa.clamp(logs.at(rng.random::<f64>()).exp()),
            self.poisson.at(rng.random::<f64>()),
        )
    }

    /// Reachable goals of one rope, m; a rope outside the ranges gets those of the nearest inside.
    pub fn reachable_m(&self, young_pa: f64, poisson: f64) -> Interval {
        let (i, u) = cell(share_of(&log_range(&self.young_pa), young_pa.ln()), ROPES[0]);
        let (k, v) = cell(share_of(&self.poisson, poisson), ROPES[1]);
        let blend = |end: fn(&Interval) -> f64| {
            let along = |i: usize| end(&self.cells[i][k]) * (1.0 - v) + end(&self.cells[i][k + 1]) * v;
            along(i) * (1.0 - u) + along(i + 1) * u
        };
        Interval {
            low: blend(|range| range.low),
            high: blend(|range| range.high),
        }
    }

    /// The goals that at least one rope reaches, m.
    pub fn all_goals_m(&self) -> Interval {
        let cells = || self.cells.iter().flatten();
        Interval {
            low: cells().map(|range| range.low).fold(f64::INFINITY, f64::min),
            high: cells().map(|range| range.high).fold(f64::NEG_INFINITY, f64::max),
        }
    }
}

fn log_range(range: &Interval) -> Interval {
    Interval {
        low: range.low.ln(),
        high: range.high.ln(),
    }
}

fn share_of(range: &Interval, value: f64) -> f64 {
    ((value - range.low) / (range.high - range.low)).clamp(0.0, 1.0)
}

/// The grid cell that holds `share`, and the place in it.
fn cell(share: f64, points: usize) -> (usize, f64) {
    let position = share * (points - 1) as f64;
    let index = (position as usize).min(points - 2);
    (index, position - index as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collect::stream;

    #[test]
    fn a_bilinear_reach_is_reproduced_and_draws_stay_inside() {
        let young = Interval { low: 1e5, high: 1e7 };
        let poisson = Interval { low: 0.2, high: 0.4 };
        let low = |young: f64, poisson: f64| 0.1 * young.ln() + poisson;
        let table = ReachTable::new(young, poisson, |young, poisson| Interval {
            low: low(young, poisson),
            high: low(young, poisson) + 0.5,
        });
        let mut rng = stream(1, 1);
        for _ in 0..100 {
            let drawn = table.draw(&mut rng);
            let found = table.reachable_m(drawn.young_pa, drawn.poisson);
            assert!((found.low - low(drawn.young_pa, drawn.poisson)).abs() < 1e-12);
            assert!((found.high - found.low - 0.5).abs() < 1e-12);
            assert!(found.contains(drawn.goal_x_m));
        }
        assert_eq!(table.reachable_m(1.0, 0.2), table.reachable_m(1e5, 0.2));
        let all = table.all_goals_m();
        assert!((all.low - low(1e5, 0.2)).abs() < 1e-12 && (all.high - low(1e7, 0.4) - 0.5).abs() < 1e-12);
    }
}
