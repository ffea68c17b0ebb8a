//! The sim2sim table: ropes with known parameters, every method, errors. Each finished estimate is a
//! file, so that a run that was stopped goes on.

use super::adam::Parameters;
use super::chamfer::chamfer;
use super::data::{STARTS, Source, draw, last_state, record, seen_by_cameras};
use super::method::{Case, Effort, Estimated, Method};
use super::ours::demo_of;
use super::scene::{DENSITY_KG_M3, Discretisation, STEPS, demonstration};
use super::table::{Row, Spread, Table, printed};
use crate::countdown::Countdown;
use crate::depth_cameras::cameras;
use crate::observe::Section;
use crate::paper_units::METRES_PER_UNIT;
use crate::pipeline::Preset;
use crate::run_files::{RunFolder, kept, made_by, write_whole};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Settings of the table.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Number of true ropes; the paper has five.
    pub truths: u64,
    /// How the data are made.
    pub source: Source,
    /// How the fitter cuts rope and time.
    pub fitter: Discretisation,
    /// What each method does.
    pub effort: Effort,
    /// Standard deviation of the two cameras' points, m, in the second row of ours.
    pub camera_noise_m: f64,
    /// Simulated demonstrations to train PointNet++ on, and passes over them; none skips it.
    pub pointnet: Option<PointNetEffort>,
}

/// How much PointNet++ learns.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PointNetEffort {
    /// Demonstrations; the paper has 998.
    pub demonstrations: u64,
    /// Passes; the released code makes 1000.
    pub epochs: usize,
    /// Divides the numbers of centres, 512 and 128 in the paper.
    pub thinning: usize,
}

impl Settings {
    /// Settings of a preset.
    pub fn of(preset: Preset, seed: u64) -> Self {
        let quick = preset == Preset::Quick;
        Self {
            truths: 5,
            source: Source::Sampled,
            fitter: Discretisation::default(),
            effort: Effort {
                iterations: if quick { 40 } else { 150 },
                starts: super::ours::STARTS,
                seed,
                real: false,
            },
            camera_noise_m: 0.002,
            pointnet: Some(if quick {
                PointNetEffort {
                    demonstrations: 48,
                    epochs: 5,
                    thinning: 4,
                }
            } else {
                PointNetEffort {
                    demonstrations: 998,
                    epochs: 1000,
                    thinning: 1,
                }
            }),
        }
    }
}

/// One estimate with everything that judges it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Judged {
    /// Hash of the settings that made it.
    pub settings: String,
    /// The truth.
    pub truth: Parameters,
    /// The estimate.
    pub estimated: Estimated,
    /// Chamfer distance of the last state, paper length units.
    pub chamfer_units: f64,
}

/// An estimator from a last state alone, such as PointNet++.
pub trait Baseline: Sync {
    /// Row of the table.
    fn row(&self) -> String;
    /// E in paper units and ν from points in m.
    fn estimate(&self, last_m: &[[f64; 3]]) -> Parameters;
}

/// Random streams: truths, starts and camera noise come from seeds that differ.
const TRUTH_SEED: u64 = 0x7275_7468;
const CAMERA_SEED: u64 = 0x6361_6d65;

/// Runs `methods` and returns the table. `say` hears what was finished.
///
/// # Errors
/// A simulation stopped, or a file could not be written.
pub fn run(
    settings: &Settings,
    methods: &[Method],
    out: &Path,
    baselines: &[&dyn Baseline],
    say: &(dyn Fn(&str) + Sync),
) -> anyhow::Result<Table> {
    let folder = RunFolder::open(out)?;
    let cases: Vec<[Case; 2]> = (0..settings.truths)
        .into_par_iter()
        .map(|index| cases(settings, index))
        .collect::<anyhow::Result<_>>()?;
    let cameras_too = methods.iter().filter(|&&method| method == Method::Ours);
    let jobs: Vec<(Method, usize, usize)> = methods
        .iter()
        .map(|&method| (method, 0))
        .chain(cameras_too.map(|&method| (method, 1)))
        .flat_map(|(method, view)| (0..cases.len()).map(move |index| (method, index, view)))
        .collect();
    let countdown = Countdown::of(jobs.len());
    let mut judged: Vec<Judged> = jobs
        .par_iter()
        .map(|&(method, index, view)| {
            let path = file(folder.path(), method.slug(), VIEWS[view], index);
            let fresh = !path.exists();
            let found = finish(settings, &path, &cases[index][view], || {
                method.estimate(&cases[index][view], &settings.effort, index as u64)
            })?;
            say(&format!(
                "{}: {} {} of rope {index}",
                countdown.ended(fresh),
                method.slug(),
                VIEWS[view]
            ));
            Ok(rename(found, view, settings))
        })
        .collect::<anyhow::Result<Vec<_>>>()?
        .concat();
    for baseline in baselines {
        for case in cases.iter().map(|views| &views[0]) {
            judged.push(judge_baseline(settings, case, *baseline)?);
        }
    }
    Ok(table(settings, &judged))
}

/// How a case is seen.
const VIEWS: [&str; 2] = ["particles", "cameras"];

fn file(out: &Path, slug: &str, view: &str, index: usize) -> PathBuf {
    out.join("estimates").join(format!("{slug}-{view}-{index}.json"))
}

