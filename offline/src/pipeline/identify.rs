//! The first half of a run: fit, residual, missing effects, `model.toml`.

use super::fit::{Final, FitFile};
use super::model::model;
use super::settings::{Inputs, RunSettings};
use crate::demo::Demo;
use crate::diagnose::{
    Advice, Invariance, KeptModel, LoopOptions, Memory, NextDemonstration, Noise, NoiseSource, Outcome,
    ReasonCode, ResidualForce, Round, SwingRisks, Verdict, advise, problems_at, residual_force, resume_loop,
};
use crate::fit::{FitResult, fit_from};
use crate::model::Structure;
use crate::model_file::ModelFile;
use crate::residual::{ResidualMap, ResidualSummary};
use crate::run_files::{RunFolder, kept, read_sealed, seal, write_whole};
use crate::tell::Tell;
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
    /// Content hash of `model.toml`, which the blob carries.
    pub model_hash: u64,
}

/// `diagnosis.json`.
#[derive(Serialize, Deserialize)]
pub(super) struct DiagnosisFile {
    key: u64,
    verdict: Verdict,
    verdict_in_words: String,
    reasons: Vec<ReasonCode>,
    /// Measured over declared noise; none where it is as declared.
    noise_scale: Option<f64>,
    noise_source: NoiseSource,
    /// Independent values that tell it; none where it is as declared.
    noise_values: Option<f64>,
    /// Correlation of an offset with that of the frame before, and with that of the neighbouring station.
    noise_in_time: f64,
    noise_along_rope: f64,
    /// Models that fit as well as the final one.
    rivals: Vec<KeptModel>,
    /// How the final model's effects fare in parts of what was fitted.
    #[serde(default)]
    invariances: Vec<Invariance>,
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
    progress: &dyn Tell,
) -> anyhow::Result<Identified> {
    let (demos, held_out) = inputs.members();
    let key = inputs.key(settings);
    let options = LoopOptions::new(settings.resolution(), settings.seed);
    let (outcome, force, advice) = match earlier(run, key) {
        Some((fit, diagnosis)) => {
            progress.say("fit and diagnosis are there from an earlier run");
            restore(&demos, &held_out, &options, fit, diagnosis)?
        }
        None => {
            let mut outcome = diagnosed(&demos, &held_out, &options, (run, key), progress)?;
            // What follows takes minutes of a thick rope.
            progress.say(&format!(
                "found, before what to do next is asked: {}",
                outcome.verdict
            ));
            let force = force_left(&demos, &outcome, &options, progress);
            let advice = advise(&demos, &held_out, &outcome, &options, progress);
            if let Verdict::Confounded {
                separating_demonstration,
                ..
            } = &mut outcome.verdict
            {
                separating_demonstration.clone_from(&advice.next_demonstration.in_words);
            }
            if outcome.verdict == Verdict::NothingMissing && advice.swing.matter_unseen() {
                outcome.reasons.push(ReasonCode::Underpowered);
            }
            // Not sooner: until the new one is whole, the old one is what there is.
            super::fit::forget_others(run, key, progress)?;
            save(run, key, &outcome, force.as_ref(), &advice)?;
            // Whether or not it can be removed: from here on nobody reads it.
            let _ = std::fs::remove_file(run.memory());
            (outcome, force, advice)
        }
    };
    let estimates = outcome.estimates();
    let verdict = outcome.verdict.to_string();
    let model = model(inputs, settings, verdict, (&outcome.structure, &estimates));
    model.save(&run.model())?;
    save_residual(run, &demos, [&outcome.base, &outcome.fitted])?;
    Ok(Identified {
        outcome,
        residual_force: force,
        advice,
        model_hash: model.hash(),
        model,
    })
}

/// Kind and version of the file that holds what an unfinished diagnosis has come to.
const MEMORY: &[u8; 8] = b"gnmloop7";

/// The loop, from where a killed run left it.
fn diagnosed(
    demos: &[&Demo],
    held_out: &[&Demo],
    options: &LoopOptions,
    (run, key): (&RunFolder, u64),
    progress: &dyn Tell,
) -> anyhow::Result<Outcome> {
    let path = run.memory();
    let earlier = read_sealed(MEMORY, &path).ok();
    let earlier = earlier.and_then(|bytes| postcard::from_bytes::<(u64, Memory)>(&bytes).ok());
    let earlier = earlier.filter(|(of, _)| *of == key).map(|(_, memory)| memory);
    if earlier.is_some() {
        progress.say("going on from what an unfinished diagnosis had come to");
    }
    let keep = |memory: &Memory| {
        let bytes = postcard::to_stdvec(&(key, memory)).expect("plain numbers and text");
        if let Err(error) = write_whole(&path, &seal(MEMORY, &bytes)) {
            progress.say(&format!(
                "if it is killed now, the diagnosis starts anew: {error}"
            ));
        }
    };
    Ok(resume_loop(demos, held_out, options, earlier, &keep, progress)?)
}

