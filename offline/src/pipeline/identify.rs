//! The first half of a run: fit, residual, missing effects, `model.toml`.

use super::settings::{Inputs, RunSettings};
use crate::demo::Demo;
use crate::diagnose::{
    Advice, LoopOptions, NextDemonstration, Outcome, ReasonCode, ResidualForce, Round, SwingRisks, Verdict,
    advise, close_loop, residual_force,
};
use crate::effects;
use crate::fit::{estimates, fit_from};
use crate::model::{Estimate, Structure};
use crate::model_file::{FORMAT, ModelFile, ModelProvenance};
use crate::residual::{ResidualMap, ResidualSummary};
use crate::run_files::{Fnv64, RunFolder, kept, write_whole};
use crate::sim::rope::RopeShape;
use serde::{Deserialize, Serialize};

/// What is known about the rope after the first half.
pub struct Identified {
    /// The loop's outcome.
    pub outcome: Outcome,
    /// What is left, as a force; none where it is explained.
    pub residual_force: Option<ResidualForce>,
    /// What to do next, and what matters for the swing.
    pub advice: Advice,
    /// The rope.
    pub model: ModelFile,
    /// Content hash of the model, which rollouts carry.
    pub model_hash: u64,
}

/// `fit.json`: the fits with and without effects.
#[derive(Serialize, Deserialize)]
struct FitFile {
    key: u64,
    base_theta: Vec<f64>,
    base: Vec<Estimate>,
    final_theta: Vec<f64>,
    /// How far the grid's own error may have moved each entry of it.
    grid_shift: Vec<f64>,
    parameters: Vec<Estimate>,
    effects: Vec<String>,
    starts_ended_at: Vec<StartEnd>,
    stop: crate::fit::StopReason,
    evaluations: usize,
}

/// Where one start of the base fit ended.
#[derive(Serialize, Deserialize)]
struct StartEnd {
    young_pa: f64,
    cost: f64,
}

/// `diagnosis.json`.
#[derive(Serialize, Deserialize)]
struct DiagnosisFile {
    key: u64,
    verdict: Verdict,
    verdict_in_words: String,
    reasons: Vec<ReasonCode>,
    noise_scale: Option<f64>,
    rivals: Vec<String>,
    fit_before: ResidualSummary,
    fit_after: ResidualSummary,
    held_out_before: ResidualSummary,
    held_out_after: ResidualSummary,
    rounds: Vec<Round>,
    /// What is left, as a force along the rope; none where it is explained.
    #[serde(default)]
    residual_force: Option<ResidualForce>,
    /// The demonstration that would tell most.
    next_demonstration: NextDemonstration,
    /// How far each effect could move the reach of the swing at the size that the data still allow.
    swing: SwingRisks,
}

/// Fits, diagnoses and writes `fit.json`, `residual.json`, `diagnosis.json` and `model.toml`; reads
/// them instead when they are there for the same demonstrations and settings.
///
/// # Errors
/// The base model cannot be fitted, or a file cannot be written.
pub fn identify(
    inputs: &Inputs,
    settings: &RunSettings,
    run: &RunFolder,
    progress: &dyn Fn(&str),
) -> anyhow::Result<Identified> {
    let demos: Vec<&Demo> = inputs.demos.iter().collect();
    let held_out: Vec<&Demo> = inputs.held_out.iter().collect();
    let key = key(inputs, settings);
    let options = LoopOptions::new(settings.resolution(), settings.seed);
    let (outcome, force, advice) = match earlier(run, key) {
        Some((fit, diagnosis)) => {
            progress("fit and diagnosis are there from an earlier run");
            restore(&demos, &held_out, &options, fit, diagnosis)?
        }
        None => {
            let mut outcome = close_loop(&demos, &held_out, &options, progress)?;
            let force = force_left(&demos, &outcome, &options, progress);
            let advice = advise(&demos, &held_out, &outcome, &options, progress);
            if let Verdict::Confounded {
                separating_demonstration,
                ..
            } = &mut outcome.verdict
            {
                separating_demonstration.clone_from(&advice.next_demonstration.in_words);
            }
            save(run, key, &outcome, force.as_ref(), &advice)?;
            (outcome, force, advice)
        }
    };
    let model = model(inputs, settings, &outcome);
    model.save(&run.model())?;
    save_residual(run, &demos, &outcome)?;
    let hashed = toml::to_string(&(&model.rope, &model.effects, settings.cells)).unwrap_or_default();
    Ok(Identified {
        outcome,
        residual_force: force,
        advice,
        model_hash: Fnv64::of(hashed.as_bytes()),
        model,
    })
}

/// What is left as a force, where nothing explains it.
fn force_left(
    demos: &[&Demo],
    outcome: &Outcome,
    options: &LoopOptions,
    progress: &dyn Fn(&str),
) -> Option<ResidualForce> {
    if !matches!(outcome.verdict, Verdict::Unexplained { .. }) {
        return None;
    }
    progress("asking which force along the rope would explain what is left");
    residual_force(demos, outcome, options).unwrap_or_else(|error| {
        progress(&format!("no such force could be found: {error}"));
        None
    })
}

/// Hash of everything that the first half depends on.
fn key(inputs: &Inputs, settings: &RunSettings) -> u64 {
    let mut hash = Fnv64::default();
    for h in &inputs.hashes {
        hash.add(&h.to_le_bytes());
    }
    for demo in &inputs.held_out {
        hash.add(demo.name.as_bytes());
    }
    hash.add(&settings.cells.to_le_bytes());
    hash.add(&settings.seed.to_le_bytes());
    hash.add(env!("CARGO_PKG_VERSION").as_bytes());
    hash.value()
}

