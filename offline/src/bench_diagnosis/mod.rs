//! How often the diagnosis is right: ropes whose missing cause is known are diagnosed as measured ones
//! are, and the answers are counted (`offline bench-diagnosis`).
//!
//! Data flows one way: [`experiment`] says what is done with the rope, a [`reality`] plays it, [`truth`]
//! finds how large a cause must be to be seen that well and keeps what really happened, [`sight`] sees it and [`noise`]
//! spoils what it sees, [`cells`] lists what is diagnosed, [`run`] does so and keeps every answer, [`mod@follow_up`] makes the
//! demonstration that an answer proposes, [`mod@tally`] counts, `ablations` compares with what is said without a part of
//! the method, and [`mod@table`] prints.
//!
//! No reality is the fitter's own simulation. G2 is the simulator with other particles on a grid
//! twice as fine with half the time step ([`reality::Finer`]); G3 is the independent rod of the crate `tests`,
//! which this crate cannot and must not call: its program `twin-truths` writes what happened to the
//! folder in which `offline bench-diagnosis` looks for it.

mod ablations;
pub mod cells;
pub mod experiment;
pub mod follow_up;
pub mod noise;
pub mod reality;
pub mod run;
pub mod sight;
pub mod table;
pub mod tally;
pub mod truth;

use self::cells::{Cell, Extent, matrix};
use self::reality::{Finer, Reality, Repertoire};
use self::run::{Answers, Missing};
use self::tally::{Tally, tally};
use self::truth::TruthKey;
use crate::run_files::{read_whole, write_whole};
use anyhow::Context;
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Largest median error of an effect's value, for G2 and for any other reality.
const VALUE_TARGETS: [f64; 2] = [0.1, 0.2];

/// Where a reality that is no part of this program says what it has played.
fn repertoire_file(out: &Path, world: &str) -> PathBuf {
    out.join("truths").join(format!("{world}.json"))
}

/// Plays everything that the matrix asks of a reality into the folder of a benchmark, what is there
/// already excepted; `only` chooses as in [`chosen`]. `told` hears of every truth.
///
/// # Errors
/// A rope without a cause cannot be moved, or a file cannot be written.
pub fn play(
    reality: &dyn Reality,
    extent: &Extent,
    only: &[String],
    out: &Path,
    told: &(dyn Fn(&str) + Sync),
) -> anyhow::Result<()> {
    let plays = reality.repertoire();
    let mut keys: Vec<TruthKey> = Vec::new();
    for cell in chosen(matrix(&plays, extent), only) {
        if !keys.contains(&cell.truth()) {
            keys.push(cell.truth());
        }
    }
    keys.iter()
        .par_bridge()
        .try_for_each(|key| -> anyhow::Result<()> {
            let truth = truth::make(reality, key, &out.join("truths"))?;
            told(&match truth.missing {
                None => format!("{}: {:?}", key.name(), truth.parts),
                Some(reason) => format!("{}: {reason}", key.name()),
            });
            Ok(())
        })?;
    let file = repertoire_file(out, &plays.world);
    Ok(write_whole(&file, &serde_json::to_vec_pretty(&plays)?)?)
}

/// The cells whose name contains one of `only`, all where it is empty; what is a cell's whole name chooses that cell alone.
pub fn chosen(mut cells: Vec<Cell>, only: &[String]) -> Vec<Cell> {
    let names: Vec<String> = cells.iter().map(Cell::name).collect();
    let fits = |name: &str, part: &String| match names.contains(part) {
        true => name == part,
        false => name.contains(part),
    };
    cells.retain(|cell| only.is_empty() || only.iter().any(|part| fits(&cell.name(), part)));
    cells
}

/// All cells of an extent: of G2, and of G3 where its truths are in the folder.
///
/// # Errors
/// The list of what G3 plays cannot be read.
pub fn questions(out: &Path, extent: &Extent) -> anyhow::Result<Vec<Cell>> {
    let mut cells = matrix(&Finer.repertoire(), extent);
    let file = repertoire_file(out, "g3");
    if file.exists() {
        let plays: Repertoire = serde_json::from_slice(&read_whole(&file)?)
            .with_context(|| format!("{} is damaged: make it again", file.display()))?;
        let others = matrix(&plays, extent);
        // One of each in turn, so that a run that is stopped has some of both.
        let mut mixed = Vec::with_capacity(cells.len() + others.len());
        let (mut a, mut b) = (cells.into_iter(), others.into_iter());
        loop {
            let next = [a.next(), b.next()];
            if next.iter().all(Option::is_none) {
                break;
            }
            mixed.extend(next.into_iter().flatten());
        }
        cells = mixed;
    }
    Ok(cells)
}

/// Counts answers, each reality for itself.
pub fn counted(all: &Answers) -> Vec<Tally> {
    let answers = &all.answers;
    ["g2", "g3"]
        .into_iter()
        .zip(VALUE_TARGETS)
        .filter(|(world, _)| answers.iter().any(|a| a.cell.world == *world))
        .map(|(world, target)| {
            let left_out = all.left_out.iter().filter(|(cell, _)| cell.world == *world);
            let missing: Vec<&Missing> = left_out.map(|(_, missing)| missing).collect();
            tally(world, answers, &missing, target)
        })
        .collect()
}
