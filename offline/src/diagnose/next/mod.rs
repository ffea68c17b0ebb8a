//! What to do next: the motion that would tell apart what these data cannot, or narrow the effect that
//! matters most for the swing; and how much each effect matters.
//!
//! Data flows one way: [`motions`] lists what can be done with the same rig, `expected` simulates what would
//! be seen of it, [`power`] says what that would tell, [`swing_risk`] what each effect could do to the swing,
//! and this file asks the question and puts the answer into words. All of it is to first order about the
//! fitted models and holds their noise and misfit, not what both models get wrong alike.

mod expected;
pub mod motions;
pub mod power;
pub mod swing_risk;

use self::expected::{Known, Look, Predicted};
use self::motions::{Candidate, Places, family};
use self::power::{LEVEL, power};
use self::swing_risk::{Allowed, SMALL_MM, SwingRisks};
use super::noise::Noise;
use super::rounds::{Library, LoopOptions, Outcome, REFIT_EVALUATIONS, problems, ties};
use super::score::ScoreProblem;
use super::verdict::Verdict;
use crate::demo::Demo;
use crate::effects;
use crate::fit::{Evaluation, FitError, FitResult, Problem, estimates, fit_from};
use crate::model::Structure;
use crate::sim::rope::RopeShape;
use nalgebra::DMatrix;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;

/// What to do next, and why.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Advice {
    /// The next demonstration.
    pub next_demonstration: NextDemonstration,
    /// What matters for the swing.
    pub swing: SwingRisks,
}

/// The next demonstration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NextDemonstration {
    /// What it shall answer.
    pub question: Question,
    /// The answer in words.
    pub in_words: String,
    /// Name of the motion that is proposed; none where none of them would help.
    pub proposed: Option<String>,
    /// Every motion that was considered, in the order of the effort that it takes.
    pub motions: Vec<MotionProspect>,
}

/// What a next demonstration shall answer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "asks", rename_all = "snake_case")]
pub enum Question {
    /// None is needed, or none can be thought of.
    Nothing {
        /// Why.
        why: String,
    },
    /// Which of these models is true.
    TellApart {
        /// Effects of each model.
        models: Vec<Vec<String>>,
        /// Level of the test.
        level: f64,
    },
    /// How large an effect is that the data leave open and that matters for the swing.
    Narrow {
        /// `<effect>.<parameter>`.
        parameter: String,
        /// Unit.
        unit: String,
        /// Half of its 90 % interval now.
        half_width: f64,
        /// What that interval is worth for the reach of the swing, mm.
        swing_mm: f64,
    },
}

/// What a motion would bring.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MotionProspect {
    /// Name.
    pub id: String,
    /// What to do.
    pub words: String,
    /// How long it takes, s.
    pub duration_s: f64,
    /// Non-centrality of the test for the pair of models that is hardest to tell apart.
    pub noncentrality: Option<f64>,
    /// Power of that test.
    pub power: Option<f64>,
    /// Half of the 90 % interval afterwards.
    pub half_width: Option<f64>,
    /// What that is worth for the reach of the swing, mm.
    pub swing_mm: Option<f64>,
    /// Why it could not be simulated.
    pub failed: Option<String>,
}

/// Normal quantile of a two-sided 90 % interval.
const NINETY: f64 = 1.644_853_627;
/// Power below which a motion does not help.
const LEAST_POWER: f64 = 0.5;
/// Power within which two motions count as equal; the one that takes less effort is proposed.
const EQUAL_POWER: f64 = 0.01;
/// Share of an interval that has to remain at most, else a motion does not help.
const LEAST_NARROWING: f64 = 0.7;
/// Ratio of two intervals within which they count as equal.
const EQUAL_WIDTH: f64 = 1.1;
/// Standard deviation of a nuisance's prior, in smallest sizes of interest.
const NUISANCE_SIZES: f64 = 5.0;

/// A model that the data allow.
#[derive(Clone)]
struct Model {
    structure: Structure,
    theta: Vec<f64>,
}

impl Model {
    /// With one more effect, at the value at which it vanishes.
    fn with(&self, effect: usize) -> Self {
        let mut theta = self.theta.clone();
        theta.extend(effects::ALL[effect].parameters.iter().map(|p| p.vanishes_at));
        Self {
            structure: self.structure.with(effect),
            theta,
        }
    }

