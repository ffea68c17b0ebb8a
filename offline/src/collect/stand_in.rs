//! A stand-in for the simulator in tests: two rigid rods on springs in place of the rope, which keeps
//! the task's geometry and the way in which stiffness changes the reach. Never compiled outside tests.

use super::{Design, SwingRefusal, Swinger, Watch};
use shared::task::{Interval, SwingTask};
use std::sync::atomic::AtomicBool;

/// Free length of the rope, m.
const LENGTH_M: f64 = 0.25;
/// Diameter of the rope, m.
const DIAMETER_M: f64 = 0.014;
/// Density, kg/m³.
const DENSITY: f64 = 1000.0;
/// Gravity, m/s².
const GRAVITY: f64 = 9.81;
/// Friction in each joint, N m s.
const FRICTION: f64 = 5e-5;
/// Retardation time of the springs (Kelvin-Voigt), s: in the simulator too stiff ropes swing less far.
const RETARDATION_S: f64 = 0.1;
const STEP_S: f64 = 1e-3;
const STEPS: usize = 1200;

/// Two uniform rods of half the rope's length. Springs with the bending stiffness E I of the rope hold
/// them straight and downward. Equations of motion from the Lagrangian of two uniform rods.
pub(crate) struct DoublePendulum;

impl Swinger for DoublePendulum {
    fn reach_m(&self, young_pa: f64, poisson: f64, release_m: [f64; 2]) -> Result<f64, SwingRefusal> {
        let top = SwingTask::PAPER.touching_m();
        let (dx, down) = (release_m[0] - top[0], top[1] - release_m[1]);
        let distance = dx.hypot(down);
        if distance > LENGTH_M {
            return Err(SwingRefusal::Unreachable {
                distance_m: distance,
                length_m: LENGTH_M,
            });
        }
        // A straight line from the clamp to the tip, bent so that the middle hangs low.
        let (line, bend) = (dx.atan2(down), (distance / LENGTH_M).acos());
        let mut state = [line + bend, line - bend, 0.0, 0.0];
        let rods = Rods::new(young_pa, poisson);
        let mut reach = release_m[0];
        for _ in 0..STEPS {
            state = rods.step(state);
            reach = reach.max(top[0] + 0.5 * LENGTH_M * (state[0].sin() + state[1].sin()));
        }
        Ok(reach)
    }
}

struct Rods {
    mass: f64,
    spring: f64,
    friction: f64,
}

impl Rods {
    fn new(young_pa: f64, poisson: f64) -> Self {
        let pi = std::f64::consts::PI;
        let bending = young_pa * pi * DIAMETER_M.powi(4) / 64.0;
        // Poisson's ratio matters as little as in the simulator: 0.5 % of stiffness for 0.01.
        let spring = bending / (0.5 * LENGTH_M) * (1.0 + 0.5 * (poisson - 0.3));
        Self {
            mass: DENSITY * pi * DIAMETER_M.powi(2) / 4.0 * 0.5 * LENGTH_M,
            spring,
            friction: FRICTION + RETARDATION_S * spring,
        }
    }

    /// Rates of (angle 1, angle 2, rate 1, rate 2), angles from the downward vertical.
    fn rates(&self, [a, b, da, db]: [f64; 4]) -> [f64; 4] {
        let half = 0.5 * LENGTH_M;
        let inertia = self.mass * half * half;
        let weight = self.mass * GRAVITY * half;
        let joint = self.spring * (b - a) + self.friction * (db - da);
        let first = (joint - 1.5 * weight * a.sin() - self.spring * a - self.friction * da) / inertia;
        let second = (-joint - 0.5 * weight * b.sin()) / inertia;
        let (sin, cos) = (a - b).sin_cos();
        let (p, q) = (first - 0.5 * sin * db * db, second + 0.5 * sin * da * da);
        let (m11, m12, m22) = (4.0 / 3.0, 0.5 * cos, 1.0 / 3.0);
        let det = m11 * m22 - m12 * m12;
        [da, db, (m22 * p - m12 * q) / det, (m11 * q - m12 * p) / det]
    }

    /// One step of the classical Runge-Kutta method.
    fn step(&self, state: [f64; 4]) -> [f64; 4] {
        let moved = |rate: &[f64; 4], time: f64| std::array::from_fn(|k| state[k] + time * rate[k]);
        let k1 = self.rates(state);
        let k2 = self.rates(moved(&k1, 0.5 * STEP_S));
        let k3 = self.rates(moved(&k2, 0.5 * STEP_S));
        let k4 = self.rates(moved(&k3, STEP_S));
        std::array::from_fn(|k| state[k] + STEP_S / 6.0 * (k1[k] + 2.0 * (k2[k] + k3[k]) + k4[k]))
    }
}

/// The paper's task and ranges of ropes with this stand-in.
pub(crate) fn design(rollouts: u64) -> Design {
    Design {
        young_pa: Interval {
            low: 2e5,
            high: 4.3e6,
        },
        poisson: Interval { low: 0.2, high: 0.4 },
        region: Design::region(&SwingTask::PAPER, LENGTH_M),
        goal_x_m: SwingTask::PAPER.goal_x_m,
        rollouts,
        seed: 1,
    }
}

/// Nobody watches and nobody stops.
pub(crate) fn unwatched() -> Watch<'static> {
    static NEVER: AtomicBool = AtomicBool::new(false);
    Watch {
        progress: &|_| {},
        stop: &NEVER,
    }
}

#[test]
fn the_stand_in_swings_like_the_task() {
    let reach = |young: f64| DoublePendulum.reach_m(young, 0.3, [0.15, 0.15]).unwrap();
    let (soft, stiff) = (reach(2e5), reach(4.3e6));
    assert!(
        soft > stiff + 0.02 && soft < 0.45 && stiff > 0.25,
        "{soft} {stiff}"
    );
    let beyond = DoublePendulum.reach_m(1e6, 0.3, [0.05, 0.05]);
    assert!(matches!(beyond, Err(SwingRefusal::Unreachable { .. })));
}