/// A true rope as the paper sees it, all particles, and as two cameras do.
fn cases(settings: &Settings, index: u64) -> anyhow::Result<[Case; 2]> {
    let truth = draw(STARTS, settings.effort.seed ^ TRUTH_SEED, index);
    let rope = record(truth, settings.source, &settings.fitter)?;
    let camera_seed = (settings.effort.seed ^ CAMERA_SEED).wrapping_add(index);
    let noisy = seen_by_cameras(&rope, settings.camera_noise_m, camera_seed);
    let fitted = demonstration(&settings.fitter)?;
    let last_m = last_state(truth, &settings.fitter)?;
    let case = |clouds, section, noise_m, seen_by| Case {
        name: format!("rope {index}"),
        demo: demo_of(&fitted, clouds, noise_m, seen_by),
        scene: fitted.clone(),
        section,
        truth: Some(truth),
        last_m: last_m.clone(),
    };
    Ok([
        case(rope.particles_m, Section::Filled, 0.0, Vec::new()),
        case(noisy, Section::Surface, settings.camera_noise_m, cameras()),
    ])
}

/// The judged estimates of one job: read from its file, or made and written.
fn finish(
    settings: &Settings,
    path: &Path,
    case: &Case,
    estimate: impl FnOnce() -> anyhow::Result<Vec<Estimated>>,
) -> anyhow::Result<Vec<Judged>> {
    let key = key(settings)?;
    if let Some(kept) = kept::<Vec<Judged>>(path).filter(|kept| kept.iter().all(|j| j.settings == key)) {
        return Ok(kept);
    }
    let judged = estimate()?
        .into_iter()
        .map(|estimated| judge(settings, case, estimated))
        .collect::<anyhow::Result<Vec<_>>>()?;
    write_whole(path, &serde_json::to_vec_pretty(&judged)?)?;
    Ok(judged)
}

/// What an estimate depends on: the program, and all settings but the number of ropes and PointNet++'s.
fn key(settings: &Settings) -> anyhow::Result<String> {
    let own = Settings {
        truths: 0,
        pointnet: None,
        ..*settings
    };
    Ok(format!("{} {}", made_by(), serde_json::to_string(&own)?))
}

fn judge(settings: &Settings, case: &Case, estimated: Estimated) -> anyhow::Result<Judged> {
    let state_m = last_state(estimated.parameters, &settings.fitter)?;
    Ok(Judged {
        settings: key(settings)?,
        truth: case.truth.expect("sim2sim knows the truth"),
        chamfer_units: chamfer(&state_m, &case.last_m) / METRES_PER_UNIT,
        estimated,
    })
}

fn judge_baseline(settings: &Settings, case: &Case, baseline: &dyn Baseline) -> anyhow::Result<Judged> {
    let clouds = case.clouds_m();
    let estimated = Estimated {
        row: baseline.row(),
        parameters: baseline.estimate(&clouds[STEPS - 1]),
        fit: None,
    };
    judge(settings, case, estimated)
}

/// Names the camera's row.
fn rename(mut judged: Vec<Judged>, view: usize, settings: &Settings) -> Vec<Judged> {
    for j in &mut judged {
        if view == 1 {
            let noise_mm = 1e3 * settings.camera_noise_m;
            j.estimated.row += &format!(", two cameras with {noise_mm:.0} mm noise");
        }
    }
    judged
}

fn table(settings: &Settings, judged: &[Judged]) -> Table {
    let mut names: Vec<&str> = Vec::new();
    for j in judged {
        if !names.contains(&j.estimated.row.as_str()) {
            names.push(&j.estimated.row);
        }
    }
    let rows = names.iter().map(|name| {
        let of: Vec<&Judged> = judged.iter().filter(|j| j.estimated.row == *name).collect();
        let error = |k: usize| -> Vec<f64> {
            of.iter()
                .map(|j| (j.estimated.parameters[k] - j.truth[k]).abs())
                .collect()
        };
        let chamfers: Vec<f64> = of.iter().map(|j| j.chamfer_units).collect();
        Row {
            name: (*name).into(),
            young_units: Spread::of(&error(0)),
            poisson: Spread::of(&error(1)),
            chamfer_units: Spread::of(&chamfers),
            printed: printed(name),
        }
    });
    Table {
        title: format!(
            "Sim2sim, {} true ropes, seed {}; data made by: {}",
            settings.truths,
            settings.effort.seed,
            settings.source.words()
        ),
        rows: rows.collect(),
        errors: true,
        density_kg_m3: DENSITY_KG_M3,
        notes: notes(settings),
    }
}

fn notes(settings: &Settings) -> Vec<String> {
    let mut notes = vec![
        format!(
            "Gradient rows: {} steps of Adam from one random start per rope (released code: 150).",
            settings.effort.iterations
        ),
        format!(
            "Ours: the best of {} random starts over E 500 to 10500 and ν 0.2 to 0.4.",
            settings.effort.starts
        ),
        "The paper's data are made by the simulation that is fitted (here: --data same).".into(),
    ];
    match settings.pointnet {
        Some(p) => notes.push(format!(
            "PointNet++: {} demonstrations (paper 998), {} epochs (released code 1000), {} and {} centres (paper 512 and 128).",
            p.demonstrations,
            p.epochs,
            512 / p.thinning,
            128 / p.thinning
        )),
        None => notes.push("PointNet++ was left out.".into()),
    }
    notes
}