    fn names(&self) -> Vec<String> {
        self.structure
            .effects
            .iter()
            .map(|&e| effects::ALL[e].id.into())
            .collect()
    }

    /// Standard deviations of the priors of θ; those of effects from index `free` on are a nuisance's.
    fn prior_sd(&self, free: usize) -> Vec<f64> {
        let count = |&e: &usize| effects::ALL[e].parameters.len();
        let own = 2 + self.structure.effects[..free].iter().map(count).sum::<usize>();
        let info = self.structure.parameters();
        let sd = info.iter().enumerate().map(|(k, p)| {
            if k < own {
                p.prior_sd
            } else {
                NUISANCE_SIZES * p.smallest_of_interest
            }
        });
        sd.collect()
    }
}

/// What the advice works on.
struct Desk<'a> {
    problem: Problem<'a>,
    noise: Noise,
    look: Look,
    options: &'a LoopOptions,
}

/// What to do after a diagnosis of `demos`; `progress` hears one line per step. What cannot be found out is
/// said in the advice.
pub fn advise(
    demos: &[&Demo],
    held_out: &[&Demo],
    outcome: &Outcome,
    options: &LoopOptions,
    progress: &dyn Fn(&str),
) -> Advice {
    match Desk::new(demos, held_out, outcome, options) {
        Ok(desk) => {
            progress("swinging with every effect as large as these data allow");
            let swing = desk
                .swing_risks(outcome)
                .unwrap_or_else(|error| SwingRisks::missing(error.to_string()));
            progress("looking for the demonstration that would tell most");
            let next_demonstration = desk.next(demos[0], outcome, &swing);
            Advice {
                next_demonstration,
                swing,
            }
        }
        Err(error) => Advice {
            next_demonstration: NextDemonstration::nothing(error.to_string()),
            swing: SwingRisks::missing(error.to_string()),
        },
    }
}

impl NextDemonstration {
    fn nothing(why: String) -> Self {
        Self {
            in_words: format!("no further demonstration is proposed: {why}"),
            question: Question::Nothing { why },
            proposed: None,
            motions: Vec::new(),
        }
    }
}

/// The next demonstration alone, where a diagnosis of `demos` left models that are alike; none where it did not.
pub fn separating(
    demos: &[&Demo],
    held_out: &[&Demo],
    outcome: &Outcome,
    options: &LoopOptions,
) -> Option<NextDemonstration> {
    let models = alike(outcome);
    if models.len() < 2 {
        return None;
    }
    let desk = Desk::new(demos, held_out, outcome, options).ok()?;
    let places = Places {
        arcs_m: &desk.look.arcs_m,
        first_m: &desk.look.first_m,
    };
    Some(match family(demos[0], places) {
        Ok(candidates) => desk.tell_apart(&models, &candidates),
        Err(why) => NextDemonstration::nothing(why.into()),
    })
}

/// Effects of the models that a diagnosis left alike and that still are when they are fitted anew to
/// `demos`, the best first.
///
/// # Errors
/// A model cannot be fitted to them.
pub fn still_alike(
    demos: &[&Demo],
    outcome: &Outcome,
    options: &LoopOptions,
) -> Result<Vec<Vec<String>>, FitError> {
    let mut problem = Problem::new(demos, options.resolution)?;
    problem.noise_scale = outcome.noise_scale.unwrap_or(1.0);
    let models = alike(outcome);
    let refits = models.par_iter().map(|model| {
        let theta = model.theta.clone();
        fit_from(&problem, &model.structure, theta, REFIT_EVALUATIONS)
    });
    let fits: Vec<FitResult> = refits.collect::<Result<_, _>>()?;
    let mut order: Vec<usize> = (0..models.len()).collect();
    order.sort_by(|&a, &b| fits[a].best.rms_m().total_cmp(&fits[b].best.rms_m()));
    let best = order[0];
    order.retain(|&m| m == best || ties(&fits[best], &fits[m]));
    Ok(order.into_iter().map(|m| models[m].names()).collect())
}

/// The demonstration that is proposed after a diagnosis, with nothing seen yet; none where none is.
pub fn proposed_demo(demo: &Demo, outcome: &Outcome, next: &NextDemonstration) -> Option<Demo> {
    let look = Look::of(demo, outcome.fitted.best.rows.first()?);
    let candidates = family(
        demo,
        Places {
            arcs_m: &look.arcs_m,
            first_m: &look.first_m,
        },
    )
    .ok()?;
    let id = next.proposed.as_deref()?;
    candidates.into_iter().find(|c| c.id == id).map(|c| c.demo)
}

