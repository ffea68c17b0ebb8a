//! `model.toml`: the one place that says what a rope is: parameters with errors, effects with
//! parameters, and where they come from.

use crate::effects;
use crate::model::{Estimate, Structure};
use crate::run_files::{FileError, write_whole};
use crate::sim::rope::RopeShape;
use crate::toml_lines::line_at;
use anyhow::Context;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Name and version of the format.
pub const FORMAT: &str = "genorm-model/1";

/// A rope.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelFile {
    /// Must be [`FORMAT`].
    pub format: String,
    /// Name of the rope.
    pub name: String,
    /// The verdict of the diagnosis, in words.
    pub verdict: String,
    /// Shape and mass as declared.
    pub rope: RopeShape,
    /// Young's modulus and Poisson's ratio.
    pub elasticity: Vec<Estimate>,
    /// Effects that were found.
    #[serde(default)]
    pub effects: Vec<EffectEntry>,
    /// Where this comes from.
    pub provenance: ModelProvenance,
}

/// An effect with its parameters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EffectEntry {
    /// Name in the registry.
    pub id: String,
    /// Parameters in the registry's order.
    pub parameters: Vec<Estimate>,
}

/// Where a model comes from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelProvenance {
    /// Program and version.
    pub program: String,
    /// Cells across the rope in the simulations.
    pub cells_per_diameter: f64,
    /// FNV-1a hashes of the demonstrations that were fitted, hexadecimal.
    pub demos: Vec<String>,
    /// Seed.
    pub seed: u64,
}

impl ModelFile {
    /// Effects and their parameter values, as simulations take them.
    ///
    /// # Errors
    /// An effect is not in the registry, or has another number of parameters.
    pub fn structure(&self) -> anyhow::Result<(Structure, Vec<f64>)> {
        let mut structure = Structure::default();
        let mut values = Vec::new();
        for entry in &self.effects {
            let index = effects::find(&entry.id)
                .with_context(|| format!("effect `{}` is not known to this program", entry.id))?;
            let wanted = effects::ALL[index].parameters.len();
            anyhow::ensure!(
                entry.parameters.len() == wanted,
                "effect `{}` needs {wanted} parameters and has {}",
                entry.id,
                entry.parameters.len()
            );
            structure.effects.push(index);
            values.extend(entry.parameters.iter().map(|p| p.value));
        }
        Ok((structure, values))
    }

    /// Effects of a structure with their estimates, which follow the two of elasticity.
    pub fn entries(structure: &Structure, estimates: &[Estimate]) -> Vec<EffectEntry> {
        let mut rest = &estimates[2..];
        structure
            .effects
            .iter()
            .map(|&index| {
                let (mine, after) = rest.split_at(effects::ALL[index].parameters.len());
                rest = after;
                EffectEntry {
                    id: effects::ALL[index].id.into(),
                    parameters: mine.to_vec(),
                }
            })
            .collect()
    }

    /// Writes the file whole.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), FileError> {
        let text = toml::to_string_pretty(self).expect("a model has only plain fields");
        write_whole(path, text.as_bytes())
    }

    /// Reads and checks the file.
    ///
    /// # Errors
    /// The file is missing, malformed or of another format.
    pub fn load(path: &Path) -> anyhow::Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|error| {
            let remedy = "name the folder of a run that has fitted its rope, or its model.toml";
            anyhow::anyhow!("cannot read {}: {error}; {remedy}", path.display())
        })?;
        let model: Self = toml::from_str(&text).map_err(|error| {
            let line = error.span().map_or(1, |span| line_at(&text, span.start));
            let remedy = "mend the line, or let `offline fit` write the file again";
            anyhow::anyhow!("{}:{line}: {}; {remedy}", path.display(), error.message())
        })?;
        anyhow::ensure!(
            model.format == FORMAT,
            "{}: format is `{}`, this program reads `{FORMAT}`",
            path.display(),
            model.format
        );
        anyhow::ensure!(
            model.elasticity.len() == 2,
            "{}: there are {} values in [[elasticity]]; write Young's modulus and Poisson's ratio",
            path.display(),
            model.elasticity.len()
        );
        model.structure().with_context(|| path.display().to_string())?;
        Ok(model)
    }
}
