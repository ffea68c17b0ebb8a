//! The matrix: which causes, how strong, under how much noise, how often, and with what left out.

use super::reality::Repertoire;
use super::sight::floor_mm;
use super::truth::TruthKey;
use crate::diagnose::Part;
use crate::run_files::Fnv64;
use serde::{Deserialize, Serialize};

/// One diagnosis of known data.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cell {
    /// Name of the reality.
    pub world: String,
    /// Causes at work; none for a rope as the model knows it.
    pub causes: Vec<String>,
    /// Strength of each, in noise floors.
    pub floors: f64,
    /// Standard deviation of the cameras' noise, mm.
    pub noise_mm: f64,
    /// Seed of rope and noise.
    pub seed: u64,
    /// Whether the true causes are taken out of the library.
    pub hidden: bool,
    /// What is left out of the method.
    pub without: Option<Part>,
    /// Whether no other recording judges what is fitted, but parts of the same that are not.
    #[serde(default)]
    pub alone: bool,
    /// Whether the rope is seen as clouds of points, not as labelled ones.
    #[serde(default)]
    pub clouds: bool,
}

/// What kind of question a cell asks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Nothing is missing.
    Nothing,
    /// One effect of the library is missing.
    Single,
    /// Two are.
    Pair,
    /// Something is missing that the library does not hold.
    Foreign,
}

impl Cell {
    /// Name, which is that of its file too.
    pub fn name(&self) -> String {
        let mut name = self.data_name();
        if self.hidden {
            name += "-hidden";
        }
        match self.without {
            None => {}
            Some(Part::Whitening) => name += "-no-whitening",
            Some(Part::Nuisances) => name += "-no-nuisances",
            Some(Part::Refinement) => name += "-no-refinement",
        }
        if self.alone {
            name += "-alone";
        }
        name
    }

    /// Name of the data alone: what is asked of the same data has the same noise.
    fn data_name(&self) -> String {
        let causes = if self.causes.is_empty() {
            "none".into()
        } else {
            format!("{}-{}f", self.causes.join("+"), self.floors)
        };
        let seen = if self.clouds { "-clouds" } else { "" };
        format!("{}-{causes}-{}mm-s{}{seen}", self.world, self.noise_mm, self.seed)
    }

    /// Seed of the noise.
    pub fn noise_seed(&self) -> u64 {
        Fnv64::of(self.data_name().as_bytes())
    }

    /// What happened in it.
    pub fn truth(&self) -> TruthKey {
        TruthKey {
            world: self.world.clone(),
            causes: self.causes.clone(),
            strength_mm: self.floors * floor_mm(self),
            seed: self.seed,
        }
    }

    /// What it asks.
    pub fn kind(&self) -> Kind {
        let outside = |id: &String| crate::effects::find(id).is_none();
        match self.causes.len() {
            0 => Kind::Nothing,
            _ if self.hidden || self.causes.iter().any(outside) => Kind::Foreign,
            1 => Kind::Single,
            _ => Kind::Pair,
        }
    }
}

/// The least noise of cameras, mm.
const QUIET_MM: f64 = 0.5;

/// Pairs of causes; the last three are deliberately alike.
const PAIRS: [[&str; 2]; 8] = [
    ["tip_mass", "camera_offset"],
    ["clock_offset", "rest_curvature"],
    ["tilted_gravity", "density_gradient"],
    ["camera_offset", "gripper_lag"],
    ["bending_ratio", "clock_offset"],
    ["gripper_lag", "internal_damping"],
    ["tilted_gravity", "camera_offset"],
    ["tip_mass", "density_gradient"],
];

/// How much of the matrix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extent {
    /// A part of it at one noise.
    pub quick: bool,
    /// Seeds per cell.
    pub seeds: u64,
    /// First seed: figures that are quoted come from other seeds than those that were looked at while the
    /// diagnosis was worked on.
    pub first_seed: u64,
    /// As [`Cell::alone`] has it.
    pub alone: bool,
    /// As [`Cell::clouds`] has it.
    pub clouds: bool,
}

