//! The loop: fit, score, refit the best, gate, accept, repeat.

use super::conclude::{Facts, WHITE_FLOORS, conclude, excess_mm};
use super::gates::{Gate, refinement_gate, statistical_gates};
use super::noise::Noise;
use super::score::{Score, ScoreProblem, ScoreTable};
use super::verdict::{ReasonCode, Verdict};
use crate::demo::Demo;
use crate::effects;
use crate::fit::{
    Evaluation, FINER, FitError, FitOptions, FitResult, FrameShare, Problem, Resolution, along_rows,
    estimates, estimates_within, fit, fit_from, grid_errors, grid_shift,
};
use crate::model::{Estimate, Structure};
use crate::residual::ResidualSummary;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Settings of the loop.
#[derive(Clone, Debug, PartialEq)]
pub struct LoopOptions {
    /// Grid of the fits.
    pub resolution: Resolution,
    /// Finer grid that tells physics from discretisation.
    pub finer: Resolution,
    /// Starts and budget of the first fit.
    pub fit: FitOptions,
    /// How many of the best effects are refitted in full per round.
    pub refits: usize,
    /// Most effects that are accepted.
    pub max_effects: usize,
    /// Smallest relative drop of the held-out error that counts.
    pub smallest_gain: f64,
    /// Smallest share of the excess over the noise that an effect has to explain.
    pub smallest_share: f64,
    /// Seed of the pseudo-data.
    pub seed: u64,
    /// Effects of the library, as indices into [`effects::ALL`], that the loop does not know.
    pub hidden: Vec<usize>,
    /// What is left out of the method.
    pub without: Option<Part>,
}

/// A part of the method that can be left out, to see what it is worth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Part {
    /// Correlated noise is taken out before anything is tested.
    Whitening,
    /// The cameras' pose is free in every score, and no effect is blamed for it.
    Nuisances,
    /// An effect has to stay the same on a finer grid.
    Refinement,
}

impl LoopOptions {
    /// Defaults on a grid; the finer one has [`FINER`] times the cells.
    pub fn new(resolution: Resolution, seed: u64) -> Self {
        Self {
            resolution,
            finer: Resolution {
                cells: FINER * resolution.cells,
            },
            fit: FitOptions::default(),
            refits: 2,
            max_effects: 3,
            smallest_gain: 0.05,
            smallest_share: 0.3,
            seed,
            hidden: Vec::new(),
            without: None,
        }
    }
}

/// A full refit with one more effect.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Refit {
    /// Index into [`effects::ALL`].
    #[serde(skip)]
    pub effect: usize,
    /// Name of the effect.
    pub id: String,
    /// Parameters of the effect.
    pub parameters: Vec<Estimate>,
    /// All parameters of the model, as the fit takes them.
    pub theta: Vec<f64>,
    /// Residual where fitted.
    pub fit: ResidualSummary,
    /// Residual where held out.
    pub held_out: ResidualSummary,
    /// Gates in the order in which they were tried.
    pub gates: Vec<Gate>,
    /// Whether all gates were passed.
    pub passed: bool,
}

/// One round of the loop.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Round {
    /// Effects of the model at the start of the round.
    pub known: Vec<String>,
    /// Scores of the others.
    pub table: ScoreTable,
    /// Refits of the best.
    pub refits: Vec<Refit>,
    /// The effect that was accepted.
    pub accepted: Option<String>,
}

/// Everything that the loop found.
pub struct Outcome {
    /// Effects of the final model.
    pub structure: Structure,
    /// Final fit.
    pub fitted: FitResult,
    /// Base fit, without any effect.
    pub base: FitResult,
    /// Held-out evaluation of the base model.
    pub held_out_before: Evaluation,
    /// Held-out evaluation of the final model.
    pub held_out_after: Evaluation,
    /// Rounds in order.
    pub rounds: Vec<Round>,
    /// Verdict.
    pub verdict: Verdict,
    /// Reasons for caution.
    pub reasons: Vec<ReasonCode>,
    /// Measured over declared noise.
    pub noise_scale: Option<f64>,
    /// Effects that fit as well as the last one found.
    pub rivals: Vec<String>,
    /// Slopes of the whole library in the last round; none where no round was needed or they were not kept.
    pub library: Option<Library>,
    /// How far the simulation's own error may have moved each entry of the final θ.
    pub grid_shift: Vec<f64>,
}

