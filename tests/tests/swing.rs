//! The swing task in the simulator: the quick settled approach against the robot's true motion.

use offline::sim::scene::Scene;
use offline::sim::simulate;
use offline::verify::setup::{SOFT_PA, elastic, rope, with_effect};
use shared::profile::MotionLimits;
use shared::task::SwingTask;

/// Largest x of the tip in a swing whose gravity leans out of the plane by `lean_rad`.
fn reach_m(scene: &Scene, young_pa: f64, lean_rad: f64) -> f64 {
    let physics = with_effect("tilted_gravity", &[0.0, lean_rad], elastic(young_pa));
    simulate(scene, &physics).unwrap().reach_m.unwrap()
}

/// Reach of the quick, damped approach and of the robot's slow one.
fn two_reaches_m(release_m: [f64; 2], young_pa: f64, lean_rad: f64) -> [f64; 2] {
    let (shape, task) = (rope(0.25, 0.014), SwingTask::PAPER);
    let quick = Scene::swing_settled(shape, &task, release_m, 1.5).unwrap();
    let slow = Scene::swing(shape, &task, release_m, &MotionLimits::PAPER, 1.5).unwrap();
    let reaches = [&quick, &slow].map(|scene| reach_m(scene, young_pa, lean_rad));
    println!(
        "release {release_m:?}, E {young_pa:.1e} Pa: quick {:.6}, slow {:.6} m",
        reaches[0], reaches[1]
    );
    reaches
}

/// The undamped rope still swings by some micrometres after the slow approach and the dwell, and the
/// quick one has not quite come to rest; both are well below the 0.1 mm that are promised.
#[test]
fn a_settled_swing_reaches_as_far_as_the_true_one() {
    for release_m in [[0.1, 0.15], [0.12, 0.08]] {
        let [quick, slow] = two_reaches_m(release_m, SOFT_PA, 0.0);
        assert!(
            (quick - slow).abs() < 1e-4,
            "{release_m:?}: {quick} against {slow}"
        );
    }
}

/// With the ends close together and level, a rope in the plane of the task is in unstable
/// equilibrium: it falls to the side by 26 mm, and the tip then reaches 14 mm less far. What it needs
/// is a push: after the slow approach rounding is enough, after the quick one it is not always. A
/// lean of gravity by a milliradian makes both fall.
#[test]
fn a_rope_that_falls_out_of_the_plane_does_so_on_both_ways() {
    let [quick, slow] = two_reaches_m([0.15, 0.3], 0.9e6, 1e-3);
    assert!((quick - slow).abs() < 5e-4, "{quick} against {slow}");
}
