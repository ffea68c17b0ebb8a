//! The simulator steps many particles at a time; its readable twin steps one after the other. Both are
//! held against each other: a lift through contact and friction, a swing through release, every law, and
//! every tangent.

use offline::demo::{
    ClampSample, Demo, DemoSpec, MarkerSample, Observations, RopeEnd, SceneKind, StartState,
};
use offline::effects;
use offline::fit::flows;
use offline::sim::clamp::ClampPath;
use offline::sim::rollout::simulate_one_by_one;
use offline::sim::rope::RopeShape;
use offline::sim::scene::{Grip, Scene, StepLength, Table};
use offline::sim::start::Start;
use offline::sim::tensor::{norm, sub, value3};
use offline::sim::{Arithmetic, Cause, Dual, Laned, Physics, Real, Rollout, simulate};
use offline::verify::setup::{DIAMETER_M, rope};
use shared::task::SwingTask;
use tests::derivatives::LANES;

fn paper_rope() -> RopeShape {
    rope(0.25, DIAMETER_M)
}

/// The start of a lying rope is lifted, turned and moved sideways.
fn lift(cells: f64) -> Scene {
    lift_seen(cells, vec![0.03, 0.07, 0.12])
}

/// The same, recorded at these times, s.
fn lift_seen(cells: f64, times_s: Vec<f64>) -> Scene {
    let pose = |t: f64| {
        let angle = 2.0 * t;
        [0.0, 0.3 * t, 0.007 + 0.4 * t, 0.0, 0.0, angle.sin(), angle.cos()]
    };
    let samples: Vec<_> = (0..=12)
        .map(|i| 0.01 * f64::from(i))
        .map(|t| (t, pose(t), true))
        .collect();
    let grips = vec![Grip {
        end: RopeEnd::Start,
        length_m: 0.02,
        path: ClampPath::from_samples(&samples),
    }];
    let table = Some(Table { height_m: 0.0 });
    Scene::new(
        paper_rope(),
        [0.0, 0.0, 0.007],
        [1.0, 0.0, 0.0],
        grips,
        table,
        cells,
        times_s,
    )
    .unwrap()
}

/// A rope that is carried along and turns downwards when it is first seen.
fn in_motion() -> Scene {
    let seen = |t: f64, s: f64| [s + 0.4 * t, 0.2 * t, 1.0 - 0.3 * t - 4.0 * s * t];
    let times_s = [0.0, 0.02, 0.04];
    let clamp = times_s.map(|t_s| ClampSample {
        t_s,
        position_m: seen(t_s, 0.0),
        quaternion_xyzw: [0.0, 0.0, 0.0, 1.0],
        closed: true,
    });
    let markers = times_s.iter().flat_map(|&t_s| {
        [0.1, 0.17, 0.25].map(|s_m| MarkerSample {
            t_s,
            marker: format!("{s_m}"),
            s_m,
            position_m: seen(t_s, s_m),
        })
    });
    let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/../offline/demos/sample-rope/fit");
    let mut demo = Demo::load(shipped).unwrap();
    demo.spec = DemoSpec {
        scene: SceneKind::Free,
        start: StartState::Moving,
        table: None,
        cameras: Vec::new(),
        ..demo.spec
    };
    demo.clamps = vec![clamp.to_vec()];
    demo.observations = Observations::Markers(markers.collect());
    Scene::of_demo(&demo, 1.5).unwrap()
}

/// Every effect, at a tenth of its range, or all of it where less would make little flow beside a clamp that gives;
/// `value` makes a number from the index of the input and its value.
fn with_every_effect<T: Real>(value: impl FnMut(usize, f64) -> T) -> Physics<T> {
    with_effects(0..effects::ALL.len(), value)
}

