//! What the simulator costs: one step of one particle, alone and with its tangents, and swings per second.
//!
//! An iteration is one step of one particle, so criterion's times read as ns per particle and step. They
//! are times on the processor of one thread, which other programs do not lengthen, where the system tells
//! (Linux), also those of the swings, which run on all cores.

use criterion::{Criterion, criterion_group, criterion_main};
use offline::collect::Swinger;
use offline::demo::RopeEnd;
use offline::fit::Resolution;
use offline::model::Structure;
use offline::sim::clamp::ClampPath;
use offline::sim::rope::RopeShape;
use offline::sim::scene::{Grip, PAPER_CELLS_PER_DIAMETER, Scene, Table};
use offline::sim::{Dual, Laned, Physics, simulate};
use offline::swing::SimulatedSwing;
use rayon::prelude::*;
use shared::task::SwingTask;
use std::hint::black_box;
use std::time::{Duration, Instant};

const YOUNG_PA: f64 = 7.0e5;
const POISSON: f64 = 0.35;
const FRICTION: f64 = 0.5;
/// Lengths of rope whose particles are about 350, 660 (the paper's), 1,000, 4,000 and 16,000.
const LENGTHS_M: [f64; 5] = [0.135, 0.25, 0.40, 1.55, 6.2];
const DIAMETER_M: f64 = 0.014;
const LIFT_M_S: f64 = 0.25;
/// Long enough that building the scene does not count, short enough for a slow machine.
const LIFT_S: f64 = 0.05;

/// A rope as thick as the paper's, 1000 kg/m³.
fn rope(length_m: f64) -> RopeShape {
    RopeShape::of_density(length_m, DIAMETER_M, 1000.0)
}

/// A rope on the table, its start lifted at constant speed.
fn lift(length_m: f64) -> Scene {
    let start_m = [0.0, 0.0, 0.5 * DIAMETER_M];
    let pose = |t_s: f64| [0.0, 0.0, start_m[2] + LIFT_M_S * t_s, 0.0, 0.0, 0.0, 1.0];
    let grips = vec![Grip {
        end: RopeEnd::Start,
        length_m: 0.02,
        path: ClampPath::from_samples(&[(0.0, pose(0.0), true), (LIFT_S, pose(LIFT_S), true)]),
    }];
    let table = Some(Table { height_m: 0.0 });
    Scene::new(
        rope(length_m),
        start_m,
        [1.0, 0.0, 0.0],
        grips,
        table,
        PAPER_CELLS_PER_DIAMETER,
        vec![LIFT_S],
    )
    .expect("the lift is possible")
}

/// Time that this thread has had a processor, where the system tells; otherwise by the clock.
fn on_processor(start: Instant) -> Duration {
    let told = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let ns = told
        .as_deref()
        .and_then(|text| text.split(' ').next()?.parse().ok());
    ns.map_or_else(|| start.elapsed(), Duration::from_nanos)
}

/// Time for `wanted` steps of one particle, from as many whole rollouts as that takes.
fn particle_steps<T: Laned>(scene: &Scene, physics: &Physics<T>, wanted: u64) -> Duration {
    let particles = scene.layout().particles() as u64;
    let start = Instant::now();
    let before = on_processor(start);
    let mut done = 0;
    while done < wanted {
        let rollout = simulate(black_box(scene), physics).expect("the lift runs");
        done += particles * rollout.steps as u64;
        black_box(rollout);
    }
    (on_processor(start) - before).mul_f64(wanted as f64 / done as f64)
}

/// Measures one number type; returns the median ns per particle and step of all samples.
fn measure<T: Laned>(criterion: &mut Criterion, name: &str, scene: &Scene, physics: &Physics<T>) -> f64 {
    let mut samples_ns = Vec::new();
    criterion.bench_function(name, |bencher| {
        bencher.iter_custom(|wanted| {
            let time = particle_steps(scene, physics, wanted);
            samples_ns.push(time.as_nanos() as f64 / wanted as f64);
            time
        });
    });
    samples_ns.sort_by(f64::total_cmp);
    // A filter on the command line leaves some out.
    samples_ns.get(samples_ns.len() / 2).copied().unwrap_or(f64::NAN)
}

