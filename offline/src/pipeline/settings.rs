//! What a run works on and how much it does.

use crate::demo::{Demo, files};
use crate::fit::Resolution;
use crate::freeze::{bounded, short};
use crate::model_file::ModelFile;
use crate::run_files::{Fnv64, hex, made_by, read_whole};
use crate::sim::rope::RopeShape;
use serde::{Deserialize, Serialize};
use shared::blob::{MAX_DEMOS, NAME_BYTES};
use std::path::{Path, PathBuf};

/// How much a run does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Preset {
    /// Minutes on two cores.
    Quick,
    /// The paper's numbers of rollouts and epochs: hours.
    Paper,
}

/// Settings of a run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunSettings {
    /// Preset.
    pub preset: Preset,
    /// Cells across the rope.
    pub cells: f64,
    /// Random rollouts.
    pub rollouts: u64,
    /// Unseen ropes and goals per rope in the evaluation.
    pub evaluation: [usize; 2],
    /// Seed of everything random.
    pub seed: u64,
}

impl RunSettings {
    /// Settings of a preset.
    pub fn of(preset: Preset, seed: u64) -> Self {
        match preset {
            Preset::Quick => Self {
                preset,
                cells: crate::sim::scene::MIN_CELLS_PER_DIAMETER,
                rollouts: 256,
                evaluation: [15, 2],
                seed,
            },
            Preset::Paper => Self {
                preset,
                cells: crate::sim::scene::PAPER_CELLS_PER_DIAMETER,
                rollouts: 40_000,
                evaluation: [100, 3],
                seed,
            },
        }
    }

    /// Grid of all simulations.
    pub fn resolution(&self) -> Resolution {
        Resolution { cells: self.cells }
    }
}

/// Demonstrations of a run.
pub struct Inputs {
    /// Name of the rope.
    pub name: String,
    /// Demonstrations that are fitted.
    pub demos: Vec<Demo>,
    /// Demonstrations that only judge.
    pub held_out: Vec<Demo>,
    /// Content hash of each fitted demonstration.
    pub hashes: Vec<u64>,
    /// Content hash of each that only judges.
    pub held_out_hashes: Vec<u64>,
}

impl Inputs {
    /// Reads the demonstrations.
    ///
    /// # Errors
    /// A folder is missing or malformed, the demonstrations are of different ropes, one is given twice or by a clock that no
    /// simulation follows, or a blob has no room for the name or the demonstrations: hours later would be a bad time to
    /// say so.
    pub fn load(name: &str, demos: &[PathBuf], held_out: &[PathBuf]) -> anyhow::Result<Self> {
        anyhow::ensure!(
            !demos.is_empty(),
            "no demonstration was given: name at least one folder with --demo"
        );
        refuse_unnameable(name, demos.len())?;
        let hashes = |paths: &[PathBuf]| paths.iter().map(|p| hash_folder(p)).collect::<Result<_, _>>();
        let read = |paths: &[PathBuf]| -> anyhow::Result<Vec<Demo>> {
            paths.iter().map(|p| Ok(Demo::load_to_simulate(p)?)).collect()
        };
        let inputs = Self {
            name: name.into(),
            demos: read(demos)?,
            held_out: read(held_out)?,
            hashes: hashes(demos)?,
            held_out_hashes: hashes(held_out)?,
        };
        refuse_unusable(&inputs, &demos.iter().chain(held_out).collect::<Vec<_>>())?;
        Ok(inputs)
    }

    /// Demonstrations that are fitted, and those that only judge.
    pub fn members(&self) -> (Vec<&Demo>, Vec<&Demo>) {
        (self.demos.iter().collect(), self.held_out.iter().collect())
    }

    /// What differs between the demonstrations that swings depend on, in words; a policy is for the rope of the first.
    pub fn differences(&self) -> Vec<String> {
        let mass_kg = |demo: &Demo| demo.spec.rope.end_mass_kg;
        let first = &self.demos[0];
        let others = self.demos.iter().filter(|demo| mass_kg(demo) != mass_kg(first));
        let told = others.map(|demo| {
            format!(
                "{} has {:.1} g at the rope's end and {} has {:.1} g: a policy is for the rope as in {0}",
                first.name,
                1e3 * mass_kg(first),
                demo.name,
                1e3 * mass_kg(demo)
            )
        });
        told.collect()
    }

