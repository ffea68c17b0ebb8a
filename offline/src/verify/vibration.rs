//! Vibration: the first two bending modes of a free rod, from which the bending stiffness follows, and
//! the pendulum of a soft rope.

use super::case::{Case, Of};
use super::reference::{Hold, Mode, Rod, bending_mode};
use super::setup::{DIAMETER_M, G_M_S2, elastic, rope, scene, start_grip};
use super::study::{Study, on_grid};
use super::{Extent, Findings, Stepper};
use crate::sim::clamp::ClampPath;
use crate::sim::scene::MIN_CELLS_PER_DIAMETER;
use crate::sim::{Physics, Scene, SimError};
use nalgebra::Vector3;

const FAMILY: Of = Of("vibration");
/// The bending stiffness that the program promises; stiffness goes with the square of a frequency.
const STIFFNESS: f64 = 0.05;
/// The swing's period decides the reach; 2 % of it is what 4 % of the stiffness do to a stiff rope.
const PENDULUM: f64 = 0.02;
/// Bending between nodes is exact for quadratic fields, so the error is of second order; half an order
/// is left for the change of the number of particles from grid to grid.
const INTERIOR_ORDER: f64 = 1.5;
/// A clamp's edge is found to a share of a cell: first order, with the same allowance.
const CLAMPED_ORDER: f64 = 0.5;

/// Spacings of the study of stiffness, in cells across the rope.
const THICKNESSES: [f64; 6] = [1.0, 1.25, 1.5, 2.0, 2.5, 3.0];

pub(super) fn verify(extent: Extent) -> Findings {
    let mut found = Findings::default();
    for number in 0..2 {
        let name = format!("bending stiffness, mode {}", number + 1);
        match stiffness(&name, number, extent) {
            Ok(study) => {
                found.cases.extend(stiffness_cases(&study));
                found.studies.push(study);
            }
            Err(error) => found.cases.push(FAMILY.stopped(name, &error)),
        }
    }
    match pendulum(extent) {
        Ok(study) => {
            found.cases.extend(study.cases(FAMILY, PENDULUM, CLAMPED_ORDER));
            found.studies.push(study);
        }
        Err(error) => found.cases.push(FAMILY.stopped("pendulum", &error)),
    }
    found
}

/// A straight rod without weight and without support.
pub(super) struct FreeBeam {
    rod: Rod,
    mode: Mode,
}

/// Slender enough that shear takes a few percent, which the reference knows.
const BEAM_LENGTH_M: f64 = 20.0 * DIAMETER_M;
const BEAM_YOUNG_PA: f64 = 2e6;
/// Roots of cos βL cosh βL = 1.
const FREE_ROOTS: [f64; 2] = [4.730_041, 7.853_205];
/// Largest deflection of the vibration, in diameters.
const AMPLITUDE_DIAMETERS: f64 = 0.01;

impl FreeBeam {
    /// The beam in its bending mode 0 or 1.
    pub(super) fn new(number: usize) -> Self {
        let rod = Rod::round(BEAM_LENGTH_M, DIAMETER_M, BEAM_YOUNG_PA);
        let wave = (FREE_ROOTS[number] / rod.length_m).powi(2);
        let mode = bending_mode(&rod, Hold::Free, wave * (rod.bending_n_m2 / rod.mass_kg_m).sqrt());
        Self { rod, mode }
    }

    pub(super) fn scene(&self, cells: f64, shift_cells: [f64; 3]) -> Result<Scene, SimError> {
        let shape = rope(self.rod.length_m, DIAMETER_M);
        let scene = scene(shape, [1.0, 0.0, 0.0], vec![], None, 1.5, 0.0)?;
        Ok(on_grid(scene, cells, shift_cells))
    }

    pub(super) fn physics(&self) -> Physics<f64> {
        let mut physics = elastic(BEAM_YOUNG_PA);
        physics.gravity_m_s2 = [0.0; 3];
        physics
    }

    pub(super) fn period_s(&self) -> f64 {
        std::f64::consts::TAU / self.mode.omega_rad_s
    }

    /// The straight beam with the velocities of its mode: w across, −θ up along.
    pub(super) fn excited<'a>(&self, scene: &'a Scene, physics: &'a Physics<f64>) -> Stepper<'a> {
        let mut run = Stepper::new(scene, physics);
        excite(&mut run, &self.mode, 0.0);
        run
    }
}

/// Adds a mode's velocities to the undeformed rope from the arc length `from_m` on.
fn excite(run: &mut Stepper<'_>, mode: &Mode, from_m: f64) {
    let speed = AMPLITUDE_DIAMETERS * DIAMETER_M * mode.omega_rad_s;
    run.set_material_motion(|at| {
        let [w, turn] = if at.x > from_m {
            mode.at(at.x - from_m)
        } else {
            [0.0; 2]
        };
        Vector3::new(-turn * at.z, 0.0, w) * speed
    });
}

