//! The models that a diagnosis leaves open.

use super::super::choice::{CARE_SIZES, ties};
use super::super::refits::REFIT_EVALUATIONS;
use super::super::rounds::{LoopOptions, Outcome};
use super::super::verdict::Verdict;
use crate::demo::Demo;
use crate::effects;
use crate::fit::{FitError, FitResult, Problem, fit_from};
use crate::model::Structure;
use rayon::prelude::*;

/// A model that the data allow.
#[derive(Clone)]
pub(super) struct Model {
    pub(super) structure: Structure,
    /// θ of the fit.
    pub(super) theta: Vec<f64>,
}

impl Model {
    /// With one more effect, at the value at which it vanishes.
    pub(super) fn with(&self, effect: usize) -> Self {
        let mut theta = self.theta.clone();
        theta.extend(effects::ALL[effect].vanishing());
        Self {
            structure: self.structure.with(effect),
            theta,
        }
    }

    /// Standard deviations of the priors of θ; those of effects from index `free` on are a nuisance's.
    pub(super) fn prior_sd(&self, free: usize) -> Vec<f64> {
        let count = |&e: &usize| effects::ALL[e].parameters.len();
        let own = 2 + self.structure.effects[..free].iter().map(count).sum::<usize>();
        let info = self.structure.parameters();
        let sd = info.iter().enumerate().map(|(k, p)| {
            if k < own {
                p.prior_sd
            } else {
                CARE_SIZES * p.smallest_of_interest
            }
        });
        sd.collect()
    }
}

/// The models between which the data cannot choose: the final one and those that fit as well.
pub(super) fn alike(outcome: &Outcome) -> Vec<Model> {
    let last = Model {
        structure: outcome.structure.clone(),
        theta: outcome.fitted.best.theta.clone(),
    };
    let open = matches!(outcome.verdict, Verdict::Confounded { .. });
    let rivals = outcome.rivals.iter().filter(|_| open).map(|rival| Model {
        structure: Structure::of_ids(&rival.effects),
        theta: rival.theta.clone(),
    });
    std::iter::once(last).chain(rivals).collect()
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
    problem.noise_scale = outcome.noise.scale;
    let models = alike(outcome);
    let refits = models.par_iter().map(|model| {
        let here = problem.refined(options.finer, &model.structure, &model.theta)?;
        fit_from(&here, &model.structure, model.theta.clone(), REFIT_EVALUATIONS)
    });
    let fits: Vec<FitResult> = refits.collect::<Result<_, _>>()?;
    let mut order: Vec<usize> = (0..models.len()).collect();
    order.sort_by(|&a, &b| fits[a].best.rms_m().total_cmp(&fits[b].best.rms_m()));
    let best = order[0];
    order.retain(|&m| m == best || ties(&fits[best], &fits[m]));
    Ok(order.into_iter().map(|m| models[m].structure.ids()).collect())
}
