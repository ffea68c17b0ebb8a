//! `model.toml`: the one place that says what a rope is: parameters with errors, effects with
//! parameters, and where they come from.

use crate::demo::{Demo, RopeSpec, SceneKind, no_rope};
use crate::effects;
use crate::model::{Estimate, POISSON_RANGE, Structure, YOUNG_RANGE_PA};
use crate::run_files::{FileError, Fnv64, RunFolder, write_whole};
use crate::sim::REVISION;
use crate::sim::rope::RopeShape;
use crate::toml_lines::line_at;
use anyhow::Context;
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;
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
    /// Experiments in which the rope was seen.
    #[serde(default)]
    pub scene: Vec<SceneEntry>,
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

/// An experiment in which the rope was seen.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneEntry {
    /// Name of the demonstration.
    pub demo: String,
    /// Which experiment.
    pub kind: SceneKind,
    /// Whether it only judged.
    pub held_out: bool,
    /// Declared friction on the table; none without a table.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub table_friction: Option<f64>,
    /// Known mass at the rope's end, kg.
    pub end_mass_kg: f64,
}

impl SceneEntry {
    /// The experiment of a demonstration.
    pub fn of(demo: &Demo, held_out: bool) -> Self {
        Self {
            demo: demo.name.clone(),
            kind: demo.spec.scene,
            held_out,
            table_friction: demo.spec.table.as_ref().map(|table| table.friction),
            end_mass_kg: demo.spec.rope.end_mass_kg,
        }
    }
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

/// Hash of what swings without effects: the simulator's revision, shape and mass, cells across the rope.
pub fn swing_hash(rope: &RopeShape, cells: f64) -> Fnv64 {
    let mut hash = Fnv64::default();
    hash.add(&REVISION.to_le_bytes());
    let RopeShape {
        length_m,
        diameter_m,
        mass_kg,
        end_mass_kg,
    } = *rope;
    for value in [length_m, diameter_m, mass_kg, end_mass_kg, cells] {
        hash.add(&value.to_le_bytes());
    }
    hash
}

impl ModelFile {
    /// The file's content.
    fn text(&self) -> String {
        toml::to_string_pretty(self).expect("a model has only plain fields")
    }

    /// FNV-1a hash of the file.
    pub fn hash(&self) -> u64 {
        Fnv64::of(self.text().as_bytes())
    }

    /// Hash of what swings: the simulator's revision, shape and mass, sizes of the effects, grid. Young's modulus and Poisson's ratio are not in
    /// it, because rollouts vary them.
    pub fn swing_hash(&self) -> u64 {
        let mut hash = swing_hash(&self.rope, self.provenance.cells_per_diameter);
        for effect in &self.effects {
            hash.add(effect.id.as_bytes());
            for parameter in &effect.parameters {
                hash.add(&parameter.value.to_le_bytes());
            }
        }
        hash.value()
    }

    /// Effects and their parameter values, as simulations take them.
    ///
    /// # Errors
    /// An effect is not in the registry, stands there twice, or has other parameters than there or none of their range.
    pub fn structure(&self) -> anyhow::Result<(Structure, Vec<f64>)> {
        let mut structure = Structure::default();
        let mut values = Vec::new();
        for entry in &self.effects {
            let index = effects::known(&entry.id).map_err(|problem| anyhow::anyhow!(problem))?;
            let wanted = effects::ALL[index].parameters;
            anyhow::ensure!(
                entry.parameters.len() == wanted.len(),
                "effect `{}` needs {} parameters and has {}",
                entry.id,
                wanted.len(),
                entry.parameters.len()
            );
            anyhow::ensure!(
                !structure.effects.contains(&index),
                "effect `{}` stands there twice: keep one of them",
                entry.id
            );
            for (parameter, wanted) in entry.parameters.iter().zip(wanted) {
                let name = format!("{}.{}", entry.id, wanted.name);
                refuse_other(parameter, [&name, wanted.unit])?;
                refuse_outside(&name, parameter.value, [wanted.low, wanted.high], wanted.unit)?;
            }
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
        write_whole(path, self.text().as_bytes())
    }

    /// The model of a run's folder, or of a file.
    ///
    /// # Errors
    /// As [`ModelFile::load`].
    pub fn of_run_or_file(path: &Path) -> anyhow::Result<Self> {
        if path.is_dir() {
            return Self::load(&RunFolder::there(path).model());
        }
        Self::load(path)
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
            "{}: format is `{}`, this program reads `{FORMAT}`; run `offline diagnose` again with the same --demo",
            path.display(),
            model.format
        );
        anyhow::ensure!(
            model.elasticity.len() == 2,
            "{}: there are {} values in [[elasticity]]; write Young's modulus and Poisson's ratio",
            path.display(),
            model.elasticity.len()
        );
        let checked = model.check().and_then(|()| model.structure());
        checked.with_context(|| path.display().to_string())?;
        Ok(model)
    }

