//! A subset of the library as what a refit adds to a model: one effect, or several that explain the residual together.

use super::score::{Score, Subset};
use crate::effects;
use crate::model::Structure;

impl From<&Score> for Subset {
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

impl Subset {
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
        effects::together(&self.ids)
    }
}