fn with_effects<T: Real>(
    effects: impl IntoIterator<Item = usize>,
    mut value: impl FnMut(usize, f64) -> T,
) -> Physics<T> {
    let mut physics = Physics::base(value(0, 4.0e5), value(1, 0.3), value(2, 0.4));
    let mut input = 3;
    for index in effects {
        let share = if flows(index) { 1.0 } else { 0.1 };
        let effect = &effects::ALL[index];
        let values: Vec<T> = effect
            .parameters
            .iter()
            .map(|p| {
                input += 1;
                value(input - 1, p.vanishes_at + share * (p.high - p.vanishes_at))
            })
            .collect();
        effects::add_to(index, &values, &mut physics);
    }
    physics
}

/// Largest distance of any recorded points, m.
fn apart<T: Real>(a: &Rollout<T>, b: &Rollout<T>) -> f64 {
    assert_eq!((a.steps, a.frames.len()), (b.steps, b.frames.len()));
    let mut largest = 0.0f64;
    for (p, q) in a.frames.iter().flatten().zip(b.frames.iter().flatten()) {
        let (p, q) = (value3(*p), value3(*q));
        for k in 0..3 {
            largest = largest.max((p[k] - q[k]).abs());
            assert!(p[k].is_finite() && q[k].is_finite());
        }
    }
    largest
}

/// How far the tangents in one lane differ at most, and how large they are.
fn tangents_apart<const N: usize>(
    fast: &Rollout<Dual<f64, N>>,
    slow: &Rollout<Dual<f64, N>>,
    lane: usize,
) -> (f64, f64) {
    let (mut largest, mut size) = (0.0f64, 0.0f64);
    for (p, q) in fast.frames.iter().flatten().zip(slow.frames.iter().flatten()) {
        for k in 0..3 {
            let [p, q] = [p[k], q[k]].map(|x| x.tangent[lane]);
            largest = largest.max((p - q).abs());
            size = size.max(q.abs());
        }
    }
    (largest, size)
}

fn both<T: Laned>(scene: &Scene, physics: &Physics<T>) -> [Rollout<T>; 2] {
    [
        simulate(scene, physics).unwrap(),
        simulate_one_by_one(scene, physics).unwrap(),
    ]
}

#[test]
fn a_lift_with_every_effect_is_the_same() {
    for cells in [1.5, 1.792, 2.6] {
        let scene = lift(cells);
        let [fast, slow] = both(&scene, &with_every_effect(|_, v| v));
        let double = apart(&fast, &slow);
        let [fast, slow] = both(&scene, &with_every_effect(|_, v| v as f32));
        let single = apart(&fast, &slow);
        println!("{cells} cells: {double:.1e} m in double, {single:.1e} m in single precision");
        assert!(double < 1e-11, "{double}");
        assert!(single < 2e-5, "{single}");
    }
}

/// It was a step ahead: 0.2 mm at 1 m/s.
#[test]
fn a_rope_first_seen_in_motion_begins_where_it_was_seen() {
    let scene = in_motion();
    let Start::Moving(hang) = &scene.start else {
        panic!("it moves")
    };
    let still = Scene {
        start: Start::Poses(hang.clone()),
        ..scene.clone()
    };
    let physics = Physics::base(4.0e5, 0.3, 0.4);
    let [moving, still] = [&scene, &still].map(|scene| simulate(scene, &physics).unwrap());
    for (a, b) in moving.frames[0].iter().zip(&still.frames[0]) {
        let apart_m: f64 = norm(sub(*a, *b));
        assert!(apart_m < 1e-6, "{apart_m} m");
    }
}

#[test]
fn a_rope_first_seen_in_motion_is_the_same() {
    let scene = in_motion();
    let [fast, slow] = both(&scene, &Physics::<f64>::base(2.0e6, 0.3, 0.4));
    let falls = |rollout: &Rollout<f64>| {
        let tip = |frame: usize| *rollout.frames[frame].last().unwrap();
        (tip(1)[2] - tip(0)[2]) / 0.02
    };
    let double = apart(&fast, &slow);
    println!("{double:.1e} m; the tip falls at {} m/s", falls(&fast));
    assert!(double < 1e-11, "{double}");
    // 0.3 m/s with the clamp, 1 m/s by the turn, 0.1 m/s by gravity.
    assert!((falls(&fast) + 1.4).abs() < 0.2, "{}", falls(&fast));
    let input = |value: f64| Dual::<f64, 1>::input(value, 0);
    let [fast, slow] = both(&scene, &Physics::base(input(2.0e6), Dual::of(0.3), Dual::of(0.4)));
    let (largest, size) = tangents_apart(&fast, &slow, 0);
    assert!(size > 0.0 && largest <= 1e-8 * size, "{largest} of {size}");
}

