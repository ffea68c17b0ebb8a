//! `model.toml` of a run.

use super::settings::{Inputs, RunSettings};
use crate::PROGRAM;
use crate::model::{Estimate, Structure};
use crate::model_file::{FORMAT, ModelFile, ModelProvenance, SceneEntry};
use crate::run_files::hex;
use crate::sim::rope::RopeShape;

/// The rope of a run's demonstrations, with the effects of a structure and the estimates of all its parameters.
pub(super) fn model(
    inputs: &Inputs,
    settings: &RunSettings,
    verdict: String,
    (structure, estimates): (&Structure, &[Estimate]),
) -> ModelFile {
    let fitted = inputs.demos.iter().map(|demo| SceneEntry::of(demo, false));
    let judges = inputs.held_out.iter().map(|demo| SceneEntry::of(demo, true));
    ModelFile {
        format: FORMAT.into(),
        name: inputs.name.clone(),
        verdict,
        rope: RopeShape::of_spec(&inputs.demos[0].spec.rope),
        elasticity: estimates[..2].to_vec(),
        effects: ModelFile::entries(structure, estimates),
        scene: fitted.chain(judges).collect(),
        provenance: ModelProvenance {
            program: PROGRAM.into(),
            cells_per_diameter: settings.cells,
            demos: inputs.hashes.iter().copied().map(hex).collect(),
            seed: settings.seed,
        },
    }
}