impl<'a> Desk<'a> {
    fn new(
        demos: &[&'a Demo],
        held_out: &[&'a Demo],
        outcome: &Outcome,
        options: &'a LoopOptions,
    ) -> Result<Self, FitError> {
        let (mut problem, _) = problems(demos, held_out, options)?;
        problem.noise_scale = outcome.noise_scale.unwrap_or(1.0);
        let times: Vec<Vec<f64>> = problem.scenes.iter().map(|s| s.frame_times_s.clone()).collect();
        Ok(Self {
            noise: Noise::at_rest(demos, &outcome.base.best, &times).unwrap_or(Noise::DECLARED),
            look: Look::of(demos[0], &outcome.fitted.best.rows[0]),
            problem,
            options,
        })
    }

    /// What every parameter could do to the swing.
    fn swing_risks(&self, outcome: &Outcome) -> Result<SwingRisks, FitError> {
        let fitted = Model {
            structure: outcome.structure.clone(),
            theta: outcome.fitted.best.theta.clone(),
        };
        let mut wide = fitted.clone();
        for effect in 0..effects::ALL.len() {
            if !fitted.structure.effects.contains(&effect) && !self.options.hidden.contains(&effect) {
                wide = wide.with(effect);
            }
        }
        let evaluation = match &outcome.library {
            Some(library) => transplanted(library, &outcome.fitted.best, &fitted.structure, &wide),
            None => self.problem.evaluate(&wide.structure, &wide.theta)?,
        };
        let mut allowed = in_model(&outcome.fitted.best, &fitted.structure);
        allowed.extend(self.not_in_model(&evaluation, &wide.structure, &fitted.structure));
        let rope = &self.problem.demos[0].spec.rope;
        let shape = RopeShape {
            length_m: rope.length_m,
            diameter_m: rope.diameter_m,
            mass_kg: rope.mass_kg,
        };
        let (structure, theta) = (&fitted.structure, &fitted.theta);
        Ok(SwingRisks::of(
            shape,
            structure,
            theta,
            self.options.resolution,
            allowed,
        ))
    }

    /// What the data allow of effects that the model lacks: the score test's intervals, each effect alone,
    /// widened by what the model leaves unexplained.
    fn not_in_model(&self, wide: &Evaluation, structure: &Structure, known: &Structure) -> Vec<Allowed> {
        let problem = ScoreProblem::new(wide, structure, known, &self.noise, true);
        let widened = problem.misfit().sqrt();
        let mut list = Vec::new();
        for (effect, estimate, error) in problem.intervals() {
            let spec = &effects::ALL[effect];
            for (index, p) in spec.parameters.iter().enumerate() {
                let allowed = Allowed {
                    name: format!("{}.{}", spec.id, p.name),
                    unit: p.unit.into(),
                    effect: Some(effect),
                    index,
                    in_model: false,
                    value: p.vanishes_at,
                    interval: [p.low, p.high],
                    bounded_by_range: true,
                };
                let half = NINETY * widened * error[index];
                list.push(allowed.within(p.vanishes_at + estimate[index], half, [p.low, p.high]));
            }
        }
        list
    }

    fn next(&self, demo: &Demo, outcome: &Outcome, swing: &SwingRisks) -> NextDemonstration {
        let places = Places {
            arcs_m: &self.look.arcs_m,
            first_m: &self.look.first_m,
        };
        let candidates = match family(demo, places) {
            Ok(candidates) => candidates,
            Err(why) => return NextDemonstration::nothing(why.into()),
        };
        let models = alike(outcome);
        if models.len() > 1 {
            return self.tell_apart(&models, &candidates);
        }
        if matches!(outcome.verdict, Verdict::Unexplained { .. }) {
            return NextDemonstration::nothing(
                "no effect of the library explains these data, so there are no two to tell apart".into(),
            );
        }
        let fitted = Model {
            structure: outcome.structure.clone(),
            theta: outcome.fitted.best.theta.clone(),
        };
        self.narrow(&fitted, swing, &candidates)
    }

    /// Effects that are free in every model, as an unknown that no effect shall be blamed for.
    fn nuisances(&self, models: &[Model]) -> Vec<usize> {
        let held = |e: &usize| models.iter().any(|m| m.structure.effects.contains(e));
        (0..effects::ALL.len())
            .filter(|&e| effects::ALL[e].nuisance && !held(&e))
            .collect()
    }

    /// Every motion with every model, nuisances added; and what the data so far say about each model.
    fn prospects(&self, models: &[Model], candidates: &[Candidate]) -> Result<Simulated, FitError> {
        let nuisances = self.nuisances(models);
        let wide: Vec<Model> = models
            .iter()
            .map(|model| nuisances.iter().fold(model.clone(), |m, &e| m.with(e)))
            .collect();
        let known = wide.par_iter().zip(models).map(|(model, own)| {
            let evaluation = self.problem.evaluate(&model.structure, &model.theta)?;
            let prior_sd = model.prior_sd(own.structure.effects.len());
            Ok(Known::new(&evaluation, &self.noise, &prior_sd))
        });
        let known: Vec<Known> = known.collect::<Result<_, FitError>>()?;
        let predicted = candidates.par_iter().map(|candidate| {
            let of = |model: &Model| {
                Predicted::new(candidate, &model.structure, &model.theta, self.options.resolution)
            };
            wide.par_iter()
                .map(of)
                .collect::<Result<Vec<_>, _>>()
                .map_err(|error| error.to_string())
        });
        Ok(Simulated {
            known,
            predicted: predicted.collect(),
        })
    }

    /// The motion that tells models apart best.
    fn tell_apart(&self, models: &[Model], candidates: &[Candidate]) -> NextDemonstration {
        let simulated = match self.prospects(models, candidates) {
            Ok(simulated) => simulated,
            Err(error) => return NextDemonstration::nothing(error.to_string()),
        };
        let mut motions: Vec<MotionProspect> = candidates.iter().map(MotionProspect::new).collect();
        for (motion, predicted) in motions.iter_mut().zip(&simulated.predicted) {
            match predicted {
                Ok(models) => {
                    let hardest = self.hardest(&simulated.known, models);
                    (motion.noncentrality, motion.power) = (Some(hardest), Some(power(hardest)));
                }
                Err(error) => motion.failed = Some(error.clone()),
            }
        }
        let names: Vec<Vec<String>> = models.iter().map(Model::names).collect();
        let (proposed, in_words) = choose_separating(&motions, &names);
        let question = Question::TellApart {
            models: names,
            level: LEVEL,
        };
        NextDemonstration {
            question,
            in_words,
            proposed,
            motions,
        }
    }

    /// Non-centrality of the hardest question: one model is true, another is tested.
    fn hardest(&self, known: &[Known], models: &[Predicted]) -> f64 {
        let mut least = f64::INFINITY;
        for (tested, one) in models.iter().enumerate() {
            let others: Vec<&Predicted> = (0..models.len())
                .filter(|&m| m != tested)
                .map(|m| &models[m])
                .collect();
            let (slopes, misses) = one.seen(&self.look, &self.noise, &others);
            let prospect = known[tested].with(slopes);
            for miss in &misses {
                least = least.min(prospect.noncentrality(miss));
            }
        }
        least
    }

    /// The motion that narrows the effect which matters most for the swing.
    fn narrow(&self, fitted: &Model, swing: &SwingRisks, candidates: &[Candidate]) -> NextDemonstration {
        if let Some(why) = &swing.missing {
            return NextDemonstration::nothing(why.clone());
        }
        let open = swing.risks.iter().filter(|risk| risk.allowed.effect.is_some());
        let open = open.filter_map(|risk| Some((risk, risk.open_mm()?)));
        let Some((risk, open_mm)) = open.max_by(|a, b| a.1.total_cmp(&b.1)) else {
            return NextDemonstration::nothing("no swing could be simulated".into());
        };
        if open_mm < SMALL_MM {
            return NextDemonstration::nothing(format!(
                "none of these effects is known so badly that it matters for the swing by more than {SMALL_MM} mm"
            ));
        }
        let allowed = &risk.allowed;
        let effect = allowed.effect.expect("found by it");
        let held = fitted.structure.effects.iter().position(|&e| e == effect);
        let model = if held.is_some() {
            fitted.clone()
        } else {
            fitted.with(effect)
        };
        let place = held.unwrap_or(fitted.structure.effects.len());
        let before = model.structure.effects[..place].iter();
        let first = 2 + before.map(|&e| effects::ALL[e].parameters.len()).sum::<usize>();
        let half_width = allowed.half_width();
        let simulated = match self.prospects(std::slice::from_ref(&model), candidates) {
            Ok(simulated) => simulated,
            Err(error) => return NextDemonstration::nothing(error.to_string()),
        };
        let mut motions: Vec<MotionProspect> = candidates.iter().map(MotionProspect::new).collect();
        for (motion, predicted) in motions.iter_mut().zip(&simulated.predicted) {
            match predicted {
                Ok(models) => {
                    let (slopes, _) = models[0].seen(&self.look, &self.noise, &[]);
                    let spread = simulated.known[0].with(slopes).narrowing(first + allowed.index);
                    let ratio = spread.map(|[now, after]| after / now);
                    motion.half_width = ratio.map(|r| r * half_width);
                    motion.swing_mm = ratio.map(|r| r * open_mm);
                }
                Err(error) => motion.failed = Some(error.clone()),
            }
        }
        let question = Question::Narrow {
            parameter: allowed.name.clone(),
            unit: allowed.unit.clone(),
            half_width,
            swing_mm: open_mm,
        };
        let (proposed, in_words) =
            choose_narrowing(&motions, effects::ALL[effect].title, half_width, open_mm);
        NextDemonstration {
            question,
            in_words,
            proposed,
            motions,
        }
    }
}

/// Simulations of all motions.
struct Simulated {
    /// Per model.
    known: Vec<Known>,
    /// Per motion and model, or why a motion could not be simulated.
    predicted: Vec<Result<Vec<Predicted>, String>>,
}

impl MotionProspect {
    fn new(candidate: &Candidate) -> Self {
        let times = candidate.demo.times_s();
        Self {
            id: candidate.id.into(),
            words: candidate.words.clone(),
            duration_s: times.last().map_or(0.0, |last| last - times[0]),
            noncentrality: None,
            power: None,
            half_width: None,
            swing_mm: None,
            failed: None,
        }
    }
}

/// The slopes of the library where the last round started, on the rows of the final fit: another pass over
/// the library would take as long as a round. The model's own slopes are those of the final fit.
fn transplanted(library: &Library, fitted: &Evaluation, own: &Structure, wide: &Model) -> Evaluation {
    let columns = |structure: &Structure| -> Vec<String> {
        structure.parameters().into_iter().map(|p| p.name).collect()
    };
    let (theirs, names) = (columns(&library.structure), columns(&wide.structure));
    let known = columns(own).len();
    let sources = names[known..]
        .iter()
        .map(|name| theirs.iter().position(|other| other == name));
    let sources: Vec<Option<usize>> = sources.collect();
    let mut jacobian = DMatrix::zeros(fitted.len(), names.len());
    let (mut i, mut first) = (0, 0);
    for (rows, before) in fitted.rows.iter().zip(&library.evaluation.rows) {
        let mut places: HashMap<(usize, usize), Vec<usize>> = HashMap::new();
        for (j, row) in before.iter().enumerate() {
            places.entry((row.frame, row.station)).or_default().push(j);
        }
        for row in rows {
            jacobian
                .view_mut((i, 0), (1, known))
                .copy_from(&fitted.jacobian.row(i).columns(0, known));
            for &j in places.get(&(row.frame, row.station)).into_iter().flatten() {
                let alike: f64 = (0..3).map(|k| row.direction[k] * before[j].direction[k]).sum();
                for (k, source) in sources.iter().enumerate() {
                    let slope = source.map_or(0.0, |s| library.evaluation.jacobian[(first + j, s)]);
                    jacobian[(i, known + k)] += alike * slope;
                }
            }
            i += 1;
        }
        first += before.len();
    }
    Evaluation {
        theta: wide.theta.clone(),
        rows: fitted.rows.clone(),
        jacobian,
    }
}

/// What the data allow of the model's own parameters.
fn in_model(evaluation: &Evaluation, structure: &Structure) -> Vec<Allowed> {
    let info = structure.parameters();
    let owners = structure.effects.iter().flat_map(|&e| {
        let count = effects::ALL[e].parameters.len();
        (0..count).map(move |index| (Some(e), index))
    });
    let owners = [(None, 0), (None, 1)].into_iter().chain(owners);
    let all = estimates(evaluation, structure)
        .into_iter()
        .zip(&info)
        .zip(owners);
    all.map(|((estimate, info), (effect, index))| {
        let of_theta = |value: f64| {
            if effect.is_none() && index == 0 {
                value.exp()
            } else {
                value
            }
        };
        let allowed = Allowed {
            name: estimate.name,
            unit: estimate.unit,
            effect,
            index,
            in_model: true,
            value: estimate.value,
            interval: [0.0; 2],
            bounded_by_range: true,
        };
        let range = [of_theta(info.low), of_theta(info.high)];
        allowed.within(estimate.value, NINETY * estimate.standard_error, range)
    })
    .collect()
}

/// The models between which the data cannot choose: the final one and those with a rival in the place of
/// its last effect.
fn alike(outcome: &Outcome) -> Vec<Model> {
    let last = Model {
        structure: outcome.structure.clone(),
        theta: outcome.fitted.best.theta.clone(),
    };
    let mut found = vec![last];
    let round = outcome.rounds.iter().rfind(|round| round.accepted.is_some());
    if let (Some(round), Verdict::Confounded { .. }) = (round, &outcome.verdict) {
        let known = outcome.structure.effects[..outcome.structure.effects.len() - 1].to_vec();
        for refit in round
            .refits
            .iter()
            .filter(|refit| outcome.rivals.contains(&refit.id))
        {
            if let Some(effect) = effects::find(&refit.id) {
                found.push(Model {
                    structure: Structure {
                        effects: known.clone(),
                    }
                    .with(effect),
                    theta: refit.theta.clone(),
                });
            }
        }
    }
    found
}

fn title(id: &String) -> &str {
    effects::find(id).map_or(id, |effect| effects::ALL[effect].title)
}

/// The motion to propose for telling models apart, and the words for it.
fn choose_separating(motions: &[MotionProspect], models: &[Vec<String>]) -> (Option<String>, String) {
    let model = |names: &Vec<String>| names.iter().map(title).collect::<Vec<_>>().join(" with ");
    // What all of them share tells nothing.
    let shared = |id: &String| models.iter().all(|m| m.contains(id));
    let own = models
        .iter()
        .map(|m| m.iter().filter(|id| !shared(id)).cloned().collect());
    let alike = own
        .map(|m: Vec<String>| model(&m))
        .collect::<Vec<_>>()
        .join(" from ");
    let powers = motions.iter().filter_map(|m| m.power);
    let best = powers.fold(f64::NEG_INFINITY, f64::max);
    let Some(motion) = motions
        .iter()
        .find(|m| m.power.is_some_and(|p| p >= best - EQUAL_POWER))
    else {
        return (
            None,
            "none of the motions that were considered could be simulated".into(),
        );
    };
    let percent = 100.0 * motion.power.unwrap_or(0.0);
    if best < LEAST_POWER {
        let words = format!(
            "none of the motions that were considered would tell {alike}: the best of them ({}) would with {percent:.0} % power only",
            motion.words
        );
        return (None, words);
    }
    let words = format!(
        "{}: it would tell {alike} with {percent:.0} % power",
        motion.words
    );
    (Some(motion.id.clone()), words)
}

/// The motion to propose for narrowing an effect, and the words for it.
fn choose_narrowing(
    motions: &[MotionProspect],
    effect: &str,
    half_width: f64,
    open_mm: f64,
) -> (Option<String>, String) {
    let least = motions
        .iter()
        .filter_map(|m| m.half_width)
        .fold(f64::INFINITY, f64::min);
    let open = format!(
        "of what these data leave open, {effect} matters most for the swing: its interval is worth ± {open_mm:.1} mm of the reach"
    );
    let near = |m: &&MotionProspect| m.half_width.is_some_and(|w| w <= EQUAL_WIDTH * least);
    match motions.iter().find(near) {
        Some(motion) if least <= LEAST_NARROWING * half_width => {
            let after = motion.swing_mm.unwrap_or(open_mm);
            let words = format!("{open}; {}: it would lower that to ± {after:.1} mm", motion.words);
            (Some(motion.id.clone()), words)
        }
        Some(_) => (
            None,
            format!("{open}; none of the motions that were considered would narrow it much"),
        ),
        None => (
            None,
            format!("{open}; none of the motions that were considered could be simulated"),
        ),
    }
}

#[cfg(test)]
mod tests;