impl Outcome {
    /// Parameters of the final model. Their standard errors hold both what the noise and what the simulation's
    /// own error may have moved.
    pub fn estimates(&self) -> Vec<Estimate> {
        estimates_within(&self.fitted.best, &self.structure, &self.grid_shift)
    }
}

/// A model with the whole library appended at its vanishing values, where a round started.
pub struct Library {
    /// Effects of the model, then the others.
    pub structure: Structure,
    /// The demonstrations that are fitted.
    pub evaluation: Evaluation,
}

/// Last share of a demonstration that is held out when no other demonstration is.
const HELD_OUT_SHARE: f64 = 0.3;

/// How many of the best scores are told while the loop runs.
const LISTED: usize = 8;
/// Most evaluations of a refit: it starts from a one-step estimate.
pub(super) const REFIT_EVALUATIONS: usize = 24;

/// The problems where a loop fits and where it judges: other demonstrations where there are any, else
/// the last part of the same.
///
/// # Errors
/// A demonstration cannot be simulated.
pub fn problems<'a>(
    demos: &[&'a Demo],
    held_out: &[&'a Demo],
    options: &LoopOptions,
) -> Result<(Problem<'a>, Problem<'a>), FitError> {
    let mut fit = Problem::new(demos, options.resolution)?;
    let judge = if held_out.is_empty() {
        let mut last = Problem::new(demos, options.resolution)?;
        let split = 1.0 - HELD_OUT_SHARE;
        last.frames = FrameShare { from: split, to: 1.0 };
        fit.frames = FrameShare { from: 0.0, to: split };
        last
    } else {
        Problem::new(held_out, options.resolution)?
    };
    Ok((fit, judge))
}

/// What the loop works on.
struct Bench<'a> {
    fit: Problem<'a>,
    held_out: Problem<'a>,
    finer: Problem<'a>,
    noise: Noise,
}

impl<'a> Bench<'a> {
    fn new(demos: &[&'a Demo], held_out: &[&'a Demo], options: &LoopOptions) -> Result<Self, FitError> {
        let (fit, held_out) = problems(demos, held_out, options)?;
        let mut finer = Problem::new(demos, options.finer)?;
        finer.frames = fit.frames;
        Ok(Self {
            fit,
            held_out,
            finer,
            noise: Noise::DECLARED,
        })
    }

    fn set_noise(&mut self, noise: Noise, options: &LoopOptions) {
        for problem in [&mut self.fit, &mut self.held_out, &mut self.finer] {
            problem.noise_scale = noise.scale;
        }
        self.noise = if options.without == Some(Part::Whitening) {
            Noise {
                scale: noise.scale,
                ..Noise::DECLARED
            }
        } else {
            noise
        };
    }
}

