//! Stops: what ends a rollout or refuses to begin it, produced by a scene that deserves it, with its step, particle and
//! time.

use super::case::{Case, Of};
use super::setup::{
    DIAMETER_M, G_M_S2, POISSON, SOFT_PA, elastic, free_scene, knot, rope, start_grip, with_effect,
};
use super::{Extent, Findings};
use crate::demo::RopeEnd;
use crate::sim::clamp::ClampPath;
use crate::sim::scene::{Grip, Scene, Settling};
use crate::sim::{Cause, Physics, SimError, simulate};
use shared::task::SwingTask;

const FAMILY: Of = Of("stops");
const LEVEL: [f64; 3] = [1.0, 0.0, 0.0];

pub(super) fn verify(_extent: Extent) -> Findings {
    let mut cases = vec![too_thin(), unreachable(), unreachable_release(), too_long()];
    cases.extend([bent_at_rest(), collapses(), too_fast(), inverted(), not_finite()]);
    cases.extend(bad_parameters());
    cases.extend(bad_scenes());
    cases.into()
}

/// A case that holds where the stop is the one wanted.
fn stops(name: &str, result: Result<(), SimError>, wanted: impl Fn(&SimError) -> bool) -> Case {
    match result {
        Ok(()) => FAMILY.holds(format!("{name}: did not stop"), false),
        Err(error) if wanted(&error) => FAMILY.holds(name, true),
        Err(error) => FAMILY.stopped(format!("{name}: another cause"), &error),
    }
}

fn built(grips: Vec<Grip>, cells: f64) -> Result<Scene, SimError> {
    Scene::new(
        rope(0.2, DIAMETER_M),
        [0.0; 3],
        LEVEL,
        grips,
        None,
        cells,
        vec![0.2],
    )
}

fn run(scene: &Scene, physics: &Physics<f64>) -> Result<(), SimError> {
    simulate(scene, physics).map(|_| ())
}

fn too_thin() -> Case {
    stops(
        "rope of 1.2 cells: too thin",
        built(vec![], 1.2).map(|_| ()),
        |e| e.cause == Cause::TooThin { cells: 1.2 } && e.step == 0,
    )
}

/// Two grips that move 0.1 m further apart than the rope is long.
fn unreachable() -> Case {
    let mut grips = start_grip(0.02, ClampPath::fixed([0.0; 3]));
    grips.push(Grip {
        end: RopeEnd::End,
        length_m: 0.02,
        path: ClampPath::new(vec![
            knot(0.0, [0.2, 0.0, 0.0], [0.0; 3], true),
            knot(0.5, [0.3, 0.0, 0.0], [0.0; 3], true),
        ]),
    });
    stops(
        "grips too far apart: unreachable",
        built(grips, 1.5).map(|_| ()),
        |e| matches!(e.cause, Cause::Unreachable { t_s, .. } if t_s == 0.5),
    )
}

fn unreachable_release() -> Case {
    let scene = Scene::swing_settled(rope(0.15, DIAMETER_M), &SwingTask::PAPER, [0.05, 0.025], 1.5);
    stops(
        "release out of the rope's reach: unreachable",
        scene.map(|_| ()),
        |e| matches!(e.cause, Cause::Unreachable { .. }),
    )
}

/// Three hours of a stiff rope, whose step is a hundred thousandth of a second's.
fn too_long() -> Case {
    let mut scene = free_scene(LEVEL, None);
    scene.duration_s = 1e4;
    stops(
        "three hours of a stiff rope: too long",
        run(&scene, &elastic(4e7)),
        |e| matches!(e.cause, Cause::TooLong { steps, particles } if steps > 1e8 && particles > 0),
    )
}

/// A rope as thick as a wrist that is curled at rest with a radius of less than twice its own.
fn bent_at_rest() -> Case {
    let scene = Scene::new(rope(0.6, 0.06), [0.0; 3], LEVEL, vec![], None, 1.5, vec![0.1]);
    let physics = with_effect("rest_curvature", &[18.0, 0.0], elastic(SOFT_PA));
    stops(
        "thick rope curled at rest: bent too much",
        scene.and_then(|scene| run(&scene, &physics)),
        |e| matches!(e.cause, Cause::BentAtRest { volume } if volume > 0.0 && volume < 0.6) && e.step == 0,
    )
}

/// A rope of jelly held at both ends, one below the other: its weight is three times what would shorten its
/// lower half to nothing.
fn collapses() -> Case {
    let shape = rope(0.4, DIAMETER_M);
    let down = [0.0, 0.0, -1.0];
    let mut grips = start_grip(0.02, ClampPath::fixed([0.0; 3]));
    grips.push(Grip {
        end: RopeEnd::End,
        length_m: 0.02,
        path: ClampPath::fixed([0.0, 0.0, -shape.length_m]),
    });
    let scene = Scene::new(shape, [0.0; 3], down, grips, None, 1.5, vec![0.1]);
    let young_pa = shape.density_kg_m3() * G_M_S2 * 0.36 / 6.0;
    stops(
        "rope of jelly between two grips: collapses",
        scene.and_then(|scene| run(&scene, &elastic(young_pa))),
        |e| matches!(e.cause, Cause::Collapses { strain } if (strain - 3.0).abs() < 1e-9) && e.step == 0,
    )
}

