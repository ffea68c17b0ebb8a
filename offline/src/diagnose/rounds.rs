//! The loop: fit, score, refit the best, gate, accept, repeat.

use super::accounted::excess_mm;
use super::bench::Bench;
use super::choice::Standing;
use super::conclude::{Facts, conclude};
use super::leaner::{Judged, leaner};
use super::memory::{KeptFit, KeptModel, Memory};
use super::noise::Noise;
use super::round::{Round, score};
use super::score::{Invariance, ScoreTable};
use super::verdict::{ReasonCode, Verdict};
use super::ways::{SoFar, all_rounds};
use crate::demo::Demo;
use crate::effects;
use crate::fit::{
    Evaluation, FitError, FitOptions, FitResult, Library, Resolution, estimates_within, fit_and_tell,
    grid_shift,
};
use crate::model::{Estimate, Structure};
use crate::residual::ResidualSummary;
use crate::tell::Tell;
use serde::{Deserialize, Serialize};

/// Settings of the loop.
#[derive(Clone, Debug, PartialEq)]
pub struct LoopOptions {
    /// Grid of the fits.
    pub resolution: Resolution,
    /// Finer grid to whose predictions those of the fits are refined, and on which an effect has to stay the same.
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
    /// A finer grid tells what of the residual may be the simulation's own error, and an effect has to stay the same on it.
    Refinement,
}

impl LoopOptions {
    /// Effects that a model lacks and that may be tried.
    pub(super) fn missing(&self, structure: &Structure) -> impl Iterator<Item = usize> {
        let may = |effect: &usize| !structure.effects.contains(effect) && !self.hidden.contains(effect);
        (0..effects::ALL.len()).filter(may)
    }

    /// Whether the cameras' pose is free in the scores.
    pub(super) fn nuisances(&self) -> bool {
        self.without != Some(Part::Nuisances)
    }