    /// Shape and elasticity.
    fn check(&self) -> anyhow::Result<()> {
        let RopeShape {
            length_m,
            diameter_m,
            mass_kg,
            end_mass_kg,
        } = self.rope;
        let spec = RopeSpec {
            length_m,
            diameter_m,
            mass_kg,
            end_mass_kg,
            direction: [1.0, 0.0, 0.0],
            roll_rad: 0.0,
            assumed: Vec::new(),
        };
        if let Some((_, problem, remedy)) = no_rope(&spec) {
            anyhow::bail!("{problem}: {remedy}");
        }
        let wanted = Structure::default().parameters();
        let ranges = [YOUNG_RANGE_PA, POISSON_RANGE];
        for ((found, wanted), range) in self.elasticity.iter().zip(&wanted).zip(ranges) {
            refuse_other(found, [&wanted.name, wanted.unit])?;
            refuse_outside(&wanted.name, found.value, range, wanted.unit)?;
            anyhow::ensure!(
                found.standard_error >= 0.0,
                "the standard error of {} is {}: write how sure the fit was",
                wanted.name,
                found.standard_error
            );
        }
        let cells = self.provenance.cells_per_diameter;
        anyhow::ensure!(
            CELLS.contains(&cells),
            "cells_per_diameter is {cells}, outside {} to {}: write the cells across the rope that it was fitted with",
            CELLS.start(),
            CELLS.end()
        );
        Ok(())
    }
}

/// Cells across a rope that was fitted, with a margin.
const CELLS: RangeInclusive<f64> = 1.0..=64.0;
/// Share of a range by which a value may lie beyond it: what a fit took to an end may do so by a rounding.
const ROUNDING: f64 = 1e-9;

fn refuse_outside(name: &str, value: f64, [low, high]: [f64; 2], unit: &str) -> anyhow::Result<()> {
    let beyond = ROUNDING * (high - low);
    // What has no unit has the unit 1.
    let unit = if unit == "1" {
        String::new()
    } else {
        format!(" {unit}")
    };
    anyhow::ensure!(
        (low - beyond..=high + beyond).contains(&value),
        "{name} is {value}, outside {low} to {high}{unit}: fit the rope again, or mend the value"
    );
    Ok(())
}

/// Refuses a value that stands where another one belongs, or in another unit.
fn refuse_other(found: &Estimate, [name, unit]: [&str; 2]) -> anyhow::Result<()> {
    anyhow::ensure!(
        found.name == name && found.unit == unit,
        "there is `{}` in `{}` where `{name}` in `{unit}` belongs: let `offline fit` write the file again",
        found.name,
        found.unit
    );
    Ok(())
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A rope with a mass at its tip, kg.
    pub fn model(tip_kg: f64, young_pa: f64) -> ModelFile {
        let structure = Structure {
            effects: vec![effects::find("tip_mass").expect("in the registry")],
        };
        let estimate = |name: &str, unit: &str, value| Estimate {
            name: name.into(),
            unit: unit.into(),
            value,
            standard_error: 0.1 * value,
            identified: true,
        };
        let all = [
            estimate("young_pa", "Pa", young_pa),
            estimate("poisson", "1", 0.3),
            estimate("tip_mass.mass_kg", "kg", tip_kg),
        ];
        ModelFile {
            format: FORMAT.into(),
            name: "red".into(),
            verdict: String::new(),
            rope: RopeShape::of_density(0.3, 0.014, 1000.0),
            elasticity: all[..2].to_vec(),
            effects: ModelFile::entries(&structure, &all),
            scene: Vec::new(),
            provenance: ModelProvenance {
                program: String::new(),
                cells_per_diameter: 1.5,
                demos: Vec::new(),
                seed: 1,
            },
        }
    }

    /// Seen: the hash of every model was that of nothing, and a new rope was swung by an old one's rollouts.
    #[test]
    fn ropes_that_swing_otherwise_have_other_hashes_and_rollouts_vary_the_stiffness_themselves() {
        let one = model(0.009, 1e6);
        assert_ne!(one.swing_hash(), model(0.03, 1e6).swing_hash());
        assert_eq!(one.swing_hash(), model(0.009, 2e6).swing_hash());
        assert_ne!(one.hash(), model(0.009, 2e6).hash());
    }

    #[test]
    fn the_hash_is_that_of_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.toml");
        let one = model(0.009, 1e6);
        one.save(&path).unwrap();
        assert_eq!(Fnv64::of(&std::fs::read(&path).unwrap()), one.hash());
        assert_eq!(ModelFile::load(&path).unwrap(), one);
    }