/// Angular frequency of a mode's share in the motion, from its zero crossings over `halves` half
/// periods. `up` is the material's direction of vibration in the world.
fn frequency(
    run: &mut Stepper<'_>,
    mode: &Mode,
    from_m: f64,
    up: Vector3<f64>,
    halves: usize,
) -> Result<f64, SimError> {
    let rest = run.centreline_m();
    let slices = run.layout.slices.clone();
    let share = |run: &Stepper<'_>| -> f64 {
        let moved = run.centreline_m();
        let parts = moved
            .iter()
            .zip(&rest)
            .zip(&slices)
            .filter(|(_, s)| s.arc_m > from_m);
        parts
            .map(|((now, then), s)| (now - then).dot(&up) * mode.at(s.arc_m - from_m)[0] * s.length_m)
            .sum()
    };
    // Every 1/60 of a period: zero crossings between samples are found by a line, whose error is the
    // cube of the phase step.
    let every = ((std::f64::consts::TAU / mode.omega_rad_s / run.dt_s / 60.0) as usize).max(1);
    let (mut crossings, mut before): (Vec<f64>, f64) = (Vec::new(), 0.0);
    let longest = 60 * (halves + 2) / 2;
    for _ in 0..2 * longest {
        run.advance(every)?;
        let now = share(run);
        if before != 0.0 && before.signum() != now.signum() {
            let late = now / (now - before) * every as f64 * run.dt_s;
            crossings.push(run.now_s() - late);
        }
        before = now;
        if crossings.len() > halves {
            break;
        }
    }
    let passed = crossings.len().saturating_sub(1) as f64;
    let span = crossings.last().copied().unwrap_or(f64::NAN) - crossings.first().copied().unwrap_or(0.0);
    Ok(std::f64::consts::PI * passed / span)
}

/// Bending stiffness over the exact one, from the frequency of a free beam.
fn stiffness(name: &str, number: usize, extent: Extent) -> Result<Study, SimError> {
    let beam = FreeBeam::new(number);
    let (mut spacings, alignments) = Study::plan(extent);
    if extent == Extent::Full {
        spacings = &THICKNESSES;
    }
    Study::run(name, "of exact", 1.0, spacings, alignments, |cells, shift| {
        let (scene, physics) = (beam.scene(cells, shift)?, beam.physics());
        let mut run = beam.excited(&scene, &physics);
        let omega = frequency(&mut run, &beam.mode, 0.0, Vector3::z(), 4)?;
        Ok((omega / beam.mode.omega_rad_s).powi(2))
    })
}

/// The program's own spacing and finer ones must be within the promise, wherever the grid lies; and the
/// thickness from which on they are is the one by which the program chooses its spacing.
fn stiffness_cases(study: &Study) -> Vec<Case> {
    let mut promised = study.clone();
    promised.points.retain(|p| p.cells >= MIN_CELLS_PER_DIAMETER);
    let mut cases = promised.cases(FAMILY, STIFFNESS, INTERIOR_ORDER);
    if study.points.len() > 1 {
        let coarse = study
            .spacings()
            .into_iter()
            .filter(|&c| study.worst(c) > STIFFNESS);
        let first = coarse.fold(0.0, f64::max);
        let least = study
            .spacings()
            .into_iter()
            .filter(|&c| c > first)
            .fold(f64::INFINITY, f64::min);
        let name = format!("{}, cells from which on it is within 5 %", study.name);
        cases.push(FAMILY.at_most(name, "1", least, MIN_CELLS_PER_DIAMETER));
    }
    cases
}

/// A soft rope hanging from a clamp swings; the exact period knows its bending and its stretch.
fn pendulum(extent: Extent) -> Result<Study, SimError> {
    const GRIP_M: f64 = 0.02;
    let length_m = 30.0 * DIAMETER_M;
    // One percent of stretch at the top.
    let young_pa = 100.0 * super::setup::DENSITY_KG_M3 * G_M_S2 * length_m;
    let rod = Rod::round(length_m, DIAMETER_M, young_pa);
    let chain = 0.5 * 2.404_826 * (G_M_S2 / length_m).sqrt();
    let mode = bending_mode(&rod, Hold::HangingClamped, 1.3 * chain);
    let (spacings, alignments) = Study::plan(extent);
    let period_s = std::f64::consts::TAU / mode.omega_rad_s;
    Study::run(
        "pendulum period of a soft rope",
        "s",
        period_s,
        spacings,
        alignments,
        |cells, shift| {
            let shape = rope(GRIP_M + length_m, DIAMETER_M);
            let grips = start_grip(GRIP_M, ClampPath::fixed([0.0; 3]));
            let scene = on_grid(
                scene(shape, [0.0, 0.0, -1.0], grips, None, 1.5, 0.0)?,
                cells,
                shift,
            );
            let physics = elastic(young_pa);
            let mut run = Stepper::new(&scene, &physics);
            // Stretch under the weight first: critical for the longitudinal mode, π/2 c/L.
            let slowest = std::f64::consts::FRAC_PI_2 * (rod.axial_n / rod.mass_kg_m).sqrt() / length_m;
            run.advance_damped((12.0 / slowest / run.dt_s) as usize, 2.0 * slowest)?;
            excite(&mut run, &mode, GRIP_M);
            // The scene's upward direction across a hanging rope is y.
            let omega = frequency(&mut run, &mode, GRIP_M, Vector3::y(), 2)?;
            Ok(std::f64::consts::TAU / omega)
        },
    )
}