/// Runs the loop. `progress` hears one line per step.
///
/// # Errors
/// The base model cannot be fitted.
pub fn close_loop(
    demos: &[&Demo],
    held_out: &[&Demo],
    options: &LoopOptions,
    progress: &dyn Fn(&str),
) -> Result<Outcome, FitError> {
    let mut bench = Bench::new(demos, held_out, options)?;
    let mut structure = Structure::default();
    progress("fitting the base model from several starts");
    let mut base = fit(&bench.fit, &structure, &options.fit)?;
    let times: Vec<Vec<f64>> = bench.fit.scenes.iter().map(|s| s.frame_times_s.clone()).collect();
    let noise = Noise::at_rest(demos, &base.best, &times);
    if let Some(noise) = noise {
        bench.set_noise(noise, options);
        for row in base.best.rows.iter_mut().flatten() {
            row.sigma_m *= noise.scale;
        }
    }
    let held_out_before = bench.held_out.residuals(&structure, &base.best.theta)?;
    let mut fitted = bench.again(&structure, &base.best.theta)?;
    let mut held_now = ResidualSummary::of(&held_out_before);
    let mut rounds: Vec<Round> = Vec::new();
    let (mut rivals, mut library) = (Vec::new(), None);
    while structure.effects.len() < options.max_effects
        && ResidualSummary::of(&fitted.best).floors > WHITE_FLOORS
        && !only_numerical(&fitted, &rounds)
    {
        let (round, winner, slopes) = one_round(&bench, &structure, &fitted, &held_now, options, progress)?;
        library = Some(slopes);
        let done = winner.is_none();
        if let Some((next_structure, next_fit, next_held, tied)) = winner {
            rivals = tied;
            (structure, fitted, held_now) = (next_structure, next_fit, next_held);
        }
        rounds.push(round);
        if done {
            break;
        }
    }
    let held_out_after = bench.held_out.residuals(&structure, &fitted.best.theta)?;
    progress("estimating what the grid itself may have moved");
    let grid_shift = grid_shift([&bench.fit, &bench.finer], &structure, &fitted.best)?;
    let (verdict, reasons) = conclude(&Facts {
        structure: &structure,
        base: &ResidualSummary::of(&base.best),
        fitted: &fitted,
        estimates: &estimates_within(&fitted.best, &structure, &grid_shift),
        rounds: &rounds,
        rivals: &rivals,
        demos: [demos.len(), held_out.len()],
        pure_error: noise.is_some(),
    });
    Ok(Outcome {
        structure,
        fitted,
        base,
        held_out_before,
        held_out_after,
        rounds,
        verdict,
        reasons,
        noise_scale: noise.map(|n| n.scale),
        rivals,
        library,
        grid_shift,
    })
}

/// Whether the last round explained everything but what the simulation itself is known to be off by. No
/// further effect could be believed, and a round takes as long as all before it.
fn only_numerical(fitted: &FitResult, rounds: &[Round]) -> bool {
    rounds
        .last()
        .is_some_and(|round| round.accepted.is_some() && excess_mm(fitted) <= round.table.discretisation_mm)
}

impl Bench<'_> {
    /// The evaluation at a known optimum, with the noise as it is set now.
    fn again(&self, structure: &Structure, theta: &[f64]) -> Result<FitResult, FitError> {
        fit_from(&self.fit, structure, theta.to_vec(), 1)
    }
}

/// A refit with the model that it gave.
type Tried = (Refit, Structure, FitResult);
/// The model that won a round: structure, fit, held-out residual, name of its new effect.
type Best = (Structure, FitResult, ResidualSummary, String);
/// All refits of a round, the winner, and the effects that tie with it.
type Chosen = (Vec<Refit>, Option<Best>, Vec<String>);
/// The next model and the effects that tie with its new one.
type Winner = (Structure, FitResult, ResidualSummary, Vec<String>);

fn one_round(
    bench: &Bench,
    structure: &Structure,
    fitted: &FitResult,
    held_now: &ResidualSummary,
    options: &LoopOptions,
    progress: &dyn Fn(&str),
) -> Result<(Round, Option<Winner>, Library), FitError> {
    progress("scoring every effect of the library from one pass of tangents");
    let (table, library) = score(bench, structure, &fitted.best.theta, options)?;
    let listed = table.scores.iter().take(LISTED);
    let listed: Vec<String> = listed
        .map(|s| format!("{} {:.0} (of {:.0})", s.id, s.statistic, s.threshold))
        .collect();
    progress(&format!("best scores (needed): {}", listed.join(", ")));
    let now = ResidualSummary::of(&fitted.best);
    let chosen = leading(&table, options.refits);
    progress(&format!(
        "refitting with {}",
        if chosen.is_empty() {
            "nothing: no effect is significant".into()
        } else {
            names(&chosen).join(", ")
        }
    ));
    let tried: Vec<Tried> = chosen
        .par_iter()
        .filter_map(|score| refit(bench, structure, fitted, score, (&now, held_now), options).ok())
        .collect();
    let (refits, winner, tied) = choose(bench, tried, options, progress)?;
    let accepted = winner.as_ref().map(|w| w.3.clone());
    let round = Round {
        known: structure
            .effects
            .iter()
            .map(|&e| effects::ALL[e].id.into())
            .collect(),
        table,
        refits,
        accepted,
    };
    Ok((round, winner.map(|(s, f, h, _)| (s, f, h, tied)), library))
}