    /// Half of all steps to 0.05 end beside it.
    #[test]
    fn a_value_that_is_beyond_its_range_by_a_rounding_is_one_at_its_end() {
        let most_kg = effects::ALL[effects::find("tip_mass").unwrap()].parameters[0].high;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.toml");
        model(most_kg.next_up(), 1e6).save(&path).unwrap();
        assert!(ModelFile::load(&path).is_ok());
    }

    /// A model is a file that anyone may have edited.
    #[test]
    fn what_no_fit_wrote_is_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.toml");
        let text = model(0.009, 1e6).text();
        let effect = text.find("[[effects]]").unwrap()..text.find("[provenance]").unwrap();
        let twice = text.replace("[provenance]", &format!("{}[provenance]", &text[effect]));
        let edits = [
            (
                text.replace("id = \"tip_mass\"", "id = \"tipmass\""),
                "known are air_drag",
            ),
            (
                text.replace("value = 0.009", "value = -1.0"),
                "tip_mass.mass_kg is -1, outside 0 to",
            ),
            (
                text.replace("value = 0.009", "value = nan"),
                "tip_mass.mass_kg is NaN, outside",
            ),
            (
                text.replace("unit = \"Pa\"", "unit = \"MPa\""),
                "`young_pa` in `MPa` where",
            ),
            (
                text.replace("\"poisson\"", "\"nu\""),
                "`nu` in `1` where `poisson`",
            ),
            (
                text.replace("value = 1000000.0", "value = -1.0"),
                "young_pa is -1, outside",
            ),
            (
                text.replace("cells_per_diameter = 1.5", "cells_per_diameter = nan"),
                "cells_per_diameter is NaN",
            ),
            (
                text.replace("length_m = 0.3", "length_m = nan"),
                "rope.length_m = NaN is no length of a rope",
            ),
            (
                text.replace("length_m = 0.3", "length_m = 300.0"),
                "rope.length_m = 300 is no length of a rope",
            ),
            (
                text.replace("cells_per_diameter = 1.5", "cells_per_diameter = 1e9"),
                "cells_per_diameter is 1000000000",
            ),
            (
                text.replace("unit = \"1\"\nvalue = 0.3", "unit = \"1\"\nvalue = 0.6"),
                "poisson is 0.6, outside 0.05 to 0.45: fit",
            ),
            (
                text.replacen("standard_error = ", "standard_error = -", 1),
                "the standard error of young_pa is -",
            ),
            (twice, "stands there twice"),
        ];
        for (edited, words) in edits {
            assert_ne!(edited, text, "{words}");
            std::fs::write(&path, edited).unwrap();
            let refused = format!("{:#}", ModelFile::load(&path).unwrap_err());
            assert!(
                refused.contains(words) && refused.contains("model.toml"),
                "{refused}"
            );
        }
    }
}
