//! What the loop has come to after its first fit or a round, so that a diagnosis that was killed goes on from there and
//! finds the same.

use super::bench::Bench;
use super::choice::Standing;
use super::round::Round;
use crate::fit::{FitError, FitResult, Problem, StopReason, fit_from};
use crate::model::Structure;
use serde::{Deserialize, Serialize};

/// The loop after its first fit or a round.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Memory {
    pub(super) base: KeptFit,
    pub(super) now: KeptModel,
    /// What fits as well as that.
    pub(super) rivals: Vec<KeptModel>,
    pub(super) rounds: Vec<Round>,
    /// What passed second in the first round.
    pub(super) other: Option<KeptModel>,
}

/// A fit by where it ended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct KeptFit {
    theta: Vec<f64>,
    stop: StopReason,
    evaluations: usize,
    ends: Vec<(f64, f64)>,
}

/// A model of the loop by its parameters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeptModel {
    /// Its effects.
    pub effects: Vec<String>,
    /// θ of its fit.
    pub theta: Vec<f64>,
    /// As [`FitResult::prior_weight`].
    pub prior_weight: f64,
}

impl KeptFit {
    pub(super) fn of(fit: &FitResult) -> Self {
        Self {
            theta: fit.best.theta.clone(),
            stop: fit.stop,
            evaluations: fit.evaluations,
            ends: fit.ends.clone(),
        }
    }

    /// Where it ended.
    pub(super) fn theta(&self) -> &[f64] {
        &self.theta
    }

    /// The same fit of the base model, evaluated once more.
    pub(super) fn again(&self, problem: &Problem) -> Result<FitResult, FitError> {
        let fit = fit_from(problem, &Structure::default(), self.theta.clone(), 1)?;
        Ok(FitResult {
            stop: self.stop,
            evaluations: self.evaluations,
            ends: self.ends.clone(),
            ..fit
        })
    }
}

impl KeptModel {
    pub(super) fn of(standing: &Standing) -> Self {
        Self {
            effects: standing.structure.ids(),
            theta: standing.fitted.best.theta.clone(),
            prior_weight: standing.fitted.prior_weight,
        }
    }

    /// A bench refined at the model.
    pub(super) fn bench<'a>(&self, bench: &Bench<'a>) -> Result<Bench<'a>, FitError> {
        bench.refined(&Structure::of_ids(&self.effects), &self.theta)
    }

    /// The same model, evaluated once more.
    pub(super) fn again(&self, bench: &Bench) -> Result<Standing, FitError> {
        let structure = Structure::of_ids(&self.effects);
        let fitted = FitResult {
            prior_weight: self.prior_weight,
            ..bench.again(&structure, &self.theta)?
        };
        Standing::of(bench, structure, fitted)
    }
}
