//! The real2sim table: measured demonstrations, the paper's estimator from several starts and ours, with
//! the Chamfer distance of the last state.

use super::chamfer::chamfer;
use super::gradient::Steps;
use super::method::{Case, Effort, Estimated, Method, StepSizes};
use super::ours::Fitted;
use super::scene::physics;
use super::table::{Row, Spread, Table};
use crate::countdown::Countdown;
use crate::demo::Demo;
use crate::observe::Section;
use crate::paper_units::METRES_PER_UNIT;
use crate::pipeline::Preset;
use crate::run_files::{Fnv64, RunFolder, kept, made_by, write_whole};
use crate::sim::rope::RopeShape;
use crate::sim::scene::{MIN_CELLS_PER_DIAMETER, PAPER_CELLS_PER_DIAMETER};
use crate::sim::tensor::value3;
use crate::sim::{Scene, simulate};
use anyhow::Context;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Settings of the table.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Cells across the rope.
    pub cells: f64,
    /// Random starts of the paper's estimator; the paper has five.
    pub gradient_starts: u64,
    /// What each method does.
    pub effort: Effort,
}

impl Settings {
    /// Settings of a preset.
    pub fn of(preset: Preset, seed: u64) -> Self {
        let quick = preset == Preset::Quick;
        Self {
            cells: if quick {
                MIN_CELLS_PER_DIAMETER
            } else {
                PAPER_CELLS_PER_DIAMETER
            },
            gradient_starts: if quick { 2 } else { 5 },
            effort: Effort {
                iterations: if quick { 25 } else { 100 },
                starts: super::ours::STARTS,
                seed,
                real: true,
            },
        }
    }
}

/// An estimate and the Chamfer distance that it leaves.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Judged {
    settings: Settings,
    hash: u64,
    row: String,
    parameters: [f64; 2],
    chamfer_units: f64,
    /// What our fit says besides.
    fit: Option<Fitted>,
}

const METHODS: [Method; 2] = [
    Method::Gradient {
        steps: Steps::All,
        sizes: StepSizes::Released,
    },
    Method::Ours,
];

/// A demonstration as a case, at a resolution.
///
/// # Errors
/// It cannot be simulated, or shows nothing.
pub fn case_of(demo: &Demo, cells: f64) -> anyhow::Result<Case> {
    let scene = Scene::of_demo(demo, cells).with_context(|| demo.name.clone())?;
    let mut case = Case {
        name: demo.name.clone(),
        scene,
        demo: demo.clone(),
        section: Section::Surface,
        truth: None,
        last_m: Vec::new(),
    };
    case.last_m = case.clouds_m().pop().unwrap_or_default();
    anyhow::ensure!(
        !case.last_m.is_empty(),
        "{}: the last frame shows nothing",
        demo.name
    );
    Ok(case)
}

/// Runs everything; one table per demonstration. `say` hears what was finished.
///
/// # Errors
/// A simulation stopped, or a file could not be written.
pub fn run(
    settings: &Settings,
    demos: &[Demo],
    out: &Path,
    say: &(dyn Fn(&str) + Sync),
) -> anyhow::Result<Vec<Table>> {
    let folder = RunFolder::open(out)?;
    let mut tables = Vec::with_capacity(demos.len());
    for (number, demo) in demos.iter().enumerate() {
        let case = case_of(demo, settings.cells)?;
        let jobs: Vec<(Method, u64)> = METHODS
            .iter()
            .flat_map(|&method| {
                let starts = if method == Method::Ours {
                    1
                } else {
                    settings.gradient_starts
                };
                (0..starts).map(move |start| (method, start))
            })
            .collect();
        let countdown = Countdown::of(jobs.len());
        let judged: Vec<Judged> = jobs
            .par_iter()
            .map(|&(method, start)| {
                let name = format!("{number}-{}-{}-{start}.json", demo.name, method.slug());
                let path = folder.path().join("estimates").join(name);
                let fresh = !path.exists();
                let judged = finish(settings, &path, &case, method, start)?;
                say(&format!(
                    "{}: {}, {}, start {start}",
                    demo.name,
                    countdown.ended(fresh),
                    method.slug()
                ));
                Ok(judged)
            })
            .collect::<anyhow::Result<Vec<_>>>()?
            .concat();
        tables.push(table(settings, &case, &judged));
    }
    Ok(tables)
}

