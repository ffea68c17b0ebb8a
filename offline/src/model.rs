//! A model of the rope: elastic parameters plus the effects that were found, as a parameter vector
//! θ = (ln E, ν, parameters of each effect) on which fits and rollouts agree.

use crate::effects;
use crate::sim::{Physics, Real};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Range and prior of one entry of θ.
#[derive(Clone, Debug, PartialEq)]
pub struct ParameterInfo {
    /// `young_pa`, `poisson` or `<effect>.<parameter>`.
    pub name: String,
    /// Unit of the reported value.
    pub unit: &'static str,
    /// Lowest admissible entry of θ.
    pub low: f64,
    /// Highest admissible entry of θ.
    pub high: f64,
    /// Centre of the weak prior.
    pub prior_mean: f64,
    /// Standard deviation of the weak prior: the parameter's range. It only keeps a fit away from
    /// nowhere when the data say nothing, and is far wider than any useful estimate.
    pub prior_sd: f64,
    /// A change of this size matters.
    pub smallest_of_interest: f64,
    /// Whether it moves a rope out of its plane, see [`effects::ParameterSpec::sideways`].
    pub sideways: bool,
}

impl ParameterInfo {
    /// Whether an entry of θ lies inside the range.
    pub fn holds(&self, value: f64) -> bool {
        self.low < value && value < self.high
    }

    /// Whether an entry of θ is at an end of the range, or beyond. Where an effect vanishes is no such end.
    pub fn ends_at(&self, value: f64) -> bool {
        !self.holds(value) && value != self.prior_mean
    }
}

/// Young's moduli that the program admits, Pa: from ten times below the paper's range to stiff cables
/// (measured ones of `pac_cables` lie at 15 to 50 MPa).
pub const YOUNG_RANGE_PA: [f64; 2] = [2.0e4, 2.0e8];
/// Poisson's ratios that the program admits.
pub const POISSON_RANGE: [f64; 2] = [0.05, 0.45];
/// Middle of the paper's range of Poisson's ratio and half its width.
pub const POISSON_PRIOR: [f64; 2] = [0.3, 0.1];

/// Which effects a model has.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Structure {
    /// Indices into [`effects::ALL`].
    pub effects: Vec<usize>,
}

impl Structure {
    /// The structure of the effects with these names; unknown ones are left out.
    pub fn of_ids(ids: &[String]) -> Self {
        Self {
            effects: ids.iter().filter_map(|id| effects::find(id)).collect(),
        }
    }

    /// Names of the effects.
    pub fn ids(&self) -> Vec<String> {
        self.effects.iter().map(|&e| effects::ALL[e].id.into()).collect()
    }

    /// The same structure with one more effect.
    pub fn with(&self, effect: usize) -> Self {
        let mut effects = self.effects.clone();
        effects.push(effect);
        Self { effects }
    }

    /// The same structure without an effect.
    pub fn without(&self, effect: usize) -> Self {
        let others = self.effects.iter().copied().filter(|&other| other != effect);
        Self {
            effects: others.collect(),
        }
    }

    /// Places in θ of the parameters of an effect that the structure has; those behind the last where it has not.
    pub fn entries(&self, effect: usize) -> Range<usize> {
        let count = |effect: usize| effects::ALL[effect].parameters.len();
        let before = self.effects.iter().take_while(|&&other| other != effect);
        let first = 2 + before.map(|&other| count(other)).sum::<usize>();
        first..first + count(effect)
    }

    /// What each entry of θ is.
    pub fn parameters(&self) -> Vec<ParameterInfo> {
        let [low, high] = YOUNG_RANGE_PA.map(f64::ln);
        let mut list = vec![
            ParameterInfo {
                name: "young_pa".into(),
                unit: "Pa",
                low,
                high,
                prior_mean: 0.5 * (low + high),
                prior_sd: high - low,
                smallest_of_interest: 0.02,
                sideways: false,
            },
            ParameterInfo {
                name: "poisson".into(),
                unit: "1",
                low: POISSON_RANGE[0],
                high: POISSON_RANGE[1],
                prior_mean: POISSON_PRIOR[0],
                prior_sd: POISSON_PRIOR[1],
                smallest_of_interest: 0.02,
                sideways: false,
            },
        ];
        for &index in &self.effects {
            list.extend(effect_parameters(index));
        }
        list
    }

    /// Entries of θ that a fit took to the end of their range: what is there may be more, and how much at least a profile
    /// says. Where an effect vanishes is no such end.
    pub fn at_an_end(&self, theta: &[f64]) -> Vec<usize> {
        let entries = self.parameters().into_iter().zip(theta).enumerate();
        let ends = entries.filter(|(_, (p, value))| p.ends_at(**value));
        ends.map(|(k, _)| k).collect()
    }

    /// Those of them that are parameters of effects.
    pub fn effects_at_an_end(&self, theta: &[f64]) -> Vec<usize> {
        let own = Self::default().parameters().len();
        let ends = self.at_an_end(theta).into_iter();
        ends.filter(|&entry| entry >= own).collect()
    }

    /// θ of a rope with this structure whose effects all vanish.
    pub fn start(&self, young_pa: f64) -> Vec<f64> {
        let mut theta = vec![young_pa.ln(), POISSON_PRIOR[0]];
        for &index in &self.effects {
            theta.extend(effects::ALL[index].vanishing());
        }
        theta
    }

    /// Coefficients and laws at θ for a table with the declared friction.
    pub fn physics<T: Real>(&self, theta: &[T], friction: f64) -> Physics<T> {
        let mut physics = Physics::base(theta[0].exp(), theta[1], T::of(friction));
        let mut rest = &theta[2..];
        for &index in &self.effects {
            let (values, after) = rest.split_at(effects::ALL[index].parameters.len());
            effects::add_to(index, values, &mut physics);
            rest = after;
        }
        physics
    }
}

/// What the parameters of an effect are as entries of θ.
pub fn effect_parameters(index: usize) -> impl Iterator<Item = ParameterInfo> {
    let spec = &effects::ALL[index];
    spec.parameters.iter().map(|p| ParameterInfo {
        name: format!("{}.{}", spec.id, p.name),
        unit: p.unit,
        low: p.low,
        high: p.high,
        prior_mean: p.vanishes_at,
        prior_sd: p.high - p.low,
        smallest_of_interest: p.smallest_of_interest,
        sideways: p.sideways,
    })
}

/// A parameter with its uncertainty, as reported.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// Name, see [`ParameterInfo`].
    pub name: String,
    /// Unit.
    pub unit: String,
    /// Estimate.
    pub value: f64,
    /// Standard error, correlation of the residual taken into account.
    pub standard_error: f64,
    /// Whether the data say much about it beyond the prior; of E, whether it is known to a factor of 1.6.
    pub identified: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A mass at the end of its range, beside gravity that leans nowhere in one direction.
    #[test]
    fn what_is_nothing_is_at_no_end_of_its_range() {
        let ids = ["tip_mass", "tilted_gravity"].map(String::from);
        let structure = Structure::of_ids(&ids);
        let info = structure.parameters();
        let theta = |mass_kg| [14.0, 0.3, mass_kg, 0.0, 0.01];
        assert_eq!(structure.at_an_end(&theta(info[2].high)), [2]);
        assert_eq!(structure.at_an_end(&theta(0.5 * info[2].high)), [] as [usize; 0]);
        assert_eq!(structure.at_an_end(&theta(info[2].prior_mean)), [] as [usize; 0]);
    }
}