/// Tries the finer grid on the refits that passed, best held-out error first, and names the winner and
/// those that tie with it.
fn choose(
    bench: &Bench,
    mut tried: Vec<Tried>,
    options: &LoopOptions,
    progress: &dyn Fn(&str),
) -> Result<Chosen, FitError> {
    let refined = options.without != Some(Part::Refinement);
    tried.sort_by(|a, b| a.0.held_out.rms_mm.total_cmp(&b.0.held_out.rms_mm));
    let mut winner = None;
    let mut refits = Vec::new();
    let mut tied = Vec::new();
    for (mut refit, next_structure, next_fit) in tried {
        if refined && winner.is_none() && refit.passed {
            progress(&format!("checking {} on a finer grid", refit.id));
            let gate = refine(bench, &next_structure, &next_fit)?;
            refit.passed &= gate.passed;
            refit.gates.push(gate);
        }
        if refit.passed {
            match &winner {
                None => winner = Some((next_structure, next_fit, refit.held_out.clone(), refit.id.clone())),
                Some((_, best, _, _)) if ties(best, &next_fit) => tied.push(refit.id.clone()),
                Some(_) => {}
            }
        }
        refits.push(refit);
    }
    Ok((refits, winner, tied))
}

/// Effects worth a full refit: the best `count`, the whole family of the best, because only refits can
/// tell its members apart, and whatever the other scores hold to be free.
fn leading(table: &ScoreTable, count: usize) -> Vec<&Score> {
    let significant: Vec<&Score> = table.scores.iter().filter(|s| s.significant()).collect();
    let nuisance = |s: &Score| effects::ALL[s.effect].nuisance;
    let Some(best) = significant.iter().find(|s| !nuisance(s)) else {
        return significant;
    };
    let ranked = significant.iter().filter(|s| !nuisance(s)).take(count);
    let related = significant
        .iter()
        .filter(|s| nuisance(s) || best.family.contains(&s.id));
    let mut chosen: Vec<&Score> = ranked.copied().collect();
    for score in related {
        if chosen.iter().all(|c| c.id != score.id) {
            chosen.push(score);
        }
    }
    chosen
}

fn names(scores: &[&Score]) -> Vec<String> {
    scores.iter().map(|s| s.id.clone()).collect()
}

/// Two models tie when their sums of squares per independent offset differ by less than two standard
/// errors of such a sum.
pub(super) fn ties(best: &FitResult, other: &FitResult) -> bool {
    let reduced = |f: &FitResult| ResidualSummary::of(&f.best).correlation.reduced_chi_square;
    reduced(other) - reduced(best) < tie_spread(&best.best)
}

/// Difference of sums of squares per offset below which a model ties with the best.
pub(super) fn tie_spread(best: &Evaluation) -> f64 {
    let summary = ResidualSummary::of(best);
    2.0 * (2.0 / summary.effective_rows.max(1.0)).sqrt() * summary.correlation.reduced_chi_square
}

