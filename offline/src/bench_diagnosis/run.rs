//! Diagnoses cells and keeps every answer in a file of its own, so that a run that was stopped goes on
//! where it stopped.

use super::cells::Cell;
use super::experiment::{FITTED, MOTIONS, SEALED};
use super::follow_up::{FollowUp, follow_up};
use super::reality::{Finer, Reality};
use super::sight::see;
use super::truth::{self, Truth};
use crate::countdown::Countdown;
use crate::demo::Demo;
use crate::diagnose::{
    Invariance, LoopOptions, Outcome, ReasonCode, ScoreTable, Verdict, base_scores, close_loop,
};
use crate::effects;
use crate::fit::{Evaluation, FitError, Problem, Resolution};
use crate::model::Structure;
use crate::residual::ResidualSummary;
use crate::run_files::{kept, made_by, write_whole};
use crate::tell::Silent;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// The kind of a verdict.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Said {
    /// Nothing is missing.
    Nothing,
    /// These effects are.
    Explained,
    /// One of these is.
    Confounded,
    /// Something is, and it is not known what.
    Unexplained,
    /// The diagnosis stopped with an error.
    Failed,
}

/// A parameter of an effect that was found, beside the truth.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Value {
    /// `<effect>.<parameter>`.
    pub name: String,
    /// Estimate.
    pub value: f64,
    /// Its standard error.
    pub standard_error: f64,
    /// What it is in truth; none where the effect is not at work.
    pub truth: Option<f64>,
    /// Difference of the truth from nothing, in smallest sizes of interest: the largest of an effect's
    /// parameters leads it.
    pub size: f64,
    /// Where the effect vanishes.
    pub vanishes_at: f64,
}

/// What the diagnosis said of a cell.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Answer {
    /// The program that gave it.
    #[serde(default)]
    pub made_by: String,
    /// [`Truth::fingerprint`] of what it answers.
    #[serde(default)]
    pub truth: u64,
    /// The cell.
    pub cell: Cell,
    /// Kind of the verdict.
    pub said: Said,
    /// The verdict in words, or the error.
    pub words: String,
    /// Reasons for caution.
    pub reasons: Vec<ReasonCode>,
    /// Effects that were accepted, in order, whatever the verdict makes of them.
    pub accepted: Vec<String>,
    /// Effects that the verdict names.
    pub named: Vec<String>,
    /// Effects that the verdict holds to be possible: those named and their rivals.
    pub set: Vec<String>,
    /// Parameters of what was named.
    pub values: Vec<Value>,
    /// Held-out error of base model and final model, and the noise floor there, mm.
    pub held_out_mm: [f64; 3],
    /// The same in a motion that neither fit nor choice of the model has seen; none where it could not be simulated.
    #[serde(default)]
    pub sealed_mm: Option<[f64; 3]>,
    /// Error where fitted, of base model and final model, and the noise floor there, mm.
    pub fitted_mm: [f64; 3],
    /// Discretisation error that the first round estimated, mm.
    pub discretisation_mm: f64,
    /// Effects whose score on the base model was significant, be it that nothing was left to score; none where they could not
    /// be scored.
    #[serde(default)]
    pub significant: Option<Vec<String>>,
    /// Every refit: effect and the gates that it failed.
    pub refits: Vec<(String, Vec<String>)>,
    /// How the accepted effects fare in parts of what was fitted.
    #[serde(default)]
    pub invariances: Vec<Invariance>,
    /// Time of the diagnosis, s.
    pub wall_s: f64,
    /// What came of the demonstration that was proposed, where models were left alike.
    #[serde(default)]
    pub follow_up: Option<FollowUp>,
}

/// The file of a cell's answer.
pub fn file(out: &Path, cell: &Cell) -> PathBuf {
    out.join("cells").join(format!("{}.json", cell.name()))
}

/// The answer of an earlier run of this program to the truth that is there; none of another version, nor to another truth.
pub fn answered(out: &Path, cell: &Cell) -> Option<Answer> {
    let answer = kept::<Answer>(&file(out, cell)).filter(|answer| answer.made_by == made_by())?;
    (known_truth(out, cell)?.fingerprint() == answer.truth).then_some(answer)
}

