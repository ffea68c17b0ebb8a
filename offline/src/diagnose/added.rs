//! A subset of the library as what a refit adds to a model: one effect, or several that explain the residual together.

use super::round::Refit;
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

    /// Whether a refit had some of these effects and no others.
    pub(super) fn has_more_than(&self, refit: &Refit) -> bool {
        refit.ids.len() < self.ids.len() && refit.ids.iter().all(|id| self.ids.contains(id))
    }

    /// θ of a structure with these effects, in which those that a refit of it had are as they were there, and the others do
    /// nothing.
    pub(super) fn beyond(&self, refit: &Refit, structure: &Structure) -> Vec<f64> {
        let (wider, mut had) = (self.added_to(structure), structure.clone());
        had.effects.extend(Structure::of_ids(&refit.ids).effects);
        let mut theta = self.nothing(&refit.theta[..structure.parameters().len()]);
        for &effect in &had.effects[structure.effects.len()..] {
            theta[wider.entries(effect)].copy_from_slice(&refit.theta[had.entries(effect)]);
        }
        theta
    }

    /// Its name, for people.
    pub(super) fn name(&self) -> String {
        effects::together(&self.ids)
    }
}

#[cfg(test)]
mod tests {
    use super::super::choice::tests::tried;
    use super::*;

    #[test]
    fn a_pair_may_start_where_a_refit_with_one_of_it_ended() {
        let pair = Subset {
            ids: vec!["tip_mass".into(), "rest_curvature".into()],
            ..Subset::from(&Score::alone("tip_mass", 1.0, 1.0))
        };
        let curl = tried("rest_curvature", &[0.5, -1.1], 4.0).refit;
        assert!(pair.has_more_than(&curl));
        assert!(!pair.has_more_than(&tried("tilted_gravity", &[0.1, 0.0], 4.0).refit));
        assert!(
            !Subset {
                ids: vec!["rest_curvature".into()],
                ..pair.clone()
            }
            .has_more_than(&curl)
        );
        assert_eq!(
            pair.beyond(&curl, &Structure::default()),
            [14.0, 0.3, 0.0, 0.5, -1.1]
        );
    }
}
