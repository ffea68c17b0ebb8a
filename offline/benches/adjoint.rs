//! What a gradient costs: the way forward and back as a multiple of a plain rollout, and its memory.
//!
//! Both are timed in turn in one run, so load on the machine hits both; the least of some rounds counts.
//! The scene is the one of the other benchmark, 2000 steps of a rope on the table that is lifted at one
//! end, at several numbers of particles.

use offline::demo::RopeEnd;
use offline::model::Structure;
use offline::sim::adjoint::{Cotangent, DEFAULT_BUDGET_BYTES, Differentiated, Family, differentiate};
use offline::sim::clamp::ClampPath;
use offline::sim::rope::RopeShape;
use offline::sim::scene::{Grip, PAPER_CELLS_PER_DIAMETER, Scene, Table};
use offline::sim::time_step::time_step_s;
use offline::sim::{Physics, Real, Rollout, simulate};
use std::hint::black_box;
use std::time::Instant;

const DIAMETER_M: f64 = 0.014;
const LIFT_M_S: f64 = 0.25;
const STEPS: f64 = 2000.0;
const FRICTION: f64 = 0.5;
const YOUNG_PA: f64 = 0.7e6;
const ROUNDS: usize = 3;

struct Rope(Structure);

impl Family for Rope {
    fn physics<T: Real>(&self, theta: &[T]) -> Physics<T> {
        self.0.physics(theta, FRICTION)
    }
}

/// A rope of about `particles` particles on the table, its start lifted at constant speed.
fn lift(particles: f64) -> Scene {
    let length_m = particles / 12.0 * 0.6 * DIAMETER_M / PAPER_CELLS_PER_DIAMETER;
    let rope = RopeShape::of_density(length_m, DIAMETER_M, 1000.0);
    let start_m = [0.0, 0.0, 0.5 * DIAMETER_M];
    let pose = |t_s: f64| [0.0, 0.0, start_m[2] + LIFT_M_S * t_s, 0.0, 0.0, 0.0, 1.0];
    let grips = vec![Grip {
        end: RopeEnd::Start,
        length_m: 0.02,
        path: ClampPath::from_samples(&[(0.0, pose(0.0), true), (1.0, pose(1.0), true)]),
    }];
    let table = Some(Table { height_m: 0.0 });
    let mut scene = Scene::new(
        rope,
        start_m,
        [1.0, 0.0, 0.0],
        grips,
        table,
        PAPER_CELLS_PER_DIAMETER,
        vec![1.0],
    )
    .expect("the lift is possible");
    let dt_s = time_step_s(&scene, &Physics::base(YOUNG_PA, 0.35, FRICTION));
    scene.duration_s = (STEPS - 0.5) * dt_s;
    scene.frame_times_s = vec![scene.duration_s];
    scene
}

/// The squared distance of the rope from the origin, differentiated.
fn loss(rollout: &Rollout<f32>) -> Cotangent {
    let frames = rollout.frames.iter();
    Cotangent {
        frames: frames
            .map(|frame| frame.iter().map(|p| p.map(|x| 2.0 * f64::from(x))).collect())
            .collect(),
        reach: 0.0,
    }
}

/// Seconds that a piece of work takes, and what it returns.
fn timed<R>(work: impl FnOnce() -> R) -> (f64, R) {
    let start = Instant::now();
    let result = work();
    (start.elapsed().as_secs_f64(), result)
}

fn main() {
    println!(
        "f32, one thread, 2000 steps, budget {} MiB",
        DEFAULT_BUDGET_BYTES >> 20
    );
    for (name, structure) in [
        ("no effects", Structure::default()),
        ("drag", Structure { effects: vec![0] }),
    ] {
        let family = Rope(structure);
        let mut theta = family.0.start(YOUNG_PA);
        for (value, info) in theta.iter_mut().zip(family.0.parameters()).skip(2) {
            *value += 0.1 * info.smallest_of_interest;
        }
        let single: Vec<f32> = theta.iter().map(|&x| x as f32).collect();
        for particles in [350.0, 1000.0, 4000.0] {
            let scene = lift(particles);
            let physics = family.physics(&single);
            let (mut plain, mut whole) = (f64::INFINITY, f64::INFINITY);
            let mut last: Option<Differentiated<f32>> = None;
            let mut steps = 0;
            for _ in 0..ROUNDS {
                let (time, rollout) = timed(|| simulate(black_box(&scene), &physics).expect("the lift runs"));
                plain = plain.min(time);
                steps = rollout.steps;
                let budget = DEFAULT_BUDGET_BYTES;
                let (time, result) =
                    timed(|| differentiate(black_box(&scene), &family, &theta, budget, loss).expect("runs"));
                whole = whole.min(time);
                last = Some(result);
            }
            let result = last.expect("there are rounds");
            let count = scene.layout().particles();
            let per = |time: f64| 1e9 * time / (count * steps) as f64;
            println!(
                "{name}, {count} particles, {steps} steps: forward {:.0} ns, with gradient {:.0} ns per particle \
                 and step, {:.2} times; {:.0} MB, {} steps repeated",
                per(plain),
                per(whole),
                whole / plain,
                result.memory_bytes as f64 / 1e6,
                result.repeated_steps
            );
        }
    }
}