/// Whether an earlier run found that there is no such cell.
pub fn was_left_out(out: &Path, cell: &Cell) -> bool {
    known_truth(out, cell).is_some_and(|truth| truth.missing.is_some())
}

fn known_truth(out: &Path, cell: &Cell) -> Option<Truth> {
    let truth = truth::read(&out.join("truths"), &cell.truth()).ok().flatten();
    // The other realities make theirs anew themselves.
    truth.filter(|truth| cell.world != Finer.name() || truth.reality_revision == Finer.revision())
}

/// What was answered.
#[derive(Debug, Default)]
pub struct Answers {
    /// In the order of the cells' names.
    pub answers: Vec<Answer>,
    /// Cells that were not asked, and why.
    pub left_out: Vec<(Cell, Missing)>,
}

/// Why a cell is not asked.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Missing {
    /// There is no such rope, for this reason: the cause cannot be so strong, no such size was found, or it cannot be
    /// simulated.
    NoSuchRope(String),
    /// Its truth is not in this file.
    NotMade(PathBuf),
}

impl std::fmt::Display for Missing {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::NoSuchRope(reason) => f.write_str(reason),
            Self::NotMade(file) => write!(f, "{} was not made", file.display()),
        }
    }
}

/// Answers of all cells whose truth is there, those of earlier runs included. Where a truth of G2 is not
/// there it is made; those of other realities are only read. Cells without a truth are left out; `told` hears why, and of
/// every answer.
///
/// # Errors
/// A file cannot be read or written, or the rope without a cause cannot be simulated.
pub fn run(cells: &[Cell], out: &Path, told: &(dyn Fn(&str) + Sync)) -> anyhow::Result<Answers> {
    let countdown = Countdown::of(cells.len());
    // A bridge hands the cells out in their order, so that a run that is stopped has the first of them.
    let answers = cells
        .iter()
        .par_bridge()
        .map(|cell| -> anyhow::Result<Result<Answer, (Cell, Missing)>> {
            if let Some(answer) = answered(out, cell) {
                countdown.ended(false);
                return Ok(Ok(answer));
            }
            let answer = match truth_of(cell, out)? {
                Ok(truth) => ask(cell, &truth),
                Err(reason) => {
                    countdown.ended(false);
                    told(&format!("{} is left out: {reason}", cell.name()));
                    return Ok(Err((cell.clone(), reason)));
                }
            };
            write_whole(&file(out, cell), &serde_json::to_vec_pretty(&answer)?)?;
            told(&format!(
                "{}: {} in {:.0} s: {}",
                countdown.ended(true),
                cell.name(),
                answer.wall_s,
                answer.words
            ));
            Ok(Ok(answer))
        })
        .collect::<anyhow::Result<Vec<_>>>()?;
    let mut all = Answers::default();
    for one in answers {
        match one {
            Ok(answer) => all.answers.push(answer),
            Err(cell) => all.left_out.push(cell),
        }
    }
    all.answers.sort_by_key(|answer| answer.cell.name());
    Ok(all)
}

/// What happened in a cell, or why that is not known.
fn truth_of(cell: &Cell, out: &Path) -> anyhow::Result<Result<Truth, Missing>> {
    let folder = out.join("truths");
    let key = cell.truth();
    let truth = if cell.world == Finer.name() {
        Some(truth::make(&Finer, &key, &folder)?)
    } else {
        truth::read(&folder, &key)?
    };
    Ok(match truth {
        None => Err(Missing::NotMade(truth::file(&folder, &key))),
        Some(truth) => match truth.missing.clone() {
            Some(reason) => Err(Missing::NoSuchRope(reason)),
            None => Ok(truth),
        },
    })
}

