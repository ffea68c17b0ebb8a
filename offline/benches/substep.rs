//! What the simulator costs: one step of one particle, alone and with its tangents.
//!
//! An iteration is one step of one particle, so criterion's times read as ns per particle and step.
//! The multiples at the end say what a gradient costs next to a plain rollout.

use criterion::{Criterion, criterion_group, criterion_main};
use offline::demo::RopeEnd;
use offline::sim::clamp::ClampPath;
use offline::sim::rope::RopeShape;
use offline::sim::scene::{Grip, PAPER_CELLS_PER_DIAMETER, Scene, Table};
use offline::sim::{Dual, Laned, Physics, simulate};
use std::hint::black_box;
use std::time::{Duration, Instant};

const YOUNG_PA: f64 = 7.0e5;
const POISSON: f64 = 0.35;
const FRICTION: f64 = 0.5;
const LENGTH_M: f64 = 0.25;
const DIAMETER_M: f64 = 0.014;
const LIFT_M_S: f64 = 0.25;
/// Long enough that building the scene does not count, short enough for a slow machine.
const LIFT_S: f64 = 0.05;

/// The paper's rope on the table, its start lifted at constant speed.
fn lift() -> Scene {
    let mut rope = RopeShape {
        length_m: LENGTH_M,
        diameter_m: DIAMETER_M,
        mass_kg: 1.0,
    };
    rope.mass_kg = 1000.0 * rope.volume_m3();
    let start_m = [0.0, 0.0, 0.5 * DIAMETER_M];
    let pose = |t_s: f64| [0.0, 0.0, start_m[2] + LIFT_M_S * t_s, 0.0, 0.0, 0.0, 1.0];
    let grips = vec![Grip {
        end: RopeEnd::Start,
        length_m: 0.02,
        path: ClampPath::from_samples(&[(0.0, pose(0.0), true), (LIFT_S, pose(LIFT_S), true)]),
    }];
    let table = Some(Table { height_m: 0.0 });
    Scene::new(
        rope,
        start_m,
        [1.0, 0.0, 0.0],
        grips,
        table,
        PAPER_CELLS_PER_DIAMETER,
        vec![LIFT_S],
    )
    .expect("the lift is possible")
}

/// Time for `wanted` steps of one particle, from as many whole rollouts as that takes.
fn particle_steps<T: Laned>(scene: &Scene, physics: &Physics<T>, wanted: u64) -> Duration {
    let particles = scene.layout().particles() as u64;
    let start = Instant::now();
    let mut done = 0;
    while done < wanted {
        let rollout = simulate(black_box(scene), physics).expect("the lift runs");
        done += particles * rollout.steps as u64;
        black_box(rollout);
    }
    start.elapsed().mul_f64(wanted as f64 / done as f64)
}

/// Measures one number type; returns the least ns per particle and step that was seen.
fn measure<T: Laned>(criterion: &mut Criterion, name: &str, scene: &Scene, physics: &Physics<T>) -> f64 {
    let mut least_ns = f64::INFINITY;
    criterion.bench_function(name, |bencher| {
        bencher.iter_custom(|wanted| {
            let time = particle_steps(scene, physics, wanted);
            least_ns = least_ns.min(time.as_nanos() as f64 / wanted as f64);
            time
        });
    });
    least_ns
}

fn with_tangents<const N: usize>() -> Physics<Dual<f32, N>> {
    Physics::base(
        Dual::input(YOUNG_PA, 0),
        Dual::input(POISSON, 1),
        Dual::input(FRICTION, 2),
    )
}

fn substep(criterion: &mut Criterion) {
    let scene = lift();
    let single = Physics::base(YOUNG_PA as f32, POISSON as f32, FRICTION as f32);
    let double = Physics::base(YOUNG_PA, POISSON, FRICTION);
    let plain = measure(criterion, "particle_step/f32", &scene, &single);
    let rows = [
        ("f64", measure(criterion, "particle_step/f64", &scene, &double)),
        (
            "Dual<f32, 4>",
            measure(criterion, "particle_step/dual4", &scene, &with_tangents::<4>()),
        ),
        (
            "Dual<f32, 12>",
            measure(criterion, "particle_step/dual12", &scene, &with_tangents::<12>()),
        ),
    ];
    // A filter on the command line leaves some out.
    for (name, ns) in rows {
        if plain.is_finite() && ns.is_finite() {
            println!("{name} costs {:.1} times f32", ns / plain);
        }
    }
}

criterion_group!(benches, substep);
criterion_main!(benches);