fn earlier(run: &RunFolder, key: u64) -> Option<(FitFile, DiagnosisFile)> {
    let fit: FitFile = kept(&run.fit())?;
    let diagnosis: DiagnosisFile = kept(&run.diagnosis())?;
    (fit.key == key && diagnosis.key == key).then_some((fit, diagnosis))
}

/// Rebuilds the outcome of an earlier run from its parameters, with one simulation per model.
fn restore(
    demos: &[&Demo],
    held_out: &[&Demo],
    options: &LoopOptions,
    fit: FitFile,
    diagnosis: DiagnosisFile,
) -> anyhow::Result<(Outcome, Option<ResidualForce>, Advice)> {
    let structure = Structure {
        effects: fit.effects.iter().filter_map(|id| effects::find(id)).collect(),
    };
    let (mut here, mut there) = crate::diagnose::problems(demos, held_out, options)?;
    for problem in [&mut here, &mut there] {
        problem.noise_scale = diagnosis.noise_scale.unwrap_or(1.0);
    }
    let base_structure = Structure::default();
    let advice = Advice {
        next_demonstration: diagnosis.next_demonstration,
        swing: diagnosis.swing,
    };
    let outcome = Outcome {
        fitted: fit_from(&here, &structure, fit.final_theta.clone(), 1)?,
        base: fit_from(&here, &base_structure, fit.base_theta.clone(), 1)?,
        held_out_before: there.residuals(&base_structure, &fit.base_theta)?,
        held_out_after: there.residuals(&structure, &fit.final_theta)?,
        structure,
        rounds: diagnosis.rounds,
        verdict: diagnosis.verdict,
        reasons: diagnosis.reasons,
        noise_scale: diagnosis.noise_scale,
        rivals: diagnosis.rivals,
        grid_shift: fit.grid_shift,
        library: None,
    };
    Ok((outcome, diagnosis.residual_force, advice))
}

fn save(
    run: &RunFolder,
    key: u64,
    outcome: &Outcome,
    residual_force: Option<&ResidualForce>,
    advice: &Advice,
) -> anyhow::Result<()> {
    let fit = FitFile {
        key,
        base_theta: outcome.base.best.theta.clone(),
        base: estimates(&outcome.base.best, &Structure::default()),
        final_theta: outcome.fitted.best.theta.clone(),
        parameters: outcome.estimates(),
        grid_shift: outcome.grid_shift.clone(),
        effects: outcome
            .structure
            .effects
            .iter()
            .map(|&e| effects::ALL[e].id.into())
            .collect(),
        starts_ended_at: outcome
            .base
            .ends
            .iter()
            .map(|&(ln_young, cost)| StartEnd {
                young_pa: ln_young.exp(),
                cost,
            })
            .collect(),
        stop: outcome.base.stop,
        evaluations: outcome.base.evaluations,
    };
    let diagnosis = DiagnosisFile {
        key,
        verdict: outcome.verdict.clone(),
        verdict_in_words: outcome.verdict.to_string(),
        reasons: outcome.reasons.clone(),
        noise_scale: outcome.noise_scale,
        rivals: outcome.rivals.clone(),
        fit_before: ResidualSummary::of(&outcome.base.best),
        fit_after: ResidualSummary::of(&outcome.fitted.best),
        held_out_before: ResidualSummary::of(&outcome.held_out_before),
        held_out_after: ResidualSummary::of(&outcome.held_out_after),
        rounds: outcome.rounds.clone(),
        residual_force: residual_force.cloned(),
        next_demonstration: advice.next_demonstration.clone(),
        swing: advice.swing.clone(),
    };
    write_whole(&run.fit(), &serde_json::to_vec_pretty(&fit)?)?;
    write_whole(&run.diagnosis(), &serde_json::to_vec_pretty(&diagnosis)?)?;
    Ok(())
}

/// `residual.json`: maps of the fitted demonstrations before and after.
fn save_residual(run: &RunFolder, demos: &[&Demo], outcome: &Outcome) -> anyhow::Result<()> {
    let maps = |rows: &[Vec<crate::observe::Row>]| -> Vec<ResidualMap> {
        demos
            .iter()
            .zip(rows)
            .map(|(demo, rows)| ResidualMap::of(demo, &demo.times_s(), rows))
            .collect()
    };
    let text = serde_json::to_vec(&serde_json::json!({
        "before": maps(&outcome.base.best.rows),
        "after": maps(&outcome.fitted.best.rows),
    }))?;
    write_whole(&run.residual(), &text)?;
    Ok(())
}

fn model(inputs: &Inputs, settings: &RunSettings, outcome: &Outcome) -> ModelFile {
    let all = outcome.estimates();
    ModelFile {
        format: FORMAT.into(),
        name: inputs.name.clone(),
        verdict: outcome.verdict.to_string(),
        rope: RopeShape::of_spec(&inputs.demos[0].spec.rope),
        elasticity: all[..2].to_vec(),
        effects: ModelFile::entries(&outcome.structure, &all),
        provenance: ModelProvenance {
            program: concat!("offline ", env!("CARGO_PKG_VERSION")).into(),
            cells_per_diameter: settings.cells,
            demos: inputs.hashes.iter().map(|h| format!("{h:016x}")).collect(),
            seed: settings.seed,
        },
    }
}
