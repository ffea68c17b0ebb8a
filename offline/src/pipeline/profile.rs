//! Intervals by profile likelihood in `profile.json` and `base_profile.json`: of every parameter on request, else of those
//! that a fit took to the end of their range.

use super::settings::{Inputs, RunSettings};
use crate::diagnose::{LoopOptions, problems_at};
use crate::fit::{FitResult, Profile, profiles};
use crate::model::{Estimate, Structure};
use crate::run_files::{kept, write_whole};
use crate::tell::Tell;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// What these files hold.
#[derive(Serialize, Deserialize)]
struct ProfileFile {
    /// Of what the fit depends on.
    key: u64,
    effects: Vec<String>,
    /// θ of the fit.
    theta: Vec<f64>,
    /// Whether every parameter was asked for.
    whole: bool,
    profiles: Vec<Profile>,
}

/// A fit whose intervals are asked for.
pub struct Profiled<'a> {
    /// Effects of the model.
    pub structure: &'a Structure,
    /// The fit.
    pub fitted: &'a FitResult,
    /// Its parameters as they are reported.
    pub estimates: &'a [Estimate],
    /// How far the simulation's own error may have moved each entry of θ.
    pub grid_shift: &'a [f64],
    /// Measured over declared noise.
    pub noise_scale: f64,
}

/// The intervals of a fit: those that an earlier run has found, else new ones. Where they are not `asked` for, only of
/// what is at the end of its range: of that an estimate says nothing but that it may be more.
///
/// # Errors
/// The model cannot be simulated, or a file cannot be written.
pub fn profile(
    inputs: &Inputs,
    settings: &RunSettings,
    file: &Path,
    (of, asked): (&Profiled, bool),
    progress: &dyn Tell,
) -> anyhow::Result<Vec<Profile>> {
    let wanted = ProfileFile {
        key: inputs.key(settings),
        effects: of.structure.ids(),
        theta: of.fitted.best.theta.clone(),
        whole: asked,
        profiles: Vec::new(),
    };
    if let Some(earlier) = kept::<ProfileFile>(file).filter(|earlier| earlier.tells(&wanted)) {
        return Ok(earlier.profiles);
    }
    let entries = if asked {
        (0..wanted.theta.len()).collect()
    } else {
        of.structure.at_an_end(&wanted.theta)
    };
    if entries.is_empty() {
        return Ok(Vec::new());
    }
    progress.say(if asked {
        "following each parameter away from its best value: profile likelihood"
    } else {
        "following what is at the end of its range back, to what it is at least: profile likelihood"
    });
    let (demos, held_out) = inputs.members();
    let options = LoopOptions::new(settings.resolution(), settings.seed);
    let model = (of.structure, &of.fitted.best.theta[..]);
    let (problem, _) = problems_at((&demos, &held_out), &options, of.noise_scale, model)?;
    let found = ProfileFile {
        profiles: profiles(
            &problem,
            (of.structure, of.fitted),
            &entries,
            (of.estimates, of.grid_shift),
        )?,
        ..wanted
    };
    write_whole(file, &serde_json::to_vec_pretty(&found)?)?;
    Ok(found.profiles)
}

/// Whether a file holds intervals of the same data and settings.
pub(super) fn is_of(path: &Path, key: u64) -> bool {
    kept::<ProfileFile>(path).is_some_and(|file| file.key == key)
}

impl ProfileFile {
    /// Whether it tells as much of the same fit to the same data.
    fn tells(&self, wanted: &Self) -> bool {
        self.whole >= wanted.whole
            && self.key == wanted.key
            && self.effects == wanted.effects
            && self.theta == wanted.theta
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::Evaluation;
    use crate::pipeline::Preset;
    use crate::tell::Silent;
    use nalgebra::DMatrix;

    /// What is kept for a base fit at ln E = `ln_young` when nobody asks for intervals: no demonstration is there that
    /// they could be found from.
    fn kept_for(file: &Path, ln_young: f64, seed: u64) -> Vec<Profile> {
        let inputs = Inputs {
            name: "rope".into(),
            demos: Vec::new(),
            held_out: Vec::new(),
            hashes: vec![7],
            held_out_hashes: Vec::new(),
        };
        let structure = Structure::default();
        let evaluation = Evaluation {
            theta: vec![ln_young, 0.3],
            rows: Vec::new(),
            most_rows: 0,
            huber: f64::INFINITY,
            jacobian: DMatrix::zeros(0, 2),
        };
        let of = Profiled {
            structure: &structure,
            fitted: &FitResult::at(evaluation, &structure),
            estimates: &[],
            grid_shift: &[],
            noise_scale: 1.0,
        };
        let settings = RunSettings::of(Preset::Quick, seed);
        let wanted = ProfileFile {
            key: inputs.key(&settings),
            effects: Vec::new(),
            theta: vec![14.0, 0.3],
            whole: true,
            profiles: vec![Profile {
                name: "young_pa".into(),
                unit: "Pa".into(),
                value: 1.2e6,
                low: Some(1.1e6),
                high: None,
                better_elsewhere: false,
            }],
        };
        if !file.exists() {
            write_whole(file, &serde_json::to_vec(&wanted).unwrap()).unwrap();
        }
        profile(&inputs, &settings, file, (&of, false), &Silent).unwrap()
    }

    #[test]
    fn some_intervals_do_not_stand_for_all() {
        let of = |whole| ProfileFile {
            key: 1,
            effects: Vec::new(),
            theta: vec![14.0, 0.3],
            whole,
            profiles: Vec::new(),
        };
        assert!(of(true).tells(&of(false)) && of(false).tells(&of(false)));
        assert!(!of(false).tells(&of(true)));
    }

    #[test]
    fn kept_intervals_are_told_again_for_the_same_fit_only() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("profile.json");
        assert_eq!(kept_for(&file, 14.0, 1).len(), 1);
        assert_eq!(kept_for(&file, 14.1, 1), [], "another fit");
        assert_eq!(kept_for(&file, 14.0, 2), [], "other settings");
    }
}
