//! What to do next: the motion that would tell apart what these data cannot, or narrow the effect that
//! matters most for the swing; and how much each effect matters.
//!
//! Data flows one way: `models` holds what the diagnosis leaves open and `allowed` how large each effect may
//! still be, [`swing_risk`] says what that could do to the swing, [`motions`] lists what can be done with the
//! same rig, `expected` simulates what would be seen of it, [`mod@power`] says what that would tell; this file asks
//! the question, and `words` has the answer. All of it is to first order about the
//! fitted models and holds their noise and misfit, not what both models get wrong alike.

mod allowed;
mod expected;
mod models;
pub mod motions;
pub mod power;
pub mod swing_risk;
mod words;

use self::allowed::{in_model, not_in_model, transplanted};
use self::expected::{Known, Look, Predicted};
pub use self::models::still_alike;
use self::models::{Model, alike};
use self::motions::{Candidate, Places, family};
use self::power::{Miss, distance, power};
use self::swing_risk::{SMALL_MM, SwingRisks};
use self::words::{choose_narrowing, choose_separating};
use super::bench::problems_at;
use super::choice::tie_spread;
use super::noise::Noise;
use super::rounds::{LoopOptions, Outcome};
use super::verdict::Verdict;
use crate::demo::Demo;
use crate::effects;
use crate::fit::{Correlation, FitError, Problem};
use crate::sim::rope::RopeShape;
use crate::tell::{Pieces, Silent, Tell};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

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
    /// Squared distance between the predictions of the pair of models that is hardest to tell apart, over the
    /// variance of the noise and of what they leave unexplained.
    pub noncentrality: Option<f64>,
    /// Probability that the diagnosis tells them apart, by its own rule, with these data and the new ones.
    pub power: Option<f64>,
    /// Half of the 90 % interval afterwards.
    pub half_width: Option<f64>,
    /// What that is worth for the reach of the swing, mm.
    pub swing_mm: Option<f64>,
    /// Why it could not be simulated.
    pub failed: Option<String>,
}