/// The last input is as good as any for friction: a tangent costs the same whatever it is of.
fn with_tangents<const N: usize>() -> Physics<Dual<f32, N>> {
    Physics::base(
        Dual::input(YOUNG_PA, 0),
        Dual::input(POISSON, 1),
        Dual::input(FRICTION, N - 1),
    )
}

/// Swings of the paper's rope per second and core as the policy's rollouts make them, over releases that ropes
/// reach in the plane and out of it, over the range of E (0.2 to 4.3 MPa) and over ν from 0.2 to 0.45; and the same
/// for E = 0.9 MPa and ν = 0.3 alone.
fn swings_per_second() -> [f64; 2] {
    const SWINGS: usize = 48;
    let releases_m = [[0.1, 0.15], [0.12, 0.12], [0.085, 0.2], [0.14, 0.22]];
    let swing = SimulatedSwing {
        rope: rope(0.25),
        task: SwingTask::PAPER,
        structure: Structure::default(),
        effect_values: Vec::new(),
        resolution: Resolution {
            cells: PAPER_CELLS_PER_DIAMETER,
        },
    };
    let rate = |stiffness: &(dyn Fn(f64) -> [f64; 2] + Sync)| {
        let seconds = (0..SWINGS).into_par_iter().map(|i| {
            let [young_pa, poisson] = stiffness(i as f64 / (SWINGS - 1) as f64);
            let start = Instant::now();
            let before = on_processor(start);
            let release_m = releases_m[i % releases_m.len()];
            black_box(
                swing
                    .reach_m(young_pa, poisson, release_m)
                    .expect("the swing runs"),
            );
            (on_processor(start) - before).as_secs_f64()
        });
        SWINGS as f64 / seconds.sum::<f64>()
    };
    [
        rate(&|share| [0.2e6 * 21.5f64.powf(share), 0.2 + 0.25 * (7.0 * share).fract()]),
        rate(&|_| [0.9e6, 0.3]),
    ]
}

fn substep(criterion: &mut Criterion) {
    let single = Physics::base(YOUNG_PA as f32, POISSON as f32, FRICTION as f32);
    let mut table = String::new();
    for length_m in LENGTHS_M {
        let scene = lift(length_m);
        let particles = scene.layout().particles();
        let ns = measure(
            criterion,
            &format!("particle_step/f32/{particles}"),
            &scene,
            &single,
        );
        table += &format!("f32, {particles} particles: {ns:.1} ns per particle and step\n");
    }
    let scene = lift(LENGTHS_M[1]);
    let plain = measure(criterion, "particle_step/f32", &scene, &single);
    let double = Physics::base(YOUNG_PA, POISSON, FRICTION);
    let rows = [
        ("f64", measure(criterion, "particle_step/f64", &scene, &double)),
        (
            "2 tangents",
            measure(criterion, "particle_step/dual2", &scene, &with_tangents::<2>()),
        ),
        (
            "8 tangents",
            measure(criterion, "particle_step/dual8", &scene, &with_tangents::<8>()),
        ),
        (
            "16 tangents",
            measure(criterion, "particle_step/dual16", &scene, &with_tangents::<16>()),
        ),
    ];
    for (name, ns) in rows {
        table += &format!("{name}: {ns:.1} ns, {:.1} times f32\n", ns / plain);
    }
    let cores = rayon::current_num_threads() as f64;
    let [range, one] = swings_per_second().map(|rate| rate * cores);
    println!(
        "{table}swings per second on {cores} cores: {range:.1} over the range, {one:.1} at E = 0.9 MPa, ν = 0.3"
    );
}

criterion_group!(benches, substep);
criterion_main!(benches);