/// Spoils the truth of a cell with noise and diagnoses it.
pub fn ask(cell: &Cell, truth: &Truth) -> Answer {
    let demos: Vec<Demo> = MOTIONS
        .iter()
        .zip(&truth.tracks)
        .enumerate()
        .map(|(i, (motion, track))| see(cell, motion, track, cell.noise_seed().wrapping_add(i as u64)))
        .collect();
    let (fit, held_out) = demos.split_at(FITTED);
    let mut options = LoopOptions::new(Resolution::COARSEST, cell.noise_seed());
    options.without = cell.without;
    if cell.hidden {
        options.hidden = Structure::of_ids(&cell.causes).effects;
    }
    let start = Instant::now();
    let fit: Vec<&Demo> = fit.iter().collect();
    let held_out: Vec<&Demo> = held_out.iter().filter(|_| !cell.alone).collect();
    match close_loop(&fit, &held_out, &options, &Silent) {
        Ok(outcome) => {
            let plain = answer(cell, truth, &outcome, start.elapsed().as_secs_f64());
            let significant = match outcome.rounds.first() {
                Some(round) => Some(significant(&round.table)),
                None => base_scores(&fit, &held_out, &outcome, &options)
                    .ok()
                    .map(|table| significant(&table)),
            };
            Answer {
                significant,
                follow_up: follow_up(cell, truth, [&fit, &held_out], &outcome, &options),
                sealed_mm: sealed_mm(cell, truth, &outcome, options.finer).ok().flatten(),
                ..plain
            }
        }
        Err(error) => failed(cell, truth, error.to_string(), start.elapsed().as_secs_f64()),
    }
}

/// What base and final model leave of the sealed motion, and the noise floor there, mm; none where it was not played.
fn sealed_mm(
    cell: &Cell,
    truth: &Truth,
    outcome: &Outcome,
    resolution: Resolution,
) -> Result<Option<[f64; 3]>, FitError> {
    let Some(track) = truth.tracks.get(MOTIONS.len()) else {
        return Ok(None);
    };
    let seed = cell.noise_seed().wrapping_add(MOTIONS.len() as u64);
    let demo = see(cell, &SEALED, track, seed);
    let mut problem = Problem::new(&[&demo], resolution)?;
    problem.noise_scale = outcome.noise.scale;
    let left = |structure: &Structure, theta: &[f64]| -> Result<ResidualSummary, FitError> {
        Ok(ResidualSummary::of(&problem.residuals(structure, theta)?))
    };
    let before = left(&Structure::default(), &outcome.base.best.theta)?;
    let after = left(&outcome.structure, &outcome.fitted.best.theta)?;
    Ok(Some(errors_mm([before, after])))
}

/// Errors of base and final model and the noise floor, mm, of what they leave.
fn errors_mm([before, after]: [ResidualSummary; 2]) -> [f64; 3] {
    [before.rms_mm, after.rms_mm, after.floor_mm]
}

fn failed(cell: &Cell, truth: &Truth, words: String, wall_s: f64) -> Answer {
    Answer {
        made_by: made_by(),
        truth: truth.fingerprint(),
        cell: cell.clone(),
        said: Said::Failed,
        words,
        reasons: Vec::new(),
        accepted: Vec::new(),
        named: Vec::new(),
        set: Vec::new(),
        values: Vec::new(),
        held_out_mm: [0.0; 3],
        sealed_mm: None,
        fitted_mm: [0.0; 3],
        discretisation_mm: 0.0,
        significant: None,
        refits: Vec::new(),
        invariances: Vec::new(),
        wall_s,
        follow_up: None,
    }
}