    /// Whether a model was fitted to the same demonstrations and judged by ones of the same names.
    pub fn of_model(&self, model: &ModelFile) -> bool {
        let hashes = self.hashes.iter().map(|&hash| hex(hash));
        let own = self.held_out.iter().map(|demo| &demo.name);
        let its = model.scene.iter().filter(|scene| scene.held_out);
        hashes.eq(model.provenance.demos.iter().cloned()) && own.eq(its.map(|scene| &scene.demo))
    }

    /// Hash of everything that fit and diagnosis depend on.
    pub(super) fn key(&self, settings: &RunSettings) -> u64 {
        let mut hash = Fnv64::default();
        for list in [&self.hashes, &self.held_out_hashes] {
            hash.add(&list.len().to_le_bytes());
            for content in list {
                hash.add(&content.to_le_bytes());
            }
        }
        hash.add(&settings.cells.to_le_bytes());
        hash.add(&settings.seed.to_le_bytes());
        hash.add(made_by().as_bytes());
        hash.value()
    }
}

/// Refuses a name that no folder can have, and what a blob has no room for.
///
/// # Errors
/// What is wrong and what to do.
pub fn refuse_unnameable(name: &str, demos: usize) -> anyhow::Result<()> {
    anyhow::ensure!(
        !name.is_empty(),
        "the rope's name is empty: give it one with --name"
    );
    anyhow::ensure!(
        !name.contains(['/', '\\']) && !name.contains(char::is_control) && ![".", ".."].contains(&name),
        "the rope's name is {name:?}, which would not make the name of a folder: give it another with --name"
    );
    short::<NAME_BYTES>("rope", name).map_err(|error| anyhow::anyhow!("{error} with --name"))?;
    bounded::<_, MAX_DEMOS>("demonstrations", &vec![(); demos])?;
    Ok(())
}

/// Refuses what no fit could use, and what would judge itself.
fn refuse_unusable(inputs: &Inputs, paths: &[&PathBuf]) -> anyhow::Result<()> {
    let demos: Vec<&Demo> = inputs.demos.iter().chain(&inputs.held_out).collect();
    let hashes: Vec<u64> = [&inputs.hashes[..], &inputs.held_out_hashes[..]].concat();
    let first = &demos[0].spec.rope;
    for (index, (demo, path)) in demos.iter().zip(paths).enumerate() {
        let path = path.display();
        let rope = &demo.spec.rope;
        anyhow::ensure!(
            RopeShape::of_spec(rope).is_of_one_rope(&RopeShape::of_spec(first)),
            "{path}: its rope differs from that of {} in length, diameter or mass; one run identifies one rope, so give \
             each rope its own",
            paths[0].display()
        );
        if let Some(twin) = hashes[..index].iter().position(|&hash| hash == hashes[index]) {
            anyhow::bail!(
                "{path} is the same demonstration as {}; name it once, because it says nothing twice and cannot judge a fit \
                 to itself",
                paths[twin].display()
            );
        }
    }
    Ok(())
}

/// Hash of all files of a demonstration and their names, in the order of their names.
fn hash_folder(folder: &Path) -> anyhow::Result<u64> {
    let mut hash = Fnv64::default();
    for name in files(folder)? {
        hash.add(name.to_string_lossy().as_bytes());
        hash.add(&read_whole(&folder.join(name))?);
    }
    Ok(hash.value())
}

#[cfg(test)]
mod tests {
    use super::*;

    const SAMPLE: &str = "demos/sample-rope";

    fn inputs(held_out: &Path) -> Inputs {
        Inputs::load("red", &[Path::new(SAMPLE).join("fit")], &[held_out.to_path_buf()]).unwrap()
    }

