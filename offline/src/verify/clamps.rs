//! Clamps: they neither hinge nor slip, carry the weight, and let go without a push.

use super::case::{Case, Of};
use super::reference::{Rod, heavy_elastica};
use super::setup::{DIAMETER_M, G_M_S2, SOFT_PA, elastic, knot, rope, scene, start_grip};
use super::{Extent, Findings, Stepper};
use crate::demo::RopeEnd;
use crate::sim::clamp::ClampPath;
use crate::sim::scene::{Grip, MIN_CELLS_PER_DIAMETER, Scene, Settling};
use crate::sim::{Rollout, SimError, simulate};
use nalgebra::{Matrix3, Vector3};

const FAMILY: Of = Of("clamp");
/// Rounding of some thousand steps.
const MACHINE: f64 = 1e-9;
/// The settled rope still moves by 1e-4 of what it did.
const AT_REST: f64 = 1e-3;
/// How far a held rope may creep out of its clamp in a second, m.
const SLIP_M: f64 = 1e-9;
/// How far the tip of a held rope may sink in a second, m: a hinge lets it fall by centimetres.
const SINK_M: f64 = 1e-6;

const FREE_M: f64 = 0.2;
const GRIP_M: f64 = 0.02;
const YOUNG_PA: f64 = 0.9e6;
/// How long a level rope has hung when its creep is asked for, s: what of the nodes' motion the particles do not see comes
/// to its rest over seconds. After 4 s it moved by 2.8e-9 m in a second, after 8 s by 9.4e-10, after 16 s by 8.2e-10: what
/// the last is made of is not known.
const HELD_S: f64 = 16.0;

pub(super) fn verify(_extent: Extent) -> Findings {
    let mut cases = FAMILY.each("held level", held_level());
    cases.extend(FAMILY.each("held at both ends", held_at_both_ends()));
    cases.extend(FAMILY.each("release of a bent rope", release_bent()));
    cases.extend(FAMILY.each("release in motion", release_in_motion()));
    cases.into()
}

/// Settles a scene until `settled_s` and shows it there and a second later.
fn settle(mut scene: Scene, settled_s: f64, slowest_rad_s: f64) -> Result<Rollout<f64>, SimError> {
    scene.settling = Some(Settling {
        until_s: settled_s + 1.0,
        rate_per_s: 2.0 * slowest_rad_s,
        still_m_s: 0.0,
    });
    scene.frame_times_s = vec![settled_s, settled_s + 1.0];
    scene.duration_s = settled_s + 1.0;
    simulate(&scene, &elastic(YOUNG_PA))
}

/// A rope clamped level: its slope at the clamp, its creep, and the force that the clamp bears.
fn held_level() -> Result<Vec<Case>, SimError> {
    let shape = rope(GRIP_M + FREE_M, DIAMETER_M);
    let grips = start_grip(GRIP_M, ClampPath::fixed([0.0; 3]));
    let scene = scene(shape, [1.0, 0.0, 0.0], grips, None, MIN_CELLS_PER_DIAMETER, 0.0)?;
    let cell_m = scene.grid.spacing_m;
    let rod = Rod::round(FREE_M, DIAMETER_M, YOUNG_PA);
    let rollout = settle(scene, HELD_S, 8.0)?;
    let at = |frame: usize, slice: usize| Vector3::from(rollout.frames[frame][slice]);
    // Slope of the centreline between the slices on both sides of the clamp's edge. There the springs
    // end, so the beam lies on an elastic foundation of length (4 EI/k)^¼ < 1 cell: its slope at the
    // edge is at most the clamp's curvature times a cell.
    let outside = rollout.arc_m.iter().position(|&s| s > GRIP_M).unwrap_or(1);
    let step = at(0, outside) - at(0, outside - 1);
    let hinge = (-step.z / step.x).atan();
    let bend = -heavy_elastica(&rod).clamp_curvature_per_m * cell_m;
    let slip = (0..outside)
        .map(|i| (at(1, i) - at(0, i)).norm())
        .fold(0.0, f64::max);
    let last = rollout.arc_m.len() - 1;
    let sink = (at(1, last) - at(0, last)).norm();
    let [x, y, z] = rollout.grip_forces_n[1][0];
    Ok(vec![
        FAMILY.at_most("no hinge: slope of a level rope at its clamp", "rad", hinge, bend),
        FAMILY.absolute("no hinge: tip sinks in 1 s", "m", [0.0, sink], SINK_M),
        FAMILY.absolute("no slip: clamped rope moves in 1 s", "m", [0.0, slip], SLIP_M),
        FAMILY.relative(
            "reaction at rest against the weight",
            "N",
            [shape.mass_kg * G_M_S2, z],
            AT_REST,
        ),
        FAMILY.absolute(
            "reaction at rest to the side",
            "N",
            [0.0, x.hypot(y)],
            AT_REST * shape.mass_kg * G_M_S2,
        ),
    ])
}