/// Otherwise the comparison says nothing of plastic flow.
#[test]
fn that_lift_bends_the_rope_for_good() {
    let (scene, elastic) = (lift(1.5), (0..effects::ALL.len()).filter(|&index| !flows(index)));
    let stays = simulate(&scene, &with_effects(elastic, |_, v| v)).unwrap();
    let gives = simulate(&scene, &with_every_effect(|_, v| v)).unwrap();
    assert!(apart(&stays, &gives) > 1e-3);
}

#[test]
fn a_swing_reaches_the_same_point() {
    let scene = Scene::swing_settled(paper_rope(), &SwingTask::PAPER, [0.12, 0.12], 1.5).unwrap();
    let mut physics = Physics::<f64>::base(4.0e5, 0.3, 0.5);
    physics.gravity_m_s2[1] = 0.01;
    let [fast, slow] = both(&scene, &physics).map(|rollout| rollout.reach_m.unwrap());
    println!("{fast} against {slow}");
    assert!((fast - slow).abs() < 1e-9);
}

#[test]
fn every_tangent_is_the_same() {
    let mut inputs = 0;
    with_every_effect(|k, v| {
        inputs = inputs.max(k + 1);
        v
    });
    for first in (0..inputs).step_by(LANES) {
        let physics = with_every_effect(|k, v| {
            if (first..first + LANES).contains(&k) {
                Dual::<f64, LANES>::input(v, k - first)
            } else {
                Dual::of(v)
            }
        });
        let [fast, slow] = both(&lift_seen(1.5, vec![0.03, 0.06]), &physics);
        for input in first..inputs.min(first + LANES) {
            let (largest, size) = tangents_apart(&fast, &slow, input - first);
            println!("input {input}: tangents up to {size:.2e} agree to {largest:.1e}");
            assert!(largest <= 1e-8 * size, "input {input}: {largest} of {size}");
        }
    }
}

/// At this stiffness the longest step depends on E. With a step that the caller fixes, the tangent is the
/// derivative of what is simulated.
#[test]
fn a_fixed_step_makes_the_tangent_exact() {
    let mut scene = lift(1.5);
    scene.step = StepLength::Fixed(5e-5);
    let run = |young_pa: f64| simulate(&scene, &Physics::base(young_pa, 0.3, 0.4)).unwrap();
    let tangent = simulate(
        &scene,
        &Physics::base(Dual::<f64, 1>::input(2.0e6, 0), Dual::of(0.3), Dual::of(0.4)),
    )
    .unwrap();
    let h = 1.0;
    let (plus, minus) = (run(2.0e6 + h), run(2.0e6 - h));
    let (mut largest, mut size) = (0.0f64, 0.0f64);
    for (s, slice) in tangent.frames[0].iter().enumerate() {
        for k in 0..3 {
            let difference = (plus.frames[0][s][k] - minus.frames[0][s][k]) / (2.0 * h);
            largest = largest.max((slice[k].tangent[0] - difference).abs());
            size = size.max(difference.abs());
        }
    }
    println!("tangents up to {size:.2e} m/Pa, off by {largest:.1e}");
    assert!(largest < 1e-4 * size, "{largest} of {size}");
}

#[test]
fn a_fixed_step_that_is_not_stable_is_refused() {
    let mut scene = lift(1.5);
    scene.step = StepLength::Fixed(1e-3);
    let error = simulate(&scene, &Physics::base(2.0e6, 0.3, 0.4)).unwrap_err();
    assert!(matches!(error.cause, Cause::StepTooLong { .. }), "{error}");
    scene.step = StepLength::Fixed(f64::NAN);
    assert!(simulate(&scene, &Physics::base(2.0e6, 0.3, 0.4)).is_err());
}
