//! Other identified ropes that a blob holds beside the run's own: one policy answers for each by its stiffness.

use super::BesideSummary;
use super::identify::Identified;
use super::learn::{design, reach, swing_of};
use super::settings::{RunSettings, refuse_unnameable};
use crate::collect::Watch;
use crate::evaluate::MissSummary;
use crate::model_file::ModelFile;
use crate::reach::ReachTable;
use crate::swing::swingable;
use anyhow::Context;
use shared::blob::MAX_ROPES;
use shared::policy::{Policy, TrainingRanges};
use shared::task::{Interval, SwingTask};

/// A rope that was asked how it swings by a policy of another.
pub struct Beside {
    /// What it is.
    pub model: ModelFile,
    /// Goals that it reaches, m.
    pub reach_m: Interval,
    /// |goal − reached| over some of them.
    pub miss: MissSummary,
}

impl Beside {
    /// For the run's record.
    pub fn summary(&self) -> BesideSummary {
        BesideSummary {
            name: self.model.name.clone(),
            reach_m: self.reach_m,
            miss: self.miss,
        }
    }
}

/// Refuses ropes that no blob could hold beside one called `own`, before hours of work.
///
/// # Errors
/// There are too many, two have one name, one has a name for which a blob has no room, or one is too long for the task.
pub fn refuse_beside(own: &str, others: &[ModelFile]) -> anyhow::Result<()> {
    anyhow::ensure!(
        others.len() < MAX_ROPES,
        "{} ropes beside {own} are more than the {} that a blob has room for: leave some out of --also",
        others.len(),
        MAX_ROPES - 1
    );
    for (index, other) in others.iter().enumerate() {
        let name = &other.name;
        refuse_unnameable(name, 1)?;
        let earlier = others[..index].iter().map(|model| model.name.as_str());
        anyhow::ensure!(
            name != own && !earlier.clone().any(|before| before == name),
            "two ropes are called {name}: leave one out of --also, or run one again with another --name"
        );
        swingable(&other.rope, &SwingTask::PAPER).with_context(|| format!("rope {name}"))?;
    }
    Ok(())
}

/// Refuses ropes that the policy of an identified one will not be trained for, before hours of work.
///
/// # Errors
/// One is softer or stiffer than any that the policy will be trained on.
pub fn refuse_untrained(
    identified: &Identified,
    settings: &RunSettings,
    others: &[ModelFile],
) -> anyhow::Result<()> {
    let model = &identified.model;
    let trained = design(&swing_of(model)?, model, settings).young_pa;
    others
        .iter()
        .try_for_each(|other| refuse_outside(other, &trained).with_context(|| format!("rope {}", other.name)))
}

/// Swings other ropes by a policy that learnt one, towards goals that are predicted to be reached.
///
/// # Errors
/// A rope is outside what the policy was trained on or comes to no goal; stopped on request.
pub fn beside(
    policy: &Policy,
    predicted: &ReachTable,
    others: Vec<ModelFile>,
    watch: Watch,
) -> anyhow::Result<Vec<Beside>> {
    let swung = others.into_iter().map(|model| {
        let what = format!("rope {}", model.name);
        swing_beside(policy, predicted, model, watch).context(what)
    });
    swung.collect()
}

fn swing_beside(
    policy: &Policy,
    predicted: &ReachTable,
    model: ModelFile,
    watch: Watch,
) -> anyhow::Result<Beside> {
    let told = told(&model, policy.ranges())?;
    let (reach_m, swings) = reach((policy, predicted), &swing_of(&model)?, told, watch)?;
    Ok(Beside {
        reach_m,
        miss: swings.miss.context("no swing of this rope has a score")?,
        model,
    })
}

/// What a policy of some training ranges is told of a rope: Young's modulus, Pa, and Poisson's ratio.
///
/// # Errors
/// It is softer or stiffer than any that the policy was trained on.
fn told(model: &ModelFile, ranges: &TrainingRanges) -> anyhow::Result<(f64, f64)> {
    let [young_pa, poisson] = [0, 1].map(|k| model.elasticity[k].value);
    refuse_outside(model, &ranges.young_pa)?;
    Ok((young_pa, ranges.poisson.clamp(poisson)))
}

fn refuse_outside(model: &ModelFile, trained: &Interval) -> anyhow::Result<()> {
    let young_pa = model.elasticity[0].value;
    anyhow::ensure!(
        trained.contains(young_pa),
        "its Young's modulus, {young_pa:.3e} Pa, is outside of what the policy is trained on, {:.3e} to {:.3e} Pa: give it \
         a policy of its own",
        trained.low,
        trained.high
    );
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::learn::REACH_GOALS;
    use super::*;
    use crate::collect::stand_in::unwatched;
    use crate::freeze::tests::blob;
    use crate::model_file::tests::model;

    fn named(name: &str, length_m: f64, young_pa: f64) -> ModelFile {
        let mut model = model(0.0, young_pa);
        model.name = name.into();
        model.rope.length_m = length_m;
        model
    }

    #[test]
    fn ropes_that_no_blob_could_hold_are_refused_at_once() {
        let blue = named("blue", 0.26, 1e6);
        assert!(refuse_beside("red", std::slice::from_ref(&blue)).is_ok());
        let refused = |others: &[ModelFile]| refuse_beside("red", others).unwrap_err().to_string();
        assert!(refused(&[named("red", 0.26, 1e6)]).starts_with("two ropes are called red"));
        assert!(refused(&[blue.clone(), blue.clone()]).starts_with("two ropes are called blue"));
        assert_eq!(refused(&[named("long", 0.6, 1e6)]), "rope long");
        assert!(refused(&vec![blue; MAX_ROPES]).starts_with("16 ropes beside red are more than the 15"));
    }

    /// The same policy answers for a rope that is heavier at its end.
    #[test]
    fn another_rope_is_swung_as_what_it_is() {
        let blob = blob();
        let ranges = *blob.policy.ranges();
        let all = |_, _| Interval { low: 0.2, high: 0.5 };
        let predicted = ReachTable::new(ranges.young_pa, ranges.poisson, all);
        let swung = |others: Vec<ModelFile>| beside(&blob.policy, &predicted, others, unwatched());
        let mut heavy = named("heavy", 0.26, 0.6e6);
        heavy.effects = model(0.01, 0.6e6).effects;
        let ropes = swung(vec![named("light", 0.26, 0.6e6), heavy]).unwrap();
        let [light, heavy] = [0, 1].map(|k| &ropes[k]);
        assert_eq!([light.miss.count, heavy.miss.count], [REACH_GOALS; 2]);
        assert!(
            light.reach_m.low > 0.2 && light.reach_m.high < 0.5,
            "{:?}",
            light.reach_m
        );
        assert_ne!(light.reach_m, heavy.reach_m);
        let refused = swung(vec![named("stiff", 0.26, 9e6)]).err().unwrap();
        assert!(format!("{refused:#}").starts_with("rope stiff: its Young's modulus, 9.000e6 Pa"));
    }
}
