//! This program's estimator on the same clouds: Levenberg-Marquardt on offsets in millimetres along the
//! rope, from several starts.

use super::adam::Parameters;
use super::data::{WHOLE_RANGE, draw};
use super::scene::{FRICTION, theta};
use crate::demo::{
    CloudFrame, Demo, DemoSpec, FORMAT, Observations, RopeSpec, SceneKind, StartState, TableSpec,
};
use crate::fit::{FitError, FitOptions, FitResult, FrameShare, Problem, estimates, fit_starts};
use crate::model::Structure;
use crate::observe::Section;
use crate::paper_units::young_paper;
use crate::sim::Scene;
use serde::{Deserialize, Serialize};

/// Starts of one fit.
pub const STARTS: u64 = 5;

/// What a fit found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fitted {
    /// Estimate.
    pub parameters: Parameters,
    /// Standard errors.
    pub standard_errors: Parameters,
    /// Whether the data say anything about each.
    pub identified: [bool; 2],
    /// Simulations with tangents of the descent that won.
    pub evaluations: usize,
    /// Why it ended.
    pub stop: crate::fit::StopReason,
}

/// The clouds as a demonstration. Its clamp path is the scene's own, so it has no samples.
pub fn demo_of(scene: &Scene, clouds_m: Vec<Vec<[f64; 3]>>, noise_m: f64) -> Demo {
    let frames = scene
        .frame_times_s
        .iter()
        .zip(clouds_m)
        .map(|(&t_s, points_m)| CloudFrame { t_s, points_m })
        .collect();
    Demo {
        name: "sim2sim".into(),
        spec: DemoSpec {
            format: FORMAT.into(),
            scene: SceneKind::Lift,
            noise_m,
            planar: false,
            notes: String::new(),
            start: StartState::Straight,
            rope: RopeSpec {
                length_m: scene.rope.length_m,
                diameter_m: scene.rope.diameter_m,
                mass_kg: scene.rope.mass_kg,
                direction: scene.direction,
                end_mass_kg: 0.0,
                roll_rad: 0.0,
                assumed: Vec::new(),
            },
            table: scene.table.map(|table| TableSpec {
                height_m: table.height_m,
                friction: FRICTION,
            }),
            clamps: Vec::new(),
            cameras: Vec::new(),
        },
        clamps: Vec::new(),
        commanded: Vec::new(),
        observations: Observations::Clouds(frames),
    }
}

/// Fits the clouds of `demo` in `scene`, from `starts` drawn over the whole range with `seed`.
///
/// # Errors
/// No start could be simulated.
pub fn fit_clouds(
    demo: &Demo,
    scene: &Scene,
    section: Section,
    seed: u64,
    starts: u64,
) -> Result<Fitted, FitError> {
    let mut scene = scene.clone();
    scene.keep_particles = false;
    let problem = Problem {
        demos: vec![demo],
        scenes: vec![scene],
        noise_scale: 1.0,
        frames: FrameShare::ALL,
        section,
    };
    let density = demo_density(demo);
    let structure = Structure::default();
    let starts = (0..starts)
        .map(|index| theta(draw(WHOLE_RANGE, seed, index), density))
        .collect();
    let options = FitOptions {
        followed: FOLLOWED,
        max_evaluations: MOST_EVALUATIONS,
        ..FitOptions::default()
    };
    let result = fit_starts(&problem, &structure, starts, &options)?;
    Ok(fitted(&result, &structure, density))
}

/// Starts that are followed to the end.
const FOLLOWED: usize = 2;
const MOST_EVALUATIONS: usize = 20;

fn demo_density(demo: &Demo) -> f64 {
    let rope = &demo.spec.rope;
    rope.mass_kg / (std::f64::consts::FRAC_PI_4 * rope.diameter_m.powi(2) * rope.length_m)
}

fn fitted(result: &FitResult, structure: &Structure, density: f64) -> Fitted {
    let list = estimates(&result.best, structure);
    Fitted {
        parameters: [young_paper(list[0].value, density), list[1].value],
        standard_errors: [
            young_paper(list[0].standard_error, density),
            list[1].standard_error,
        ],
        identified: [list[0].identified, list[1].identified],
        evaluations: result.evaluations,
        stop: result.stop,
    }
}
