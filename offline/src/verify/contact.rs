//! The table and the air: sliding, rest and slide on a slope, fall with drag.

use super::case::{Case, Of};
use super::setup::{
    DIAMETER_M, G_M_S2, POISSON, SOFT_PA, elastic, free_scene, knot, rope, scene, start_grip, tip,
    with_effect,
};
use super::{Extent, Findings, Stepper};
use crate::sim::clamp::ClampPath;
use crate::sim::{Physics, SimError, simulate};
use nalgebra::{Matrix3, Vector3};

const FAMILY: Of = Of("contact");
/// The nodes' pushes add up to the weight, so Coulomb's deceleration is exact but for the step in which
/// the rope stops (2 μ g dt/v = 0.2 %) and the first steps in which the contact builds up.
const SLIDE: f64 = 0.01;
/// A rope that was dragged by its end is stretched and still moves in itself when let go.
const LET_GO: f64 = 0.05;
/// Diameters by which the rope's end reaches beyond the middle of its last slice, which is what touches: half
/// a tenth of a usual slice of 0.6 cells.
const END_BELOW: f64 = 0.02;
/// A millionth of a metre in 0.4 s on the slope.
const CREEP_M: f64 = 1e-6;
/// Linear drag is compared with the discrete scheme: rounding of some thousand steps.
const LINEAR_DRAG: f64 = 1e-9;
/// Quadratic drag is compared with the continuous solution; explicit steps of g dt/v∞ = 2e-4.
const QUADRATIC_DRAG: f64 = 1e-3;

pub(super) fn verify(_extent: Extent) -> Findings {
    let mut cases = Vec::new();
    for (name, direction) in [("lengthways", [1.0, 0.0, 0.0]), ("sideways", [0.0, 1.0, 0.0])] {
        cases.extend(FAMILY.each(name, sliding(name, direction)));
    }
    cases.extend(FAMILY.each("let go", let_go()));
    cases.extend(FAMILY.each("lift off", lift_off()));
    cases.extend(FAMILY.each("slope", slope()));
    cases.extend(FAMILY.each("drag", drag()));
    cases.into()
}

/// A rope at speed v on the table comes to rest after v²/(2 μ g).
fn sliding(name: &str, direction: [f64; 3]) -> Result<Vec<Case>, SimError> {
    let (v, friction) = (0.8, 0.4);
    let scene = free_scene(direction, Some(-0.5 * DIAMETER_M));
    let physics = Physics::base(SOFT_PA, POISSON, friction);
    let mut run = Stepper::new(&scene, &physics);
    let start = run.centre_m();
    run.set_motion(Vector3::new(v, 0.0, 0.0), Matrix3::zeros());
    run.advance((1.5 * v / (friction * G_M_S2) / run.dt_s) as usize)?;
    let way = run.centre_m() - start;
    let expected = v * v / (2.0 * friction * G_M_S2);
    let speed = run.velocity_m_s().norm();
    Ok(vec![
        FAMILY.relative(format!("sliding distance, {name}"), "m", [expected, way.x], SLIDE),
        FAMILY.absolute(format!("drift to the side, {name}"), "m", [0.0, way.y], CREEP_M),
        FAMILY.absolute(
            format!("speed after the stop, {name}"),
            "m/s",
            [0.0, speed],
            CREEP_M,
        ),
    ])
}

/// While a rope is lifted by its start, its end, the last to leave the table, stays on it however much it
/// tilts: the round end's centre is never nearer to the table than the radius.
fn lift_off() -> Result<Vec<Case>, SimError> {
    let end_s = 1.5;
    let path = ClampPath::new(vec![
        knot(0.0, [0.0; 3], [0.0; 3], true),
        knot(end_s, [0.0, 0.0, 0.3], [0.0; 3], true),
    ]);
    let grips = start_grip(0.02, path);
    let table_m = Some(-0.5 * DIAMETER_M);
    let shape = rope(0.25, DIAMETER_M);
    let mut scene = scene(shape, [1.0, 0.0, 0.0], grips, table_m, 1.5, end_s)?;
    scene.frame_times_s = (0..=75).map(|k| 0.02 * f64::from(k)).collect();
    let rollout = simulate(&scene, &elastic(SOFT_PA))?;
    let heights = rollout.frames.iter().map(|frame| tip(&scene, frame)[2]);
    let lowest_m = heights.fold(f64::INFINITY, f64::min);
    let tolerance_m = END_BELOW * DIAMETER_M;
    Ok(vec![FAMILY.absolute(
        "end of a rope that is lifted off, deepest",
        "m",
        [0.0, lowest_m],
        tolerance_m,
    )])
}

