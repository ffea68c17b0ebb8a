//! What a refit adds to a model: one effect, or several that explain the residual together.

use super::score::{Score, Subset};
use crate::effects;
use crate::model::Structure;

/// Effects that a refit adds, and what their score promises.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Candidate {
    /// Names of the effects.
    pub(super) ids: Vec<String>,
    /// Predicted drop of the whitened sum of squares.
    pub(super) statistic: f64,
    /// What it has to exceed.
    pub(super) threshold: f64,
    /// One-step estimates of their parameters, effect after effect.
    pub(super) estimate: Vec<f64>,
    /// By how much the parameters that the model has already change with them.
    pub(super) own_change: Vec<f64>,
}

impl From<&Score> for Candidate {
    fn from(score: &Score) -> Self {
        Self {
            ids: vec![score.id.clone()],
            statistic: score.statistic,
            threshold: score.threshold,
            estimate: score.estimate.clone(),
            own_change: score.own_change.clone(),
        }
    }
}

impl From<&Subset> for Candidate {
    fn from(subset: &Subset) -> Self {
        Self {
            ids: subset.ids.clone(),
            statistic: subset.statistic,
            threshold: subset.threshold,
            estimate: subset.estimate.clone(),
            own_change: subset.own_change.clone(),
        }
    }
}

impl Candidate {
    /// Whether data without any effect would rarely give as much.
    pub(super) fn significant(&self) -> bool {
        self.statistic > self.threshold
    }

    /// Indices into [`effects::ALL`].
    pub(super) fn effects(&self) -> impl Iterator<Item = usize> {
        let index = |id: &String| effects::find(id).expect("the registry scored it");
        self.ids.iter().map(index)
    }

    /// A model with these effects as well.
    pub(super) fn added_to(&self, structure: &Structure) -> Structure {
        self.effects()
            .fold(structure.clone(), |wider, effect| wider.with(effect))
    }

    /// θ of a model with these effects, as many times as large as their one-step estimates as `larger` says. A one-step
    /// estimate can overshoot; half the physical range is a safe start.
    pub(super) fn start(&self, own: &[f64], larger: f64) -> Vec<f64> {
        let parameters = self.effects().flat_map(|effect| effects::ALL[effect].parameters);
        let added = parameters.zip(&self.estimate).map(|(p, estimate)| {
            let safe = [p.low, p.high].map(|end| 0.5 * (end + p.vanishes_at));
            (p.vanishes_at + larger * estimate).clamp(safe[0], safe[1])
        });
        own.iter().copied().chain(added).collect()
    }

    /// θ of a model in which they do nothing.
    pub(super) fn nothing(&self, own: &[f64]) -> Vec<f64> {
        let vanishing = self.effects().flat_map(|effect| effects::ALL[effect].vanishing());
        own.iter().copied().chain(vanishing).collect()
    }

    /// Its name, for people.
    pub(super) fn name(&self) -> String {
        self.ids.join(" + ")
    }
}