fn score(
    bench: &Bench,
    structure: &Structure,
    theta: &[f64],
    options: &LoopOptions,
) -> Result<(ScoreTable, Library), FitError> {
    let mut wide = structure.clone();
    let mut wide_theta = theta.to_vec();
    for (index, spec) in effects::ALL.iter().enumerate() {
        let asked = !structure.effects.contains(&index) && !options.hidden.contains(&index);
        if asked && bench.fit.knows(index) {
            wide.effects.push(index);
            wide_theta.extend(spec.parameters.iter().map(|p| p.vanishes_at));
        }
    }
    let (evaluation, difference) = rayon::join(
        || bench.fit.evaluate(&wide, &wide_theta),
        || grid_errors([&bench.fit, &bench.finer], structure, theta),
    );
    let (evaluation, difference) = (evaluation?, difference?);
    let errors = along_rows(&evaluation, &difference);
    let sigmas: Vec<f64> = evaluation.all_rows().map(|r| r.sigma_m).collect();
    let nuisances = options.without != Some(Part::Nuisances);
    let problem = ScoreProblem::new(&evaluation, &wide, structure, &bench.noise, nuisances);
    let table = problem.table(&errors, &sigmas, options.seed);
    let library = Library {
        structure: wide,
        evaluation,
    };
    Ok((table, library))
}

/// θ of a fit where the data told it, the prior's centre where they did not: what a model that lacks an effect
/// makes of the rest, often a value at its bound, is a bad start for one that has it.
fn told(fitted: &FitResult, structure: &Structure) -> Vec<f64> {
    let all = estimates(&fitted.best, structure);
    let start = all.iter().zip(&fitted.best.theta).zip(structure.parameters());
    start
        .map(|((estimate, &theta), info)| {
            if estimate.identified {
                theta
            } else {
                info.prior_mean
            }
        })
        .collect()
}

fn refit(
    bench: &Bench,
    structure: &Structure,
    fitted: &FitResult,
    score: &Score,
    before: (&ResidualSummary, &ResidualSummary),
    options: &LoopOptions,
) -> Result<(Refit, Structure, FitResult), FitError> {
    let next = structure.with(score.effect);
    let spec = &effects::ALL[score.effect];
    let mut theta = told(fitted, structure);
    for (p, e) in spec.parameters.iter().zip(&score.estimate) {
        // A one-step estimate can overshoot; half the physical range is a safe start.
        theta.push((p.vanishes_at + e).clamp(0.5 * (p.low + p.vanishes_at), 0.5 * (p.high + p.vanishes_at)));
    }
    let result = fit_from(&bench.fit, &next, theta, REFIT_EVALUATIONS)?;
    let held_out = bench.held_out.residuals(&next, &result.best.theta)?;
    let all = estimates(&result.best, &next);
    let first = all.len() - spec.parameters.len();
    let mut refit = Refit {
        effect: score.effect,
        id: spec.id.into(),
        parameters: all[first..].to_vec(),
        theta: result.best.theta.clone(),
        fit: ResidualSummary::of(&result.best),
        held_out: ResidualSummary::of(&held_out),
        gates: Vec::new(),
        passed: false,
    };
    refit.gates = statistical_gates(score, before, &refit, options);
    refit.passed = refit.gates.iter().all(|g| g.passed);
    Ok((refit, next, result))
}

/// One Gauss-Newton step on the finer grid from the estimate on the fit's grid.
fn refine(bench: &Bench, structure: &Structure, fitted: &FitResult) -> Result<Gate, FitError> {
    let fine = fit_from(&bench.finer, structure, fitted.best.theta.clone(), 2)?;
    let effect = structure.effects[structure.effects.len() - 1];
    let spec = &effects::ALL[effect];
    let first = fitted.best.theta.len() - spec.parameters.len();
    let change = |theta: &[f64]| -> Vec<f64> {
        theta[first..]
            .iter()
            .zip(spec.parameters)
            .map(|(t, p)| t - p.vanishes_at)
            .collect()
    };
    let errors: Vec<f64> = estimates(&fitted.best, structure)[first..]
        .iter()
        .map(|e| e.standard_error)
        .collect();
    Ok(refinement_gate(
        &change(&fitted.best.theta),
        &change(&fine.best.theta),
        &errors,
    ))
}
