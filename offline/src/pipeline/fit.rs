//! The fit of the base model alone, and `fit.json`.

use super::model::model;
use super::settings::{Inputs, RunSettings};
use crate::diagnose::{BaseFit, LoopOptions, fit_only};
use crate::fit::{FitResult, StopReason, estimates};
use crate::model::{Estimate, Structure};
use crate::run_files::{FileError, RunFolder, write_whole};
use crate::tell::Tell;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// What `model.toml` says instead of a verdict where nobody has looked for missing effects.
pub const NOT_DIAGNOSED: &str = "not diagnosed: `offline diagnose` says what the model lacks";

/// `fit.json`: the fits with and without effects.
#[derive(Serialize, Deserialize)]
pub(super) struct FitFile {
    /// Of what they depend on.
    pub(super) key: u64,
    pub(super) base_theta: Vec<f64>,
    base: Vec<Estimate>,
    pub(super) final_theta: Vec<f64>,
    /// As [`FitResult::prior_weight`].
    pub(super) final_prior_weight: f64,
    /// How far the grid's own error may have moved each entry of it.
    pub(super) grid_shift: Vec<f64>,
    parameters: Vec<Estimate>,
    pub(super) effects: Vec<String>,
    starts_ended_at: Vec<StartEnd>,
    stop: StopReason,
    evaluations: usize,
}

/// Where one start of the base fit ended.
#[derive(Serialize, Deserialize)]
struct StartEnd {
    young_pa: f64,
    cost: f64,
}

/// A model that was fitted.
pub(super) struct Final<'a> {
    pub(super) structure: &'a Structure,
    pub(super) fitted: &'a FitResult,
    pub(super) parameters: Vec<Estimate>,
    pub(super) grid_shift: &'a [f64],
}

impl FitFile {
    pub(super) fn of(key: u64, base: &FitResult, last: Final) -> Self {
        let ends = base.ends.iter().map(|&(ln_young, cost)| StartEnd {
            young_pa: ln_young.exp(),
            cost,
        });
        Self {
            key,
            base_theta: base.best.theta.clone(),
            base: estimates(&base.best, &Structure::default()),
            final_theta: last.fitted.best.theta.clone(),
            final_prior_weight: last.fitted.prior_weight,
            grid_shift: last.grid_shift.to_vec(),
            parameters: last.parameters,
            effects: last.structure.ids(),
            starts_ended_at: ends.collect(),
            stop: base.stop,
            evaluations: base.evaluations,
        }
    }
}

/// What follows from a diagnosis.
fn followers(run: &RunFolder) -> [PathBuf; 7] {
    [
        run.diagnosis(),
        run.profile(),
        run.base_profile(),
        run.tables(),
        run.report(),
        run.evaluation(),
        run.finer_evaluation(),
    ]
}

/// Refuses a folder that holds files by the names of a run's, but no run: they are somebody's, and would be removed or
/// replaced.
///
/// # Errors
/// The folder is such a one.
pub fn refuse_strangers(run: &RunFolder) -> anyhow::Result<()> {
    // One of these is there from the first fit on.
    let is_run = [run.memory(), run.fit(), run.model()]
        .iter()
        .any(|path| path.exists());
    let others = [
        run.residual(),
        run.weights(),
        run.training(),
        run.blob(),
        run.record(),
    ];
    let stranger = followers(run)
        .into_iter()
        .chain(others)
        .find(|path| path.exists());
    match stranger {
        Some(file) if !is_run => anyhow::bail!(
            "{} is there, but no run that left it: give the run a folder of its own with --out",
            file.display()
        ),
        _ => Ok(()),
    }
}

/// Removes what follows from a diagnosis of data or settings other than those of `key`: beside the new files it would pass
/// for theirs. The policy stays; who reads it is warned that it was frozen from another model.
///
/// # Errors
/// A file cannot be removed.
pub(super) fn forget_others(run: &RunFolder, key: u64, progress: &dyn Tell) -> Result<(), FileError> {
    let intervals = [run.profile(), run.base_profile()];
    for path in followers(run) {
        // Intervals say of which fit they are, and take minutes to find anew.
        let stays = intervals.contains(&path) && super::profile::is_of(&path, key);
        if path.exists() && !stays {
            progress.say(&format!(
                "{} is of other data or settings: removed",
                path.display()
            ));
            std::fs::remove_file(&path).map_err(|error| FileError::new("remove", &path, error))?;
        }
    }
    Ok(())
}