/// What the advice works on.
struct Desk<'a> {
    problem: Problem<'a>,
    noise: Noise,
    /// The demonstration whose motion is varied.
    varied: usize,
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
    progress: &dyn Tell,
) -> Advice {
    match Desk::new(demos, held_out, outcome, options) {
        Ok(desk) => {
            progress.say("swinging with every effect as large as these data allow");
            let swing = desk
                .swing_risks(outcome, progress)
                .unwrap_or_else(|error| SwingRisks::missing(error.to_string()));
            progress.say("looking for the demonstration that would tell most");
            let next_demonstration = desk.next(demos[desk.varied], (outcome, &swing), progress);
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
    Some(match family(demos[desk.varied], places) {
        Ok(candidates) => desk.tell_apart(&models, &candidates, &Silent),
        Err(why) => NextDemonstration::nothing(why.into()),
    })
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
        let model = (&outcome.structure, &outcome.fitted.best.theta[..]);
        let (problem, _) = problems_at((demos, held_out), options, outcome.noise.scale, model)?;
        // Poses at rest have no motion to vary.
        let moves = |demo: &&Demo| !demo.spec.is_static();
        let varied = demos.iter().position(moves).unwrap_or(0);
        Ok(Self {
            noise: outcome.noise,
            varied,
            look: Look::of(demos[varied], &outcome.fitted.best.rows[varied]),
            problem,
            options,
        })
    }

    /// What every parameter could do to the swing.
    fn swing_risks(&self, outcome: &Outcome, progress: &dyn Tell) -> Result<SwingRisks, FitError> {
        let fitted = Model {
            structure: outcome.structure.clone(),
            theta: outcome.fitted.best.theta.clone(),
        };
        let missing: Vec<usize> = self.options.missing(&fitted.structure).collect();
        let wide = missing
            .iter()
            .fold(fitted.clone(), |wide, &effect| wide.with(effect));
        // A diagnosis that went on after its last round has none.
        let made;
        let library = match &outcome.library {
            Some(library) => library,
            None => {
                made = self.problem.library(&fitted.structure, &fitted.theta, &missing)?;
                &made
            }
        };
        let evaluation = transplanted(library, &outcome.fitted.best, &fitted.structure, &wide);
        let mut allowed = in_model(outcome);
        let (others, unseen) = not_in_model(&evaluation, &wide.structure, &fitted.structure, &self.noise);
        allowed.extend(others);
        let rope = &self.problem.demos[0].spec.rope;
        let shape = RopeShape::of_spec(rope);
        let (structure, theta) = (&fitted.structure, &fitted.theta);
        let risks = SwingRisks::of(
            shape,
            structure,
            theta,
            self.options.resolution,
            allowed,
            progress,
        );
        Ok(SwingRisks { unseen, ..risks })
    }

    fn next(
        &self,
        demo: &Demo,
        (outcome, swing): (&Outcome, &SwingRisks),
        progress: &dyn Tell,
    ) -> NextDemonstration {
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
            return self.tell_apart(&models, &candidates, progress);
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
        self.narrow(&fitted, swing, &candidates, progress)
    }

    /// Effects that are free in every model, as an unknown that no effect shall be blamed for.
    fn nuisances(&self, models: &[Model]) -> Vec<usize> {
        let held = |e: &usize| models.iter().any(|m| m.structure.effects.contains(e));
        (0..effects::ALL.len())
            .filter(|&e| effects::ALL[e].nuisance && !held(&e))
            .collect()
    }

    /// Every motion with every model, these nuisances added; and what the data so far say about each model.
    fn prospects(
        &self,
        models: &[Model],
        nuisances: &[usize],
        candidates: &[Candidate],
        progress: &dyn Tell,
    ) -> Result<Simulated, FitError> {
        let wide: Vec<Model> = models
            .iter()
            .map(|model| nuisances.iter().fold(model.clone(), |m, &e| m.with(e)))
            .collect();
        let known = wide.par_iter().zip(models).map(|(model, own)| {
            let evaluation = self.problem.evaluate(&model.structure, &model.theta)?;
            let prior_sd = model.prior_sd(own.structure.effects.len());
            Ok(Known::new(evaluation, &self.noise, prior_sd))
        });
        let known: Vec<Known> = known.collect::<Result<_, FitError>>()?;
        let pieces = Pieces::of(progress, "motions", candidates.len());
        let predicted = candidates.par_iter().map(|candidate| {
            let of = |model: &Model| {
                Predicted::new(candidate, &model.structure, &model.theta, self.options.resolution)
            };
            let by_model = wide.par_iter().map(of).collect::<Result<Vec<_>, _>>();
            pieces.ended(by_model.map_err(|error| error.to_string()))
        });
        Ok(Simulated {
            known,
            predicted: predicted.collect(),
        })
    }

    /// The motion that tells models apart best.
    fn tell_apart(
        &self,
        models: &[Model],
        candidates: &[Candidate],
        progress: &dyn Tell,
    ) -> NextDemonstration {
        let simulated = match self.prospects(models, &[], candidates, progress) {
            Ok(simulated) => simulated,
            Err(error) => return NextDemonstration::nothing(error.to_string()),
        };
        let mut motions: Vec<MotionProspect> = candidates.iter().map(MotionProspect::new).collect();
        for (motion, predicted) in motions.iter_mut().zip(&simulated.predicted) {
            match predicted {
                Ok(models) => {
                    let hardest = self.hardest(&simulated.known, models);
                    (motion.noncentrality, motion.power) = (Some(hardest.0), Some(hardest.1));
                }
                Err(error) => motion.failed = Some(error.clone()),
            }
        }
        let names: Vec<Vec<String>> = models.iter().map(|m| m.structure.ids()).collect();
        let (proposed, in_words) = choose_separating(&motions, &names);
        let question = Question::TellApart { models: names };
        NextDemonstration {
            question,
            in_words,
            proposed,
            motions,
        }
    }

    /// The hardest question, one model being true and another tested: its non-centrality and its power.
    fn hardest(&self, known: &[Known], models: &[Predicted]) -> (f64, f64) {
        let mut least = (f64::INFINITY, f64::INFINITY);
        for (tested, one) in models.iter().enumerate() {
            for (truth, other) in models.iter().enumerate().filter(|(truth, _)| *truth != tested) {
                let past = known[tested].miss(&known[truth]);
                let (slopes, mut misses) = one.seen(&self.look, None, &[other]);
                let next = Miss {
                    miss: misses.remove(0),
                    slopes,
                };
                let apart = distance(&[&past, &next], &known[tested].prior_sd);
                let evaluation = &known[truth].evaluation;
                let variance = Correlation::of(evaluation).variance_factor();
                // The rule's spread per offset falls with the root of their number.
                let (old, all) = (past.miss.len() as f64, (past.miss.len() + next.miss.len()) as f64);
                let needed = tie_spread(evaluation) * (old * all).sqrt();
                let found = (apart / variance, power(apart, needed, variance));
                if found.1 < least.1 {
                    least = found;
                }
            }
        }
        least
    }

    /// The motion that narrows the effect which matters most for the swing.
    fn narrow(
        &self,
        fitted: &Model,
        swing: &SwingRisks,
        candidates: &[Candidate],
        progress: &dyn Tell,
    ) -> NextDemonstration {
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
                "no effect's interval spans more than ± {SMALL_MM} mm of the reach; where an effect could move it by \
                 more, its estimate lies as far from no effect, and more data of the same kind would not change that"
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
        let nuisances = self.nuisances(std::slice::from_ref(&model));
        let simulated = match self.prospects(std::slice::from_ref(&model), &nuisances, candidates, progress) {
            Ok(simulated) => simulated,
            Err(error) => return NextDemonstration::nothing(error.to_string()),
        };
        let mut motions: Vec<MotionProspect> = candidates.iter().map(MotionProspect::new).collect();
        for (motion, predicted) in motions.iter_mut().zip(&simulated.predicted) {
            match predicted {
                Ok(models) => {
                    let (slopes, _) = models[0].seen(&self.look, Some(&self.noise), &[]);
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