/// What is left as a force, where nothing explains it.
fn force_left(
    demos: &[&Demo],
    outcome: &Outcome,
    options: &LoopOptions,
    progress: &dyn Tell,
) -> Option<ResidualForce> {
    if !matches!(outcome.verdict, Verdict::Unexplained { .. }) {
        return None;
    }
    progress.say("asking which force along the rope would explain what is left");
    residual_force(demos, outcome, options).unwrap_or_else(|error| {
        progress.say(&format!("no such force could be found: {error}"));
        None
    })
}

/// Whether a folder holds a diagnosis of any version: hours of work. What cannot be read is none.
pub fn holds_diagnosis(run: &RunFolder) -> bool {
    kept::<serde_json::Value>(&run.diagnosis()).is_some_and(|file| file.get("verdict").is_some())
}

/// What an earlier run found for the same data and settings.
pub(super) fn earlier(run: &RunFolder, key: u64) -> Option<(FitFile, DiagnosisFile)> {
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
    let structure = Structure::of_ids(&fit.effects);
    let noise = Noise {
        scale: diagnosis.noise_scale.unwrap_or(1.0),
        source: diagnosis.noise_source,
        values: diagnosis.noise_values.unwrap_or(f64::INFINITY),
        in_time: diagnosis.noise_in_time,
        along_rope: diagnosis.noise_along_rope,
    };
    let at = |structure: &Structure, theta: &[f64]| {
        problems_at((demos, held_out), options, noise.scale, (structure, theta))
    };
    let base_structure = Structure::default();
    let (base_here, base_there) = at(&base_structure, &fit.base_theta)?;
    let (here, there) = at(&structure, &fit.final_theta)?;
    let advice = Advice {
        next_demonstration: diagnosis.next_demonstration,
        swing: diagnosis.swing,
    };
    let outcome = Outcome {
        fitted: FitResult {
            prior_weight: fit.final_prior_weight,
            ..fit_from(&here, &structure, fit.final_theta.clone(), 1)?
        },
        base: fit_from(&base_here, &base_structure, fit.base_theta.clone(), 1)?,
        held_out_before: base_there.residuals(&base_structure, &fit.base_theta)?,
        held_out_after: there.residuals(&structure, &fit.final_theta)?,
        structure,
        rounds: diagnosis.rounds,
        verdict: diagnosis.verdict,
        reasons: diagnosis.reasons,
        noise,
        rivals: diagnosis.rivals,
        invariances: diagnosis.invariances,
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
    let fit = FitFile::of(
        key,
        &outcome.base,
        Final {
            structure: &outcome.structure,
            fitted: &outcome.fitted,
            parameters: outcome.estimates(),
            grid_shift: &outcome.grid_shift,
        },
    );
    let noise = outcome.noise;
    let diagnosis = DiagnosisFile {
        key,
        verdict: outcome.verdict.clone(),
        verdict_in_words: outcome.verdict.to_string(),
        reasons: outcome.reasons.clone(),
        noise_scale: noise.measured_scale(),
        noise_source: noise.source,
        noise_values: noise.measured_scale().map(|_| noise.values),
        noise_in_time: noise.in_time,
        noise_along_rope: noise.along_rope,
        rivals: outcome.rivals.clone(),
        invariances: outcome.invariances.clone(),
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
pub(super) fn save_residual(run: &RunFolder, demos: &[&Demo], fits: [&FitResult; 2]) -> anyhow::Result<()> {
    let maps = |fit: &FitResult| -> Vec<ResidualMap> {
        demos
            .iter()
            .zip(&fit.best.rows)
            .map(|(demo, rows)| ResidualMap::of(demo, &demo.times_s(), rows))
            .collect()
    };
    let text = serde_json::to_vec(&serde_json::json!({
        "before": maps(fits[0]),
        "after": maps(fits[1]),
    }))?;
    write_whole(&run.residual(), &text)?;
    Ok(())
}
