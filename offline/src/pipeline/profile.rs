//! Intervals by profile likelihood, on request, in `profile.json` and `base_profile.json`.

use super::settings::{Inputs, RunSettings};
use crate::diagnose::{LoopOptions, problems};
use crate::fit::{FitResult, Profile, profiles};
use crate::model::{Estimate, Structure};
use crate::run_files::{kept, write_whole};
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
    pub noise_scale: Option<f64>,
}

/// The intervals of a fit: those that an earlier run has found, else new ones where they are `asked` for.
///
/// # Errors
/// The model cannot be simulated, or a file cannot be written.
pub fn profile(
    inputs: &Inputs,
    settings: &RunSettings,
    file: &Path,
    (of, asked): (&Profiled, bool),
    progress: &dyn Fn(&str),
) -> anyhow::Result<Vec<Profile>> {
    let wanted = ProfileFile {
        key: inputs.key(settings),
        effects: of.structure.ids(),
        theta: of.fitted.best.theta.clone(),
        profiles: Vec::new(),
    };
    if let Some(earlier) = kept::<ProfileFile>(file).filter(|earlier| earlier.is_of(&wanted)) {
        return Ok(earlier.profiles);
    }
    if !asked {
        return Ok(Vec::new());
    }
    progress("following each parameter away from its best value: profile likelihood");
    let (demos, held_out) = inputs.members();
    let options = LoopOptions::new(settings.resolution(), settings.seed);
    let (mut problem, _) = problems(&demos, &held_out, &options)?;
    problem.noise_scale = of.noise_scale.unwrap_or(1.0);
    let found = profiles(&problem, of.structure, of.fitted, (of.estimates, of.grid_shift))?;
    let whole = ProfileFile {
        profiles: found,
        ..wanted
    };
    write_whole(file, &serde_json::to_vec_pretty(&whole)?)?;
    Ok(whole.profiles)
}

impl ProfileFile {
    /// Whether both are of the same fit to the same data.
    fn is_of(&self, other: &Self) -> bool {
        self.key == other.key && self.effects == other.effects && self.theta == other.theta
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::Evaluation;
    use crate::pipeline::Preset;
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
            jacobian: DMatrix::zeros(0, 2),
        };
        let of = Profiled {
            structure: &structure,
            fitted: &FitResult::at(evaluation, &structure),
            estimates: &[],
            grid_shift: &[],
            noise_scale: None,
        };
        let settings = RunSettings::of(Preset::Quick, seed);
        let wanted = ProfileFile {
            key: inputs.key(&settings),
            effects: Vec::new(),
            theta: vec![14.0, 0.3],
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
        profile(&inputs, &settings, file, (&of, false), &|_| ()).unwrap()
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