/// Fits the base model and writes `fit.json`, `residual.json` and `model.toml`, unless a diagnosis of the same data
/// has left better ones; says whether it wrote them.
///
/// # Errors
/// A diagnosis of other settings is there, the base model cannot be fitted, or a file cannot be written.
pub fn fit(
    inputs: &Inputs,
    settings: &RunSettings,
    run: &RunFolder,
    progress: &dyn Tell,
) -> anyhow::Result<(BaseFit, bool)> {
    let key = inputs.key(settings);
    let diagnosed = super::identify::earlier(run, key).is_some();
    anyhow::ensure!(
        diagnosed || !super::identify::holds_diagnosis(run),
        "{} is of another seed or preset, or by another version of this program, and a fit alone would replace it: give the \
         fit another folder with --out, or make the diagnosis anew with `offline diagnose`",
        run.diagnosis().display()
    );
    let (demos, held_out) = inputs.members();
    let options = LoopOptions::new(settings.resolution(), settings.seed);
    let base = fit_only(&demos, &held_out, &options, progress)?;
    if diagnosed {
        progress.say("a diagnosis of the same data is there: its files stay as they are");
        return Ok((base, false));
    }
    forget_others(run, key, progress)?;
    let structure = Structure::default();
    let parameters = base.estimates();
    let model = model(inputs, settings, NOT_DIAGNOSED.into(), (&structure, &parameters));
    let file = FitFile::of(
        key,
        &base.fitted,
        Final {
            structure: &structure,
            fitted: &base.fitted,
            parameters,
            grid_shift: &base.grid_shift,
        },
    );
    write_whole(&run.fit(), &serde_json::to_vec_pretty(&file)?)?;
    super::identify::save_residual(run, &demos, [&base.fitted; 2])?;
    model.save(&run.model())?;
    Ok((base, true))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tell::Silent;

    #[test]
    fn what_follows_from_other_data_goes_and_the_policy_stays() {
        let folder = tempfile::tempdir().unwrap();
        let run = RunFolder::open(folder.path()).unwrap();
        let gone = followers(&run);
        let stay = [run.blob(), run.weights()];
        for path in gone.iter().chain(&stay) {
            write_whole(path, b"of other data").unwrap();
        }
        forget_others(&run, 1, &Silent).unwrap();
        assert!(
            gone.iter().all(|path| !path.exists()),
            "it would pass for the new data's"
        );
        assert!(stay.iter().all(|path| path.exists()));
    }

    #[test]
    fn intervals_of_the_same_data_stay_when_they_are_fitted_again() {
        let folder = tempfile::tempdir().unwrap();
        let run = RunFolder::open(folder.path()).unwrap();
        let kept = r#"{"key":7,"effects":[],"theta":[],"whole":true,"profiles":[]}"#;
        for (key, stays) in [(7, true), (8, false)] {
            write_whole(&run.base_profile(), kept.as_bytes()).unwrap();
            forget_others(&run, key, &Silent).unwrap();
            assert_eq!(run.base_profile().exists(), stays, "asked for {key}");
        }
    }

    #[test]
    fn a_folder_with_a_strangers_report_is_no_runs() {
        let folder = tempfile::tempdir().unwrap();
        let run = RunFolder::open(folder.path()).unwrap();
        write_whole(&folder.path().join("notes.txt"), b"mine").unwrap();
        refuse_strangers(&run).unwrap();
        write_whole(&run.report(), b"mine").unwrap();
        let refused = refuse_strangers(&run).unwrap_err().to_string();
        assert!(refused.contains("report.html is there, but no run"), "{refused}");
        write_whole(&run.model(), b"of a run").unwrap();
        refuse_strangers(&run).unwrap();
    }
}
