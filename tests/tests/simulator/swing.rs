//! The swing task in the simulator: the quick settled approach against the robot's true motion.

use offline::collect::Swinger;
use offline::fit::Resolution;
use offline::model::Structure;
use offline::sim::scene::{Scene, Settling};
use offline::sim::simulate;
use offline::swing::SimulatedSwing;
use offline::verify::setup::{POISSON, SOFT_PA, elastic, rope, with_effect};
use shared::profile::MotionLimits;
use shared::task::SwingTask;

/// Largest x of the tip in a swing whose gravity leans out of the plane by `lean_rad`.
fn reach_m(scene: &Scene, young_pa: f64, lean_rad: f64) -> f64 {
    let physics = with_effect("tilted_gravity", &[0.0, lean_rad], elastic(young_pa));
    simulate(scene, &physics).unwrap().reach_m.unwrap()
}

/// In the plane, and without anything that pushes the rope out of it.
#[test]
fn a_settled_swing_reaches_as_far_as_the_true_one_that_has_come_to_rest() {
    for release_m in [[0.1, 0.15], [0.12, 0.08]] {
        let off_m = off_m(release_m, SOFT_PA, 0.0);
        assert!(off_m.abs() < 1e-4, "{release_m:?}: {off_m}");
    }
}

/// The lean of the policy's rollouts.
const LEAN_RAD: f64 = 1e-3;
/// Releases over the task's range: at the first ropes stay in the plane, at most others they fall out of it.
const RELEASES_M: [[f64; 2]; 6] = [
    [0.085, 0.18],
    [0.12, 0.12],
    [0.15, 0.15],
    [0.12, 0.18],
    [0.14, 0.22],
    [0.15, 0.3],
];
const YOUNG_PA: [f64; 3] = [0.3e6, 0.9e6, 3e6];

/// The true approach, gently damped until the rope is at rest: what a patient robot would release.
fn reach_from_rest_m(release_m: [f64; 2], young_pa: f64, lean_rad: f64) -> f64 {
    let task = SwingTask {
        dwell_s: 6.0,
        ..SwingTask::PAPER
    };
    let mut scene = Scene::swing(rope(0.25, 0.014), &task, release_m, &MotionLimits::PAPER, 1.5).unwrap();
    scene.settling = Some(Settling {
        until_s: scene.score_from_s,
        rate_per_s: 5.0,
        still_m_s: 0.0,
    });
    reach_m(&scene, young_pa, lean_rad)
}

/// How much further the quick, damped approach reaches than that.
fn off_m(release_m: [f64; 2], young_pa: f64, lean_rad: f64) -> f64 {
    let quick = Scene::swing_settled(rope(0.25, 0.014), &SwingTask::PAPER, release_m, 1.5).unwrap();
    let off_m = reach_m(&quick, young_pa, lean_rad) - reach_from_rest_m(release_m, young_pa, lean_rad);
    println!(
        "release {release_m:?}, E {young_pa:.1e} Pa: {:+.3} mm",
        1e3 * off_m
    );
    off_m
}

/// The policy's swings: in legs, single precision, and their rest by Newton's method.
#[test]
fn a_swing_of_the_policy_begins_at_the_rest_of_the_true_approach() {
    let swing = SimulatedSwing {
        rope: rope(0.25, 0.014),
        task: SwingTask::PAPER,
        structure: Structure::default(),
        effect_values: Vec::new(),
        resolution: Resolution { cells: 1.5 },
    };
    let check = |release_m: [f64; 2], young_pa: f64| {
        let reach_m = swing.reach_m(young_pa, POISSON, release_m).unwrap();
        let off_m = reach_m - reach_from_rest_m(release_m, young_pa, LEAN_RAD);
        println!(
            "release {release_m:?}, E {young_pa:.1e} Pa: {:+.3} mm",
            1e3 * off_m
        );
        assert!(off_m.abs() < 1e-4, "{release_m:?}, {young_pa}: {off_m}");
    };
    let check = &check;
    std::thread::scope(|scope| {
        for young_pa in YOUNG_PA {
            scope.spawn(move || RELEASES_M.map(|release_m| check(release_m, young_pa)));
        }
    });
}

/// A gripper that lags has arrived long before it opens, so the rope swings as without the lag. Seen: the rest was sought
/// where a lagged gripper stands just after its path has ended, and 0.1 s took 53 mm from the reach.
#[test]
fn a_gripper_that_lags_behind_its_path_releases_where_it_was_told_to() {
    let reach_m = |lag_s: Option<f64>, release_m| {
        let swing = SimulatedSwing {
            rope: rope(0.25, 0.014),
            task: SwingTask::PAPER,
            structure: lag_s.map_or(Structure::default(), |_| {
                Structure::of_ids(&["gripper_lag".into()])
            }),
            effect_values: lag_s.into_iter().collect(),
            resolution: Resolution { cells: 1.5 },
        };
        swing.reach_m(1e6, POISSON, release_m).unwrap()
    };
    for release_m in [[0.15, 0.15], [0.12, 0.2]] {
        let prompt_m = reach_m(None, release_m);
        // The slowest of the effect's range has not quite arrived when it opens.
        for (lag_s, tolerance_m) in [(0.03, 1e-4), (0.1, 1e-4), (0.3, 1e-3)] {
            let off_m = reach_m(Some(lag_s), release_m) - prompt_m;
            assert!(off_m.abs() < tolerance_m, "{release_m:?}, {lag_s} s: {off_m} m");
        }
    }
}