/// The gripper drags the rope over the table, its end 30 mm in hand, and opens while moving.
fn let_go() -> Result<Vec<Case>, SimError> {
    let (v, open_s) = (0.6, 0.3);
    let at = |t_s: f64, x: f64, speed: f64, closed| knot(t_s, [x, 0.0, 0.0], [speed, 0.0, 0.0], closed);
    let path = ClampPath::new(vec![
        at(0.0, 0.0, 0.0, true),
        at(0.2, 0.1 * v, v, true),
        at(open_s, 0.2 * v, v, false),
    ]);
    let mut scene = free_scene([1.0, 0.0, 0.0], Some(-0.5 * DIAMETER_M));
    scene.grips = start_grip(0.03, path);
    scene.frame_times_s = vec![open_s, 0.7];
    scene.duration_s = 0.7;
    let rollout = simulate(&scene, &elastic(SOFT_PA))?;
    let mean = |k: usize| {
        let frame: &Vec<[f64; 3]> = &rollout.frames[k];
        frame.iter().map(|p| p[0]).sum::<f64>() / frame.len() as f64
    };
    let pair = [v * v / (2.0 * 0.5 * G_M_S2), mean(1) - mean(0)];
    Ok(vec![FAMILY.relative(
        "slide after the gripper let go in motion",
        "m",
        pair,
        LET_GO,
    )])
}

/// On a slope of 0.25 rad (tan θ = 0.255) a rope rests with μ = 0.3 and slides with μ = 0.2.
fn slope() -> Result<Vec<Case>, SimError> {
    let slope = 0.25f64;
    let time_s = 0.4;
    let way = |friction: f64| -> Result<(f64, f64), SimError> {
        let physics = with_effect(
            "tilted_gravity",
            &[slope, 0.0],
            Physics::base(SOFT_PA, POISSON, friction),
        );
        let scene = free_scene([0.0, 1.0, 0.0], Some(-0.5 * DIAMETER_M));
        let mut run = Stepper::new(&scene, &physics);
        let start = run.centre_m();
        run.advance((time_s / run.dt_s) as usize)?;
        Ok((run.centre_m().x - start.x, run.now_s()))
    };
    let (rest, _) = way(0.3)?;
    let (slide, t) = way(0.2)?;
    let expected = 0.5 * G_M_S2 * (slope.sin() - 0.2 * slope.cos()) * t * t;
    Ok(vec![
        FAMILY.absolute(
            "creep on a slope with tan θ < μ, 0.4 s",
            "m",
            [0.0, rest],
            CREEP_M,
        ),
        FAMILY.relative(
            "slide down a slope with tan θ > μ, 0.4 s",
            "m",
            [expected, slide],
            SLIDE,
        ),
    ])
}

/// Linear drag step by step; quadratic drag: v = v∞ tanh(g t/v∞), and v∞ itself.
fn drag() -> Result<Vec<Case>, SimError> {
    let mut scene = free_scene([1.0, 0.0, 0.0], None);
    let rate = 4.0;
    let physics = with_effect("air_drag", &[0.0, 0.0, rate], elastic(SOFT_PA));
    let mut run = Stepper::new(&scene, &physics);
    let steps = 3000;
    run.advance(steps)?;
    let kept = 1.0 - rate * run.dt_s;
    let expected = G_M_S2 / rate * (1.0 - kept.powi(steps as i32));
    let linear = [expected, -run.velocity_m_s().z];

    // Foam, so that the terminal velocity stays below the speed that the step provides for.
    let (coefficient, air_kg_m3) = (2.0, 1.204);
    scene.rope.mass_kg = 100.0 * scene.rope.volume_m3();
    let per_length = 0.5 * air_kg_m3 * DIAMETER_M * coefficient;
    let last = (scene.rope.mass_kg / scene.rope.length_m * G_M_S2 / per_length).sqrt();
    let physics = with_effect("air_drag", &[coefficient, 0.0, 0.0], elastic(0.1 * SOFT_PA));
    let mut run = Stepper::new(&scene, &physics);
    let speed_at = |run: &mut Stepper<'_>, t_s: f64| -> Result<f64, SimError> {
        let left = t_s - run.now_s();
        run.advance((left / run.dt_s) as usize)?;
        Ok(-run.velocity_m_s().z)
    };
    let early = speed_at(&mut run, 0.5 * last / G_M_S2)?;
    let exact = last * (G_M_S2 * run.now_s() / last).tanh();
    // 1 − tanh 4.5 = 2e-4.
    let terminal = speed_at(&mut run, 4.5 * last / G_M_S2)?;
    Ok(vec![
        FAMILY.relative("speed of fall with linear drag", "m/s", linear, LINEAR_DRAG),
        FAMILY.relative(
            "speed of fall with quadratic drag",
            "m/s",
            [exact, early],
            QUADRATIC_DRAG,
        ),
        FAMILY.relative("terminal velocity", "m/s", [last, terminal], QUADRATIC_DRAG),
    ])
}