fn answer(cell: &Cell, truth: &Truth, outcome: &Outcome, wall_s: f64) -> Answer {
    let accepted = outcome.structure.ids();
    let (said, named) = match &outcome.verdict {
        Verdict::NothingMissing => (Said::Nothing, Vec::new()),
        Verdict::Explained { .. } => (Said::Explained, accepted.clone()),
        Verdict::Confounded { .. } => (Said::Confounded, accepted.clone()),
        Verdict::Unexplained { .. } => (Said::Unexplained, Vec::new()),
    };
    let mut set = named.clone();
    if said == Said::Confounded {
        for id in outcome.rivals.iter().flat_map(|rival| &rival.effects) {
            if !set.contains(id) {
                set.push(id.clone());
            }
        }
    }
    let errors_mm = |left: [&Evaluation; 2]| errors_mm(left.map(ResidualSummary::of));
    Answer {
        made_by: made_by(),
        truth: truth.fingerprint(),
        cell: cell.clone(),
        said,
        words: outcome.verdict.to_string(),
        reasons: outcome.reasons.clone(),
        accepted,
        values: if named.is_empty() {
            Vec::new()
        } else {
            values(truth, outcome)
        },
        named,
        set,
        held_out_mm: errors_mm([&outcome.held_out_before, &outcome.held_out_after]),
        sealed_mm: None,
        fitted_mm: errors_mm([&outcome.base.best, &outcome.fitted.best]),
        discretisation_mm: outcome.rounds.first().map_or(0.0, |r| r.table.discretisation_mm),
        significant: None,
        refits: outcome
            .rounds
            .iter()
            .flat_map(|round| &round.refits)
            .map(|refit| {
                let missed = refit.gates.iter().filter(|g| !g.passed);
                (
                    effects::together(&refit.ids),
                    missed.map(|g| g.name.clone()).collect(),
                )
            })
            .collect(),
        invariances: outcome.invariances.clone(),
        wall_s,
        follow_up: None,
    }
}

/// Effects whose score is significant.
fn significant(table: &ScoreTable) -> Vec<String> {
    let scores = table.scores.iter().filter(|score| score.significant());
    scores.map(|score| score.id.clone()).collect()
}

fn values(truth: &Truth, outcome: &Outcome) -> Vec<Value> {
    let all = outcome.estimates();
    let mut list = Vec::new();
    for &effect in &outcome.structure.effects {
        let spec = &effects::ALL[effect];
        let true_values = truth
            .parts
            .iter()
            .find(|part| part.id == spec.id)
            .map(|p| &p.values);
        let own = &all[outcome.structure.entries(effect)];
        for (k, (parameter, estimate)) in spec.parameters.iter().zip(own).enumerate() {
            let truth = true_values.map(|values| values[k]);
            list.push(Value {
                name: estimate.name.clone(),
                value: estimate.value,
                standard_error: estimate.standard_error,
                truth,
                size: truth.map_or(0.0, |t| {
                    (t - parameter.vanishes_at).abs() / parameter.smallest_of_interest
                }),
                vanishes_at: parameter.vanishes_at,
            });
        }
    }
    list
}

#[cfg(test)]
mod tests {
    use super::super::tally::tests::answer;
    use super::*;

    /// The rod had been mended and its truths made anew; answers to the old ones still counted.
    #[test]
    fn an_answer_counts_for_the_truth_that_it_answers() {
        let out = tempfile::tempdir().unwrap();
        let plain = answer(&["tip_mass"], 5.0, &["tip_mass"], &[]);
        let cell = &plain.cell;
        let mut truth = Truth {
            revision: crate::sim::REVISION,
            reality_revision: Finer.revision(),
            key: cell.truth(),
            young_pa: 1e6,
            parts: Vec::new(),
            missing: None,
            tracks: vec![vec![vec![[0.1, 0.2, 0.3]]]],
        };
        let known = Answer {
            made_by: made_by(),
            truth: truth.fingerprint(),
            ..plain.clone()
        };
        let write = |path: PathBuf, bytes: Vec<u8>| write_whole(&path, &bytes).unwrap();
        write(file(out.path(), cell), serde_json::to_vec(&known).unwrap());
        assert_eq!(answered(out.path(), cell), None, "its truth is not there");
        let truths = truth::file(&out.path().join("truths"), &truth.key);
        write(truths.clone(), serde_json::to_vec(&truth).unwrap());
        assert_eq!(answered(out.path(), cell), Some(known));
        truth.tracks[0][0][0][2] = 0.4;
        write(truths, serde_json::to_vec(&truth).unwrap());
        assert_eq!(answered(out.path(), cell), None, "another truth");
    }
}
