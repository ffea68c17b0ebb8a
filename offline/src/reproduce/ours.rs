//! This program's estimator on the same clouds: Levenberg-Marquardt on offsets in millimetres along the
//! rope, from several starts.

use super::adam::Parameters;
use super::data::{WHOLE_RANGE, draw};
use super::scene::{FRICTION, theta};
use crate::demo::{
    CameraSpec, CloudFrame, Demo, DemoSpec, FORMAT, Observations, RopeSpec, SceneKind, StartState, TableSpec,
};
use crate::fit::{
    FitError, FitOptions, FitResult, Problem, Resolution, STIFFNESS_ACCURACY, estimates_within, fit_from,
    fit_starts, grid_shift,
};
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
    /// Standard errors: what the noise and what the simulation's own error may have moved.
    pub standard_errors: Parameters,
    /// Whether the data say anything about each.
    pub identified: [bool; 2],
    /// Simulations with tangents of the descent that won.
    pub evaluations: usize,
    /// Why it ended.
    pub stop: crate::fit::StopReason,
}

/// The clouds as a demonstration, and the cameras that saw them. Its clamp path is the scene's own, so it has no samples.
pub fn demo_of(scene: &Scene, clouds_m: Vec<Vec<[f64; 3]>>, noise_m: f64, cameras: Vec<CameraSpec>) -> Demo {
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
            cameras,
        },
        clamps: Vec::new(),
        commanded: Vec::new(),
        observations: Observations::Clouds(frames),
    }
}

/// Whose predictions are fitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Predicted {
    /// The scene's own grid: what the paper's estimators fit on, beside which ours stands.
    OwnGrid,
    /// A finer one near what was found, as every fit of a user has it.
    FinerGrid,
}

/// Fits the clouds of `demo` in `scene`, from `starts` drawn over the whole range with `seed`.
///
/// # Errors
/// No start could be simulated.
pub fn fit_clouds(
    demo: &Demo,
    scene: &Scene,
    section: Section,
    (seed, starts): (u64, u64),
    predicted: Predicted,
) -> Result<Fitted, FitError> {
    let mut scene = scene.clone();
    scene.keep_particles = section == Section::Filled;
    let mut problem = Problem {
        section,
        // Points inside a rope are a simulation's particles, as the paper has them, and its grid is the fit's.
        stiffness_accuracy: match section {
            Section::Filled => 0.0,
            Section::Surface => STIFFNESS_ACCURACY,
        },
        ..Problem::of_scenes(vec![demo], vec![scene])
    };
    let density = demo.spec.rope.density_kg_m3();
    let structure = Structure::default();
    let starts = (0..starts)
        .map(|index| theta(draw(WHOLE_RANGE, seed, index), density))
        .collect();
    let options = FitOptions {
        followed: FOLLOWED,
        max_evaluations: MOST_EVALUATIONS,
        ..FitOptions::default()
    };
    let mut result = fit_starts(&problem, &structure, starts, &options)?;
    if predicted == Predicted::FinerGrid {
        let cells = problem.scenes[0].cells_per_diameter();
        let finer = Resolution { cells }.finer();
        for _ in 0..TIMES_FOLLOWED {
            problem = problem.refined(finer, &structure, &result.best.theta)?;
            let before = result.evaluations;
            result = fit_from(&problem, &structure, result.best.theta, MOST_EVALUATIONS)?;
            result.evaluations += before;
        }
    }
    let shift = grid_shift(&problem, &structure, &result.best, 0.0)?;
    Ok(fitted(&result, &structure, &shift, density))
}

/// Starts that are followed to the end.
const FOLLOWED: usize = 2;
const MOST_EVALUATIONS: usize = 20;
/// How often a fit is followed to where the finer grid has it: the second time from where the first ended.
const TIMES_FOLLOWED: usize = 2;

fn fitted(result: &FitResult, structure: &Structure, shift: &[f64], density: f64) -> Fitted {
    let list = estimates_within(&result.best, structure, shift);
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

#[cfg(test)]
mod tests {
    use super::super::data::{STARTS, Source, record, seen_by_cameras};
    use super::super::scene::{Discretisation, demonstration};
    use super::*;
    use crate::depth_cameras::cameras;

    /// A rope of the table before two cameras of 2 mm noise, its data made on a grid twice as fine with other particles and
    /// half the time step: E within the 2 % that the issue asks for and within two standard errors, and Poisson's ratio not called
    /// identified where it is wrong. (Once 0.443 ± 0.006 was found for 0.222.)
    #[test]
    fn a_fit_before_noisy_cameras_is_right_and_does_not_pretend_to_know_poissons_ratio() {
        const SEED_OF_TRUTHS: u64 = 1 ^ 0x7275_7468;
        const NOISE_M: f64 = 0.002;
        let fitter = Discretisation::default();
        let truth = draw(STARTS, SEED_OF_TRUTHS, 0);
        let made = record(truth, Source::Finer, &fitter).unwrap();
        let scene = demonstration(&fitter).unwrap();
        let seen = seen_by_cameras(&made, NOISE_M, 99);
        let demo = demo_of(&scene, seen, NOISE_M, cameras());
        let fit = fit_clouds(&demo, &scene, Section::Surface, (7, 2), Predicted::FinerGrid).unwrap();
        println!("truth {truth:?}, {fit:?}");
        let off = [0, 1].map(|k| (fit.parameters[k] - truth[k]).abs());
        assert!(fit.identified[0] && off[0] < 0.02 * truth[0]);
        assert!(off[0] < 2.0 * fit.standard_errors[0]);
        assert!(!fit.identified[1] || off[1] < 3.0 * fit.standard_errors[1]);
    }
}
