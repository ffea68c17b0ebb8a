//! Free motion: fall, flight, momentum, energy.

use super::case::{Case, Of};
use super::setup::{G_M_S2, SOFT_PA, elastic, free_scene};
use super::study::Study;
use super::vibration::FreeBeam;
use super::{Extent, Findings, Stepper};
use crate::sim::{Scene, SimError, simulate};
use nalgebra::{Matrix3, Vector3};

const FAMILY: Of = Of("motion");
/// Rounding of some thousand steps of numbers of order one.
const MACHINE: f64 = 1e-12;
/// What carries velocities through the particles keeps angular momentum but for products of strains that vary
/// within a cell.
const ANGULAR: f64 = 0.01;
/// Energy that forgetting what particles do not carry may take from the first bending mode per period; ζ
/// is then below 0.4 %, a tenth of what ropes have.
const LOSS_PER_PERIOD: f64 = 0.05;

pub(super) fn verify(extent: Extent) -> Findings {
    let mut cases = FAMILY.each("free fall", free_fall());
    cases.extend(FAMILY.each("flight", flight()));
    cases.extend(FAMILY.each("turning rope", turning()));
    let (spacings, _) = Study::plan(extent);
    for &cells in spacings {
        cases.extend(FAMILY.each("energy", energy(cells)));
    }
    cases.into()
}

/// Symplectic Euler from rest: after n steps a point has fallen by g dt² n (n + 1)/2.
fn free_fall() -> Result<Vec<Case>, SimError> {
    let scene = free_scene([0.6, 0.0, 0.8], None);
    let frames = |times: Vec<f64>| Scene {
        frame_times_s: times,
        ..scene.clone()
    };
    let start = simulate(&frames(vec![0.0]), &elastic(SOFT_PA))?;
    let end = simulate(&scene, &elastic(SOFT_PA))?;
    let (n, dt) = (end.steps as f64, end.dt_s);
    // The frame is read at the scene's end, within the last step, along the velocity at its end.
    let fall = G_M_S2 * dt * dt * n * (n + 1.0) / 2.0 - G_M_S2 * n * dt * (n * dt - scene.duration_s);
    let mut worst = [0f64; 2];
    for (a, b) in start.frames[0].iter().zip(&end.frames[0]) {
        worst[0] = worst[0].max((a[2] - b[2] - fall).abs());
        worst[1] = worst[1].max((b[0] - a[0]).abs().max((b[1] - a[1]).abs()));
    }
    Ok(vec![
        FAMILY.absolute(
            "free fall in 0.3 s, worst point",
            "m",
            [fall, fall + worst[0]],
            MACHINE,
        ),
        FAMILY.absolute("free fall, drift to the side", "m", [0.0, worst[1]], MACHINE),
    ])
}

/// A thrown rope that turns and stretches: its centre flies the discrete parabola of a point.
fn flight() -> Result<Vec<Case>, SimError> {
    let (scene, physics) = (free_scene([1.0, 0.0, 0.0], None), elastic(SOFT_PA));
    let mut run = Stepper::new(&scene, &physics);
    let velocity = Vector3::new(0.7, -0.2, 1.5);
    run.set_motion(
        velocity,
        Matrix3::new(2.0, 5.0, -9.0, -5.0, 0.0, 1.0, 12.0, 0.0, 0.0),
    );
    let start = run.centre_m();
    run.advance(1000)?;
    let (t, fall) = (run.now_s(), Vector3::new(0.0, 0.0, -G_M_S2));
    let expected = start + velocity * t + fall * (0.5 * t * (t + run.dt_s));
    let off = |a: Vector3<f64>, b: Vector3<f64>| (a - b).norm();
    let (way, momentum) = (
        off(run.centre_m(), expected),
        off(run.velocity_m_s(), velocity + fall * t) * run.mass_kg(),
    );
    Ok(vec![
        FAMILY.absolute(
            "centre of a thrown, turning rope, off its parabola",
            "m",
            [0.0, way],
            MACHINE,
        ),
        FAMILY.absolute(
            "momentum in flight, off m (v + g t)",
            "kg m/s",
            [0.0, momentum],
            MACHINE,
        ),
    ])
}

/// One turn without gravity.
fn turning() -> Result<Vec<Case>, SimError> {
    let scene = free_scene([1.0, 0.0, 0.0], None);
    let mut physics = elastic(SOFT_PA);
    physics.gravity_m_s2 = [0.0; 3];
    let mut run = Stepper::new(&scene, &physics);
    let turn = Vector3::new(1.0, 8.0, 6.0);
    run.set_motion(Vector3::zeros(), turn.cross_matrix());
    let momentum = run.angular_momentum();
    run.advance((std::f64::consts::TAU / turn.norm() / run.dt_s) as usize)?;
    let change = (run.angular_momentum() - momentum).norm() / momentum.norm();
    let speed = run.velocity_m_s().norm();
    Ok(vec![
        FAMILY.absolute(
            "angular momentum, change in one turn",
            "1",
            [0.0, change],
            ANGULAR,
        ),
        FAMILY.absolute(
            "linear momentum over mass, change in one turn",
            "m/s",
            [0.0, speed],
            MACHINE,
        ),
    ])
}

/// Energy of the first bending mode over three periods, of a material without loss.
fn energy(cells: f64) -> Result<Vec<Case>, SimError> {
    let beam = FreeBeam::new(0);
    let (scene, mut physics) = (beam.scene(cells, [0.0; 3])?, beam.physics());
    physics.loss = 0.0;
    let mut run = beam.excited(&scene, &physics);
    let start = run.energy_of_step_j()?;
    let steps = (beam.period_s() / run.dt_s).round() as usize;
    const PERIODS: usize = 3;
    let (mut most, mut last) = (start, start);
    for _ in 0..PERIODS * 20 {
        run.advance(steps / 20 - 1)?;
        last = run.energy_of_step_j()?;
        most = most.max(last);
    }
    let loss = 1.0 - (last / start).powf(1.0 / PERIODS as f64);
    let rise = std::f64::consts::TAU * run.dt_s / beam.period_s();
    let name = |what: &str| format!("energy without damping, {what}, {cells:.1} cells");
    Ok(vec![
        FAMILY.at_most(name("largest rise"), "1", most / start - 1.0, rise),
        FAMILY.at_most(name("loss per period"), "1", loss, LOSS_PER_PERIOD),
    ])
}