/// Both ends level at 0.8 of the length apart: the grips share the weight and pull against each other.
fn held_at_both_ends() -> Result<Vec<Case>, SimError> {
    let shape = rope(2.0 * GRIP_M + FREE_M, DIAMETER_M);
    let mut grips = start_grip(GRIP_M, ClampPath::fixed([0.0; 3]));
    let end = [shape.length_m, 0.0, 0.0];
    let near = [shape.length_m - 0.2 * FREE_M, 0.0, 0.0];
    grips.push(Grip {
        end: RopeEnd::End,
        length_m: GRIP_M,
        path: ClampPath::new(vec![
            knot(0.0, end, [0.0; 3], true),
            knot(0.4, near, [0.0; 3], true),
        ]),
    });
    let scene = scene(shape, [1.0, 0.0, 0.0], grips, None, 1.5, 0.0)?;
    let rollout = settle(scene, 2.0, 20.0)?;
    let [a, b] = [0, 1].map(|grip| rollout.grip_forces_n[1][grip]);
    let weight = shape.mass_kg * G_M_S2;
    Ok(vec![
        FAMILY.relative("two clamps share the weight", "N", [weight, a[2] + b[2]], AT_REST),
        FAMILY.absolute(
            "two clamps pull against each other",
            "N",
            [0.0, a[0] + b[0]],
            AT_REST * weight,
        ),
    ])
}

/// A rope bent by its weight is let go: whatever it does then, its momentum is that of free fall.
fn release_bent() -> Result<Vec<Case>, SimError> {
    let open_s = 0.5;
    let path = ClampPath::new(vec![
        knot(0.0, [0.0; 3], [0.0; 3], true),
        knot(open_s, [0.0; 3], [0.0; 3], false),
    ]);
    let grips = start_grip(GRIP_M, path);
    let shape = rope(GRIP_M + FREE_M, DIAMETER_M);
    let scene = scene(shape, [1.0, 0.0, 0.0], grips, None, 1.5, 0.0)?;
    let physics = elastic(YOUNG_PA);
    let mut run = Stepper::new(&scene, &physics);
    let held = (open_s / run.dt_s).ceil() as usize;
    run.advance_damped(held, 20.0)?;
    let before = run.velocity_m_s();
    run.advance(200)?;
    let fall = Vector3::new(0.0, 0.0, -G_M_S2) * (200.0 * run.dt_s);
    let impulse = (run.velocity_m_s() - before - fall).norm();
    Ok(vec![FAMILY.absolute(
        "impulse over mass of the release of a bent rope",
        "m/s",
        [0.0, impulse],
        MACHINE,
    )])
}

/// A rope and its clamp move at one speed without gravity; the clamp opens and nothing may change. The
/// path ends at the opening, between two steps.
fn release_in_motion() -> Result<Vec<Case>, SimError> {
    let (v, open_s) = (0.6, 0.0503);
    let path = ClampPath::new(vec![
        knot(0.0, [0.0; 3], [v, 0.0, 0.0], true),
        knot(open_s, [v * open_s, 0.0, 0.0], [v, 0.0, 0.0], false),
    ]);
    let shape = rope(GRIP_M + FREE_M, DIAMETER_M);
    let scene = scene(shape, [1.0, 0.0, 0.0], start_grip(GRIP_M, path), None, 1.5, 0.0)?;
    let mut physics = elastic(SOFT_PA);
    physics.gravity_m_s2 = [0.0; 3];
    let mut run = Stepper::new(&scene, &physics);
    let velocity = Vector3::new(v, 0.0, 0.0);
    run.set_motion(velocity, Matrix3::zeros());
    run.advance((2.0 * open_s / run.dt_s) as usize)?;
    let impulse = (run.velocity_m_s() - velocity).norm();
    Ok(vec![FAMILY.absolute(
        "impulse over mass of a release in motion",
        "m/s",
        [0.0, impulse],
        MACHINE,
    )])
}