    /// Defaults on a grid; the finer one is [`Resolution::finer`].
    pub fn new(resolution: Resolution, seed: u64) -> Self {
        Self {
            resolution,
            finer: resolution.finer(),
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
    /// The noise of the offsets.
    pub noise: Noise,
    /// Models that fit as well as the final one.
    pub rivals: Vec<KeptModel>,
    /// How the final model's effects fare in parts of what was fitted; none where the finer grid could not be simulated.
    pub invariances: Vec<Invariance>,
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

/// A fit of the base model alone.
pub struct BaseFit {
    /// The fit.
    pub fitted: FitResult,
    /// What it leaves where held out.
    pub held_out: Evaluation,
    /// The noise of the offsets.
    pub noise: Noise,
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
    progress: &dyn Tell,
) -> Result<BaseFit, FitError> {
    let mut bench = Bench::new(demos, held_out, options)?;
    let structure = Structure::default();
    let (fitted, noise) = fit_base(&mut bench, options, None, progress)?;
    progress.say("estimating what the grid itself may have moved");
    Ok(BaseFit {
        held_out: bench.held_out.residuals(&structure, &fitted.best.theta)?,
        // What is left may be what this model lacks.
        grid_shift: grid_shift(&bench.fit, &structure, &fitted.best, 0.0)?,
        noise,
        fitted,
    })
}

/// The base model's fit, and the noise as far as the data tell it: the bench and the fit's rows know it then, and the bench
/// predicts as the finer grid does near that fit.
fn fit_base(
    bench: &mut Bench,
    options: &LoopOptions,
    kept: Option<&KeptFit>,
    progress: &dyn Tell,
) -> Result<(FitResult, Noise), FitError> {
    let structure = Structure::default();
    let mut base = match kept {
        Some(kept) => {
            *bench = bench.refined(&structure, kept.theta())?;
            kept.again(&bench.fit)?
        }
        None => {
            progress.say("fitting the base model from several starts");
            let fitted = fit_and_tell(&bench.fit, &structure, &options.fit, progress)?;
            progress.say("fitting it again as a finer grid has it");
            let (there, fitted) = bench.followed(&structure, &fitted)?;
            *bench = there;
            fitted
        }
    };
    let noise = Noise::measured(&bench.fit, &base.best);
    progress.say(&format!("noise: {}", noise.in_words()));
    bench.set_noise(noise, options);
    base.best.set_noise_scale(noise.scale);
    Ok((base, noise))
}

/// Scores of the whole library on the base model of a loop over the same data with the same options, where the loop had no
/// need of them too.
///
/// # Errors
/// The base model cannot be simulated on the finer grid or with slopes.
pub fn base_scores(
    demos: &[&Demo],
    held_out: &[&Demo],
    outcome: &Outcome,
    options: &LoopOptions,
) -> Result<ScoreTable, FitError> {
    let mut bench = Bench::new(demos, held_out, options)?;
    let base = &outcome.base.best;
    bench.set_noise(outcome.noise, options);
    bench.settle(&base.theta)?;
    let bench = bench.refined(&Structure::default(), &base.theta)?;
    Ok(score(&bench, &Structure::default(), &base.theta, options)?.0)
}

/// Runs the loop. `progress` hears one line per step.
///
/// # Errors
/// The base model cannot be fitted.
pub fn close_loop(
    demos: &[&Demo],
    held_out: &[&Demo],
    options: &LoopOptions,
    progress: &dyn Tell,
) -> Result<Outcome, FitError> {
    resume_loop(demos, held_out, options, None, &|_| (), progress)
}

/// The same, from what an earlier loop over the same data with the same options had come to; `keep` is given that
/// after the base model's fit and after every round.
///
/// # Errors
/// The base model cannot be fitted.
pub fn resume_loop(
    demos: &[&Demo],
    held_out: &[&Demo],
    options: &LoopOptions,
    earlier: Option<Memory>,
    keep: &dyn Fn(&Memory),
    progress: &dyn Tell,
) -> Result<Outcome, FitError> {
    let mut bench = Bench::new(demos, held_out, options)?;
    let structure = Structure::default();
    let kept = earlier.as_ref().map(|memory| &memory.base);
    let (base, noise) = fit_base(&mut bench, options, kept, progress)?;
    bench.settle(&base.best.theta)?;
    let held_out_before = bench.held_out.residuals(&structure, &base.best.theta)?;
    let start = match earlier {
        Some(memory) => SoFar::again(memory, &bench)?,
        None => SoFar::at_first(&bench, &base, &held_out_before)?,
    };
    let before = ResidualSummary::of(&base.best);
    let keep = |so_far: &SoFar| {
        keep(&Memory {
            base: KeptFit::of(&base),
            now: KeptModel::of(&so_far.now),
            rivals: so_far.now.rivals.clone(),
            rounds: so_far.rounds.clone(),
            other: so_far.other.clone(),
        });
    };
    let ended = all_rounds(&bench, start, &before, options, &keep, progress)?;
    let (mut rounds, library, stopped) = (ended.rounds, ended.library, ended.stopped);
    progress.say("estimating what the grid itself may have moved");
    let course = Course {
        options,
        before: &before,
        held_out_before: &held_out_before,
        rounds: &rounds,
        demos: [demos.len(), held_out.len()],
        pure_error: noise.source.is_pure_error(),
        stopped,
    };
    let judge = |model: Standing| course.judge(&ended.bench, model);
    let (judged, nothing) = leaner(&ended.bench, judge(ended.model)?, &judge, progress);
    if let Some(last) = rounds.last_mut() {
        last.nothing = nothing;
    }
    Ok(Outcome {
        structure: judged.model.structure,
        fitted: judged.model.fitted,
        base,
        held_out_before,
        held_out_after: judged.held_out,
        rounds,
        verdict: judged.verdict,
        reasons: judged.reasons,
        noise,
        rivals: judged.model.rivals,
        invariances: judged.invariances,
        library,
        grid_shift: judged.grid_shift,
    })
}

/// How a loop went, by which its model is judged.
struct Course<'a> {
    options: &'a LoopOptions,
    before: &'a ResidualSummary,
    held_out_before: &'a Evaluation,
    rounds: &'a [Round],
    demos: [usize; 2],
    pure_error: bool,
    stopped: bool,
}

impl Course<'_> {
    fn judge(&self, bench: &Bench, model: Standing) -> Result<Judged, FitError> {
        let refined = bench.refined(&model.structure, &model.fitted.best.theta);
        let bench = &refined.unwrap_or_else(|_| bench.unrefined());
        let (model, held_out) = model.anew(bench)?;
        let (structure, fitted) = (&model.structure, &model.fitted);
        let left_mm = excess_mm(&ResidualSummary::of(&fitted.best), bench.doubt(&fitted.best));
        let grid_shift = grid_shift(&bench.fit, structure, &fitted.best, 1e-3 * left_mm)?;
        let invariances = bench.invariances((&fitted.best, structure), self.options);
        let (verdict, reasons) = conclude(&Facts {
            structure,
            base: self.before,
            fitted,
            held_out: bench.where_held_out([self.held_out_before, &held_out], (structure, fitted)),
            estimates: &estimates_within(&fitted.best, structure, &grid_shift),
            rounds: self.rounds,
            rivals: &model.rivals,
            invariances: &invariances,
            demos: self.demos,
            pure_error: self.pure_error,
            doubt: bench.doubt(&fitted.best),
            stopped: self.stopped,
        });
        Ok(Judged {
            model,
            held_out,
            grid_shift,
            invariances,
            verdict,
            reasons,
        })
    }
}

/// How many effects of a model are the rope's or the rig's: where the cameras stand is no theory of either.
pub(super) fn physical_effects(structure: &Structure) -> usize {
    let physical = |&&effect: &&usize| !effects::ALL[effect].nuisance;
    structure.effects.iter().filter(physical).count()
}

#[cfg(test)]
mod tests {
    use super::super::revise::tests::{YOUNG_PA, options, recorded};
    use super::*;

    /// What the benchmark leaves out to see what it is worth.
    #[test]
    fn without_a_finer_grid_noise_alone_makes_the_thresholds() {
        let demos = recorded(&[]);
        let theta = [YOUNG_PA.ln(), 0.3];
        let table = |without: Option<Part>| {
            let options = LoopOptions { without, ..options() };
            let bench = Bench::new(&[&demos[0]], &[&demos[1]], &options).unwrap();
            let bench = bench.refined(&Structure::default(), &theta).unwrap();
            score(&bench, &Structure::default(), &theta, &options).unwrap().0
        };
        let [whole, part] = [None, Some(Part::Refinement)].map(table);
        assert!(whole.discretisation_mm > 0.0 && part.discretisation_mm == 0.0);
        let thresholds = |table: &ScoreTable| table.scores.iter().map(|score| score.threshold).sum::<f64>();
        assert!(thresholds(&part) < thresholds(&whole));
        assert_eq!(part.scores.len(), whole.scores.len());
    }
}
