//! The loop: fit, score, refit the best, gate, accept, repeat.

use super::choice::{Found, Standing};
use super::conclude::{Facts, WHITE_FLOORS, conclude, excess_mm, explains};
use super::gates::{MOST, all_physical, excess_removed, within_ranges};
use super::memory::{KeptFit, KeptModel, Memory};
use super::noise::Noise;
use super::revise::{better, needed};
use super::round::{Round, one_round};
use super::verdict::{ReasonCode, Verdict};
use crate::demo::Demo;
use crate::effects;
use crate::fit::{
    Evaluation, FINER, FitError, FitOptions, FitResult, FrameShare, Library, Problem, Resolution, estimates,
    estimates_within, fit, fit_from, grid_shift,
};
use crate::model::{Estimate, Structure};
use crate::residual::ResidualSummary;
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
    /// How many of the best effects go first when a round refits; others follow where these leave something.
    pub refits: usize,
    /// Most effects that are accepted; those of the cameras do not count.
    pub max_effects: usize,
    /// Smallest relative drop of the held-out error that counts.
    pub smallest_gain: f64,
    /// Smallest share of the excess over the noise that an effect has to explain.
    pub smallest_share: f64,
    /// Seed of the pseudo-data.
    pub seed: u64,
    /// Effects of the library, as indices into [`crate::effects::ALL`], that the loop does not know.
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
    /// Effects that a model lacks and that may be tried.
    pub(super) fn missing(&self, structure: &Structure) -> impl Iterator<Item = usize> {
        let may = |effect: &usize| !structure.effects.contains(effect) && !self.hidden.contains(effect);
        (0..effects::ALL.len()).filter(may)
    }

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

/// The problems where a loop fits and where it judges: other demonstrations where there are any, else
/// a part of the same ([`FrameShare::HeldOut`]).
///
/// # Errors
/// A demonstration cannot be simulated.
pub fn problems<'a>(
    demos: &[&'a Demo],
    held_out: &[&'a Demo],
    options: &LoopOptions,
) -> Result<(Problem<'a>, Problem<'a>), FitError> {
    let all = Problem::new(demos, options.resolution)?;
    if held_out.is_empty() {
        let judge = all.clone().of_share(FrameShare::HeldOut);
        return Ok((all.of_share(FrameShare::Fitted), judge));
    }
    Ok((all, Problem::new(held_out, options.resolution)?))
}

/// What the loop works on.
pub(super) struct Bench<'a> {
    pub(super) fit: Problem<'a>,
    pub(super) held_out: Problem<'a>,
    pub(super) finer: Problem<'a>,
    pub(super) noise: Noise,
}