/// Free fall for 30 s: nothing but the speed is wrong.
fn too_fast() -> Case {
    let mut scene = free_scene(LEVEL, None);
    scene.duration_s = 30.0;
    stops(
        "free fall for 30 s: too fast (CFL)",
        run(&scene, &elastic(SOFT_PA)),
        |e| {
            matches!(e.cause, Cause::TooFast { speed_m_s, .. } if speed_m_s > 10.0)
                && e.step > 0
                && e.t_s > 1.0
        },
    )
}

/// A grip thrown through the rope that it holds, at 60 m/s.
fn inverted() -> Case {
    let path = ClampPath::new(vec![
        knot(0.0, [0.0; 3], [0.0; 3], true),
        knot(0.004, [0.12, 0.0, 0.0], [60.0, 0.0, 0.0], true),
    ]);
    let scene = built(start_grip(0.02, path), 1.5);
    let result = scene.and_then(|scene| run(&scene, &elastic(SOFT_PA)));
    stops("grip driven into its rope: inverted", result, |e| {
        matches!(e.cause, Cause::Inverted { det, .. } if det <= 0.0) && e.step > 0
    })
}

fn not_finite() -> Case {
    let drag = with_effect("air_drag", &[0.0, 0.0, f64::NAN], elastic(SOFT_PA));
    stops(
        "drag of NaN: not finite",
        run(&free_scene(LEVEL, None), &drag),
        |e| matches!(e.cause, Cause::NonFinite { .. }),
    )
}

fn names(name: &'static str) -> impl Fn(&SimError) -> bool {
    move |e| matches!(e.cause, Cause::BadParameter { name: n, .. } if n == name) && e.step == 0
}

fn bad_parameters() -> Vec<Case> {
    let scene = free_scene(LEVEL, None);
    let gravity = {
        let mut physics = elastic(SOFT_PA);
        physics.gravity_m_s2[2] = f64::NAN;
        physics
    };
    [
        ("E = NaN", Physics::base(f64::NAN, POISSON, 0.5), "young_pa"),
        ("E < 0", Physics::base(-1.0, POISSON, 0.5), "young_pa"),
        ("ν = NaN", Physics::base(SOFT_PA, f64::NAN, 0.5), "poisson"),
        ("ν = ½", Physics::base(SOFT_PA, 0.5, 0.5), "poisson"),
        ("μ = NaN", Physics::base(SOFT_PA, POISSON, f64::NAN), "friction"),
        ("μ < 0", Physics::base(SOFT_PA, POISSON, -0.1), "friction"),
        ("gravity NaN", gravity, "gravity_m_s2"),
    ]
    .into_iter()
    .map(|(what, physics, name)| {
        stops(
            &format!("{what}: bad parameter"),
            run(&scene, &physics),
            names(name),
        )
    })
    .collect()
}

fn bad_scenes() -> Vec<Case> {
    let with = |change: &dyn Fn(&mut Scene)| {
        let mut scene = free_scene(LEVEL, None);
        change(&mut scene);
        run(&scene, &elastic(SOFT_PA))
    };
    let gripped = |knots| {
        let mut scene = free_scene(LEVEL, None);
        scene.grips = start_grip(0.02, ClampPath::new(knots));
        run(&scene, &elastic(SOFT_PA))
    };
    let still = |t_s: f64, x: f64| knot(t_s, [x, 0.0, 0.0], [0.0; 3], true);
    [
        ("mass of 0", with(&|s| s.rope.mass_kg = 0.0), "rope.mass_kg"),
        (
            "length of NaN",
            with(&|s| s.rope.length_m = f64::NAN),
            "rope.length_m",
        ),
        (
            "direction of length 2",
            with(&|s| s.direction = [2.0, 0.0, 0.0]),
            "norm of direction",
        ),
        (
            "endless time",
            with(&|s| s.duration_s = f64::INFINITY),
            "duration_s",
        ),
        (
            "frame after the end",
            with(&|s| s.frame_times_s = vec![9.0]),
            "frame_times_s",
        ),
        (
            "settling at a rate of NaN",
            with(&|s| {
                s.settling = Some(Settling {
                    until_s: 0.1,
                    rate_per_s: f64::NAN,
                    still_m_s: 0.0,
                });
            }),
            "settling.rate_per_s",
        ),
        (
            "knots out of order",
            gripped(vec![still(0.0, 0.0), still(0.0, 0.0)]),
            "knot.t_s",
        ),
        (
            "knot at NaN",
            gripped(vec![still(0.0, f64::NAN)]),
            "knot.pose or knot.rate",
        ),
    ]
    .into_iter()
    .map(|(what, result, name)| stops(&format!("{what}: bad parameter"), result, names(name)))
    .collect()
}
