//! What single precision costs a rollout, wherever in the room the rope lies.

use offline::demo::Demo;
use offline::sim::scene::Scene;
use offline::sim::{Laned, Physics, simulate};

/// Most that it may move a point of the rope, and all of them in the mean of the squares, m: a twentieth and a two-hundredth of
/// the noise of a camera.
const MOST_M: f64 = 5e-5;
const RMS_M: f64 = 5e-6;

/// The shipped recording, at another place in the room.
fn moved(by_m: [f64; 3]) -> Scene {
    let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/../offline/demos/sample-rope/fit");
    let mut demo = Demo::load(shipped).expect("the shipped demo loads");
    for sample in demo.clamps.iter_mut().flatten() {
        for (place, by) in sample.position_m.iter_mut().zip(by_m) {
            *place += by;
        }
    }
    if let Some(table) = &mut demo.spec.table {
        table.height_m += by_m[2];
    }
    Scene::of_demo(&demo, 1.5).expect("the scene can be simulated")
}

/// Every point of its centreline in every frame, m.
fn points_m<T: Laned>(scene: &Scene) -> Vec<[f64; 3]> {
    let physics = Physics::base(T::of(0.9e6), T::of(0.35), T::of(0.4));
    let rollout = simulate(scene, &physics).expect("the rollout ends");
    let points = rollout.frames.into_iter().flatten();
    points.map(|point| point.map(|c| c.value())).collect()
}

/// Positions were once summed up without what rounding left of each step: a metre off, steps of slow rope were smaller
/// than half the last digit, and the same recording gave another stiffness.
#[test]
fn a_rope_moves_alike_wherever_in_the_room_it_lies() {
    let exact = points_m::<f64>(&moved([0.0; 3]));
    for by_m in [[0.0; 3], [-0.25, 0.0, 0.0], [1.0, -2.0, 0.0], [0.0, 0.0, 0.8]] {
        let found = points_m::<f32>(&moved(by_m));
        let off_m = |(a, b): (&[f64; 3], &[f64; 3])| {
            (0..3)
                .map(|k| (a[k] - by_m[k] - b[k]).powi(2))
                .sum::<f64>()
                .sqrt()
        };
        let off_m: Vec<f64> = found.iter().zip(&exact).map(off_m).collect();
        let worst_m = off_m.iter().copied().fold(0.0, f64::max);
        let rms_m = (off_m.iter().map(|off| off * off).sum::<f64>() / off_m.len() as f64).sqrt();
        println!(
            "moved by {by_m:?} m: {:.2} µm off (rms), at most {:.2}",
            1e6 * rms_m,
            1e6 * worst_m
        );
        assert_eq!(found.len(), exact.len());
        assert!(
            worst_m < MOST_M && rms_m < RMS_M,
            "moved by {by_m:?} m: {rms_m}, {worst_m} m off"
        );
    }
}