fn finish(
    settings: &Settings,
    path: &Path,
    case: &Case,
    method: Method,
    start: u64,
) -> anyhow::Result<Vec<Judged>> {
    let hash = Fnv64::of(format!("{} {:?}", made_by(), case.demo).as_bytes());
    let same = |kept: &Vec<Judged>| kept.iter().all(|j| j.settings == *settings && j.hash == hash);
    if let Some(kept) = kept(path).filter(same) {
        return Ok(kept);
    }
    let judge = |estimated: Estimated| -> anyhow::Result<Judged> {
        let state_m = last_state(case, estimated.parameters)?;
        Ok(Judged {
            settings: *settings,
            hash,
            row: estimated.row,
            parameters: estimated.parameters,
            fit: estimated.fit,
            chamfer_units: chamfer(&state_m, &case.last_m) / METRES_PER_UNIT,
        })
    };
    let judged = method
        .estimate(case, &settings.effort, start)?
        .into_iter()
        .map(judge)
        .collect::<anyhow::Result<Vec<_>>>()?;
    write_whole(path, &serde_json::to_vec_pretty(&judged)?)?;
    Ok(judged)
}

/// All particles of the last state at (E in paper units, ν), m.
///
/// # Errors
/// The simulation stopped.
pub fn last_state(case: &Case, parameters: [f64; 2]) -> anyhow::Result<Vec<[f64; 3]>> {
    let mut scene = case.scene.clone();
    scene.keep_particles = true;
    let last = scene.frame_times_s.len() - 1;
    scene.frame_times_s.drain(..last);
    let parameters = parameters.map(|p| p as f32);
    let physics = physics(parameters, scene.rope.density_kg_m3(), case.demo.spec.friction());
    let rollout = simulate(&scene, &physics)?;
    // A static scene returns all of its poses, whatever times are asked for.
    let last = rollout
        .particles
        .last()
        .context("a rollout keeps its last state")?;
    Ok(last.iter().map(|&p| value3(p)).collect())
}

fn table(settings: &Settings, case: &Case, judged: &[Judged]) -> Table {
    let rows = METHODS.iter().flat_map(|method| method.rows()).map(|name| {
        let of: Vec<&Judged> = judged.iter().filter(|j| j.row == name).collect();
        let column = |value: &dyn Fn(&Judged) -> f64| -> Spread {
            Spread::of(&of.iter().map(|j| value(j)).collect::<Vec<_>>())
        };
        Row {
            young_units: column(&|j| j.parameters[0]),
            poisson: column(&|j| j.parameters[1]),
            chamfer_units: column(&|j| j.chamfer_units),
            printed: None,
            name,
        }
    });
    let rope: RopeShape = case.scene.rope;
    let ours = judged.iter().filter_map(|j| Some((&j.row, j.fit.as_ref()?)));
    let mut notes: Vec<String> = ours.map(|(row, fit)| with_standard_errors(row, fit)).collect();
    notes.extend([
        format!(
            "Gradient rows: {} steps of Adam (released code: 100) from each of {} random starts (paper: 5); spread over starts.",
            settings.effort.iterations, settings.gradient_starts
        ),
        "Chamfer: measured points lie on the visible surface, simulated particles fill the rope, so a perfect estimate leaves some distance.".into(),
        "The paper prints for its own three ropes: E 1779 to 8000, ν 0.35 to 0.36, Chamfer 0.034 to 0.060.".into(),
    ]);
    Table {
        title: format!(
            "Real2sim, demonstration {}, seed {}",
            case.name, settings.effort.seed
        ),
        rows: rows.collect(),
        errors: false,
        density_kg_m3: rope.density_kg_m3(),
        notes,
    }
}

/// What our fit says of its parameters, for people.
fn with_standard_errors(row: &str, fit: &Fitted) -> String {
    let told = |name: &str, k: usize, digits: usize| {
        let [value, error] = [fit.parameters[k], fit.standard_errors[k]];
        let doubt = if fit.identified[k] {
            ""
        } else {
            " (not identified)"
        };
        format!("{name} = {value:.digits$} ± {error:.digits$}{doubt}")
    };
    let [young, poisson] = [told("E", 0, 1), told("ν", 1, 3)];
    format!("{row}, one fit with its standard errors: {young} paper units, {poisson}.")
}