/// The matrix of one reality, in an order in which every beginning of it is a fair sample: seed by seed,
/// what matters most first.
pub fn matrix(plays: &Repertoire, extent: &Extent) -> Vec<Cell> {
    let mut cells = Vec::new();
    for seed in extent.first_seed..extent.first_seed + extent.seeds {
        let noises: &[f64] = if extent.quick {
            &[1.0]
        } else {
            &[1.0, QUIET_MM, 3.0]
        };
        for &noise_mm in noises {
            let empty = Cell {
                world: plays.world.clone(),
                causes: Vec::new(),
                floors: 0.0,
                noise_mm,
                seed,
                hidden: false,
                without: None,
                alone: extent.alone,
                clouds: extent.clouds,
            };
            cells.extend(of_seed(plays, extent, &empty));
        }
    }
    cells
}

fn of_seed(plays: &Repertoire, extent: &Extent, empty: &Cell) -> Vec<Cell> {
    let with = |causes: &[&str], floors: f64| Cell {
        causes: causes.iter().map(ToString::to_string).collect(),
        floors,
        ..empty.clone()
    };
    let without = |cell: &Cell, part: Part| Cell {
        without: Some(part),
        ..cell.clone()
    };
    let effects = &plays.effects;
    let mut cells = vec![empty.clone()];
    let strengths: &[f64] = if extent.quick {
        &[5.0, 2.0]
    } else {
        &[5.0, 2.0, 1.0, 10.0]
    };
    for &floors in strengths {
        cells.extend(effects.iter().map(|id| with(&[id], floors)));
        cells.extend(plays.outside.iter().map(|id| with(&[id], floors)));
    }
    cells.extend(effects.iter().map(|id| Cell {
        hidden: true,
        ..with(&[id], 5.0)
    }));
    let played = |pair: &&[&str; 2]| pair.iter().all(|id| effects.iter().any(|e| e == id));
    cells.extend(PAIRS.iter().filter(played).map(|pair| with(pair, 5.0)));
    let mut asked_again = vec![
        empty.clone(),
        with(&["camera_offset"], 2.0),
        with(&["camera_offset"], 5.0),
    ];
    if extent.quick {
        // Under less noise the simulation's own error shows.
        let quiet = Cell {
            noise_mm: QUIET_MM,
            ..empty.clone()
        };
        cells.push(quiet.clone());
        asked_again.push(quiet);
    }
    for part in [Part::Whitening, Part::Nuisances, Part::Refinement] {
        cells.extend(asked_again.iter().map(|cell| without(cell, part)));
    }
    cells
}

#[cfg(test)]
mod tests {
    use super::super::reality::{Finer, Reality};
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn cells_have_names_of_their_own_and_the_quick_matrix_is_part_of_the_full_one() {
        let extent = |quick: bool| Extent {
            quick,
            seeds: 2,
            first_seed: 1,
            alone: false,
            clouds: false,
        };
        let names = |quick: bool| -> Vec<String> {
            matrix(&Finer.repertoire(), &extent(quick))
                .iter()
                .map(Cell::name)
                .collect()
        };
        let full: BTreeSet<String> = names(false).into_iter().collect();
        assert_eq!(full.len(), names(false).len());
        assert!(names(true).iter().all(|name| full.contains(name)));
    }

    #[test]
    fn what_is_asked_of_the_same_data_has_the_same_noise() {
        let asked = |alone: bool, clouds: bool| {
            matrix(
                &Finer.repertoire(),
                &Extent {
                    quick: true,
                    seeds: 1,
                    first_seed: 1,
                    alone,
                    clouds,
                },
            )
        };
        let cells = [asked(false, false), asked(true, false), asked(false, true)].concat();
        let find = |name: &str| cells.iter().find(|c| c.name() == name).unwrap().noise_seed();
        assert_eq!(find("g2-tip_mass-5f-1mm-s1"), find("g2-tip_mass-5f-1mm-s1-alone"));
        assert_eq!(
            find("g2-tip_mass-5f-1mm-s1"),
            find("g2-tip_mass-5f-1mm-s1-hidden")
        );
        assert_ne!(find("g2-tip_mass-5f-1mm-s1"), find("g2-tip_mass-2f-1mm-s1"));
        assert_ne!(
            find("g2-tip_mass-5f-1mm-s1"),
            find("g2-tip_mass-5f-1mm-s1-clouds")
        );
    }
}