impl<'a> Bench<'a> {
    pub(super) fn new(
        demos: &[&'a Demo],
        held_out: &[&'a Demo],
        options: &LoopOptions,
    ) -> Result<Self, FitError> {
        let (fit, held_out) = problems(demos, held_out, options)?;
        let finer = Problem::new(demos, options.finer)?.of_share(fit.frames);
        Ok(Self {
            fit,
            held_out,
            finer,
            noise: Noise::DECLARED,
        })
    }

    /// By how much of its square the noise floor under a fit may lie too low.
    pub(super) fn doubt(&self, fitted: &FitResult) -> f64 {
        self.noise.doubt(fitted.best.len())
    }

    /// Every model is sought near the base model's best, where ropes hang.
    fn settle(&mut self, theta: &[f64]) -> Result<(), FitError> {
        let base = Structure::default();
        self.fit = self.fit.settled(&base, theta)?;
        for other in [&mut self.held_out, &mut self.finer] {
            *other = other.settled_near(&self.fit, &base, theta)?;
        }
        Ok(())
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

/// A fit of the base model alone.
pub struct BaseFit {
    /// The fit.
    pub fitted: FitResult,
    /// What it leaves where held out.
    pub held_out: Evaluation,
    /// Measured over declared noise.
    pub noise_scale: Option<f64>,
    /// How far the simulation's own error may have moved each entry of θ.
    pub grid_shift: Vec<f64>,
}

impl BaseFit {
    /// Its parameters. Standard errors hold both what the noise and what the simulation's own error may have moved.
    pub fn estimates(&self) -> Vec<Estimate> {
        estimates_within(&self.fitted.best, &Structure::default(), &self.grid_shift)
    }
}

/// Fits the base model and looks for nothing that it lacks.
///
/// # Errors
/// The base model cannot be fitted.
pub fn fit_only(
    demos: &[&Demo],
    held_out: &[&Demo],
    options: &LoopOptions,
    progress: &dyn Fn(&str),
) -> Result<BaseFit, FitError> {
    let mut bench = Bench::new(demos, held_out, options)?;
    let structure = Structure::default();
    let (fitted, noise) = fit_base(&mut bench, options, None, progress)?;
    progress("estimating what the grid itself may have moved");
    Ok(BaseFit {
        held_out: bench.held_out.residuals(&structure, &fitted.best.theta)?,
        grid_shift: grid_shift(&bench.fit, &structure, &fitted.best)?,
        noise_scale: noise.map(|n| n.scale),
        fitted,
    })
}

/// The base model's fit, and the noise where the data tell it: the bench and the fit's rows know it then.
fn fit_base(
    bench: &mut Bench,
    options: &LoopOptions,
    kept: Option<&KeptFit>,
    progress: &dyn Fn(&str),
) -> Result<(FitResult, Option<Noise>), FitError> {
    let mut base = match kept {
        Some(kept) => kept.again(&bench.fit)?,
        None => {
            progress("fitting the base model from several starts");
            fit(&bench.fit, &Structure::default(), &options.fit)?
        }
    };
    let noise = Noise::at_rest(&bench.fit, &base.best);
    if let Some(noise) = noise {
        bench.set_noise(noise, options);
        for row in base.best.rows.iter_mut().flatten() {
            row.sigma_m *= noise.scale;
        }
    }
    Ok((base, noise))
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
    resume_loop(demos, held_out, options, None, &|_| (), progress)
}

/// The same, from what an earlier loop over the same data with the same options had come to; `keep` is given that
/// before every further round.
///
/// # Errors
/// The base model cannot be fitted.
pub fn resume_loop(
    demos: &[&Demo],
    held_out: &[&Demo],
    options: &LoopOptions,
    earlier: Option<Memory>,
    keep: &dyn Fn(&Memory),
    progress: &dyn Fn(&str),
) -> Result<Outcome, FitError> {
    let mut bench = Bench::new(demos, held_out, options)?;
    let structure = Structure::default();
    let kept = earlier.as_ref().map(|memory| &memory.base);
    let (base, noise) = fit_base(&mut bench, options, kept, progress)?;
    bench.settle(&base.best.theta)?;
    let held_out_before = bench.held_out.residuals(&structure, &base.best.theta)?;
    let start = match earlier {
        Some(memory) => SoFar::again(memory, &bench)?,
        None => SoFar::of(Standing {
            fitted: bench.again(&structure, &base.best.theta)?,
            structure,
            held: ResidualSummary::of(&held_out_before),
            rivals: Vec::new(),
        }),
    };
    let keep = |so_far: &SoFar| {
        keep(&Memory {
            base: KeptFit::of(&base),
            now: KeptModel::of(&so_far.now),
            on_trial_since: so_far.on_trial_since.as_ref().map(KeptModel::of),
            waiting: so_far.waiting.iter().map(KeptModel::of).collect(),
            rounds: so_far.rounds.clone(),
        });
    };
    let (end, rounds, library) = all_rounds(&bench, start, options, &keep, progress)?;
    let Standing {
        structure,
        fitted,
        rivals,
        ..
    } = end;
    let held_out_after = bench.held_out.residuals(&structure, &fitted.best.theta)?;
    progress("estimating what the grid itself may have moved");
    let grid_shift = grid_shift(&bench.fit, &structure, &fitted.best)?;
    let (verdict, reasons) = conclude(&Facts {
        structure: &structure,
        base: &ResidualSummary::of(&base.best),
        fitted: &fitted,
        estimates: &estimates_within(&fitted.best, &structure, &grid_shift),
        rounds: &rounds,
        rivals: &rivals,
        demos: [demos.len(), held_out.len()],
        pure_error: noise.is_some(),
        doubt: bench.doubt(&fitted),
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

/// How far the loop has come.
struct SoFar {
    now: Standing,
    /// The model before the effect that goes along on trial.
    on_trial_since: Option<Standing>,
    /// Models with another effect that go along if that one fails.
    waiting: Vec<Standing>,
    rounds: Vec<Round>,
}

/// Round after round until nothing is left to explain or nothing explains it: the last model, the rounds, and the
/// slopes of the last of them.
///
/// Two causes can hide each other: what one leaves makes the likelihood of the other say little, and frames that are
/// held out hold more of it. So where nothing passes, but something would if that were all, it goes along for one
/// round more, and if that fails what only makes up for another. Both are accepted where they explain it together, or
/// most of it where fitted and where held out, and neither otherwise.
fn all_rounds(
    bench: &Bench,
    mut at: SoFar,
    options: &LoopOptions,
    keep: &dyn Fn(&SoFar),
    progress: &dyn Fn(&str),
) -> Result<(Standing, Vec<Round>, Option<Library>), FitError> {
    let (mut library, mut done) = (None, false);
    while !done && at.goes_on(bench, options) {
        if !at.rounds.is_empty() {
            keep(&at);
        }
        let (mut round, found, slopes) = one_round(bench, &at.now, options, progress)?;
        let found = match found {
            Found::Accepted(next) => {
                let (next, dropped) = needed(bench, &at.now, *next, progress);
                round.dropped = dropped;
                Found::Accepted(Box::new(next))
            }
            other => other,
        };
        match (found, at.on_trial_since.take()) {
            (Found::Accepted(next), None) => at.now = *next,
            (Found::Accepted(next), Some(before)) if complete(bench, &before, &next, &at.rounds) => {
                let stays = |id: &String| !round.dropped.contains(id);
                if let Some(trial) = at.rounds.last_mut() {
                    trial.accepted = at.now.last_effect().filter(stays);
                }
                at.waiting.clear();
                at.now = *next;
            }
            (_, Some(before)) => {
                progress("the effect on trial does not explain it in company either");
                // What this round says is said of a model that is given up.
                at.now = before;
                if at.next_on_trial(progress) {
                    continue;
                }
                break;
            }
            (Found::OnTrial(models), None) => {
                let room = |model: &Standing| physical_effects(&model.structure) < options.max_effects;
                at.waiting = models.into_iter().filter(room).collect();
                done = !at.next_on_trial(progress);
            }
        }
        at.rounds.push(round);
        library = Some(slopes);
    }
    let last = at.on_trial_since.unwrap_or(at.now);
    Ok((better(bench, last, &at.rounds, progress)?, at.rounds, library))
}

impl SoFar {
    /// The loop before its first round.
    fn of(start: Standing) -> Self {
        Self {
            now: start,
            on_trial_since: None,
            waiting: Vec::new(),
            rounds: Vec::new(),
        }
    }

    /// The loop where a killed one was.
    fn again(memory: Memory, bench: &Bench) -> Result<Self, FitError> {
        Ok(Self {
            now: memory.now.again(bench)?,
            on_trial_since: memory.on_trial_since.map(|kept| kept.again(bench)).transpose()?,
            waiting: memory
                .waiting
                .iter()
                .map(|kept| kept.again(bench))
                .collect::<Result<_, _>>()?,
            rounds: memory.rounds,
        })
    }

    /// Lets the next model go along for a round; whether there is one.
    fn next_on_trial(&mut self, progress: &dyn Fn(&str)) -> bool {
        if self.waiting.is_empty() {
            return false;
        }
        let next = self.waiting.remove(0);
        let id = next.last_effect().unwrap_or_default();
        progress(&format!("nothing passes alone: {id} goes along on trial"));
        self.on_trial_since = Some(std::mem::replace(&mut self.now, next));
        true
    }

    /// Whether there is something left that a further round could explain.
    fn goes_on(&self, bench: &Bench, options: &LoopOptions) -> bool {
        let fitted = &self.now.fitted;
        physical_effects(&self.now.structure) < options.max_effects
            && ResidualSummary::of(&fitted.best).floors > WHITE_FLOORS
            && !only_numerical(fitted, &self.rounds, bench.doubt(fitted))
    }
}

/// How many effects of a model are the rope's or the rig's: where the cameras stand is no theory of either.
fn physical_effects(structure: &Structure) -> usize {
    let physical = |&&effect: &&usize| !effects::ALL[effect].nuisance;
    structure.effects.iter().filter(physical).count()
}

/// Whether a model explains what one before it left with values that are physical and not nothing; or most of it where
/// fitted and where held out with physical values: what it does not need has been taken out of it ([`needed`]).
fn complete(bench: &Bench, before: &Standing, after: &Standing, rounds: &[Round]) -> bool {
    let [left, leaves] = [before, after].map(|model| ResidualSummary::of(&model.fitted.best));
    let numerical_mm = rounds.last().map_or(0.0, |round| round.table.discretisation_mm);
    let most = |before, after| excess_removed(before, after, numerical_mm) >= MOST;
    let values = estimates(&after.fitted.best, &after.structure);
    let explained = explains(&left, &after.fitted, bench.doubt(&after.fitted), numerical_mm);
    explained && all_physical(&after.structure, &values)
        || most(&left, &leaves) && most(&before.held, &after.held) && within_ranges(&after.structure, &values)
}

/// Whether the last round explained everything but what the simulation itself is known to be off by. No
/// further effect could be believed, and a round takes as long as all before it.
fn only_numerical(fitted: &FitResult, rounds: &[Round], doubt: f64) -> bool {
    let last = rounds.last().filter(|round| round.accepted.is_some());
    last.is_some_and(|round| excess_mm(fitted, doubt) <= round.table.discretisation_mm)
}

impl Bench<'_> {
    /// The evaluation at a known optimum, with the noise as it is set now.
    pub(super) fn again(&self, structure: &Structure, theta: &[f64]) -> Result<FitResult, FitError> {
        fit_from(&self.fit, structure, theta.to_vec(), 1)
    }
}