    /// Copies the files of a demonstration.
    fn copy(from: &Path, to: &Path) {
        std::fs::create_dir_all(to).unwrap();
        for entry in std::fs::read_dir(from).unwrap() {
            let path = entry.unwrap().path();
            let to = to.join(path.file_name().unwrap());
            if path.is_dir() {
                copy(&path, &to);
            } else {
                std::fs::copy(&path, &to).unwrap();
            }
        }
    }

    #[test]
    fn a_demonstration_that_judges_counts_by_its_content() {
        let settings = RunSettings::of(Preset::Quick, 1);
        let folder = tempfile::tempdir().unwrap();
        let judge = folder.path().join("second");
        let keys = ["held-out-1", "held-out-2", "held-out-1"].map(|part| {
            let _ = std::fs::remove_dir_all(&judge);
            copy(&Path::new(SAMPLE).join(part), &judge);
            inputs(&judge).key(&settings)
        });
        assert_ne!(keys[0], keys[1]);
        assert_eq!(keys[0], keys[2]);
        assert_ne!(keys[0], inputs(&judge).key(&RunSettings::of(Preset::Quick, 2)));
    }

    #[test]
    fn what_lies_beside_a_demonstration_changes_nothing_and_a_twin_is_refused() {
        let settings = RunSettings::of(Preset::Quick, 1);
        let folder = tempfile::tempdir().unwrap();
        let judge = folder.path().join("second");
        copy(&Path::new(SAMPLE).join("held-out-1"), &judge);
        let before = inputs(&judge).key(&settings);
        std::fs::write(judge.join(".DS_Store"), "x").unwrap();
        std::fs::create_dir(judge.join("runs")).unwrap();
        assert_eq!(inputs(&judge).key(&settings), before);

        let fit = Path::new(SAMPLE).join("fit");
        let twice = [fit.clone(), judge.clone(), judge.clone()];
        for (demos, held_out) in [(&twice[..], &[][..]), (&twice[..1], &[fit.clone()][..])] {
            let refused = Inputs::load("red", demos, held_out).err().unwrap().to_string();
            assert!(refused.contains("is the same demonstration as"), "{refused}");
        }
    }

    /// A robot's clock begins anywhere.
    #[test]
    fn times_that_begin_elsewhere_are_refused_with_what_shifts_them() {
        let folder = tempfile::tempdir().unwrap();
        for (shift_s, words) in [(1.7e9, "begin at 1700000000 s"), (-1.0, "begin at -1 s")] {
            let mut demo = Demo::load(Path::new(SAMPLE).join("fit")).unwrap();
            for sample in demo.clamps.iter_mut().flatten() {
                sample.t_s += shift_s;
            }
            let crate::demo::Observations::Clouds(frames) = &mut demo.observations else {
                panic!("the sample has clouds");
            };
            frames.iter_mut().for_each(|frame| frame.t_s += shift_s);
            let path = folder.path().join(format!("by {shift_s}"));
            demo.save(&path).unwrap();
            let refused = Inputs::load("red", &[path], &[]).err().unwrap().to_string();
            assert!(
                refused.contains(words) && refused.contains("demo cut"),
                "{refused}"
            );
            let whole = [f64::NEG_INFINITY, f64::INFINITY];
            let cut = demo
                .cut(whole[0], whole[1], crate::demo::StartState::Rest)
                .unwrap();
            assert_eq!(crate::demo::clock_problem(&cut), None);
            assert_eq!(cut.spec, demo.spec);
        }
    }

    #[test]
    fn a_name_that_no_blob_holds_is_refused_before_anything_is_read() {
        let long = "x".repeat(33);
        let names = [
            ("", "empty"),
            (&*long, "choose a shorter one with --name"),
            ("../red", "not make the name of a folder"),
            ("a\nb", "not make the name of a folder"),
        ];
        for (name, words) in names {
            let refused = Inputs::load(name, &[PathBuf::from("nowhere")], &[]);
            let message = refused.err().unwrap().to_string();
            assert!(message.contains(words), "{message}");
        }
    }
}
