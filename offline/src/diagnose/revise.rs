//! Second thoughts on a model: whether it needs all of its effects, and whether it fits better elsewhere.

use super::bench::Bench;
use super::choice::Standing;
use super::gates::{all_physical, clear_of_nothing, needs, within_ranges};
use super::memory::KeptModel;
use super::refits::REFIT_EVALUATIONS;
use super::rivals::by_another_way;
use super::round::{Refit, Round};
use crate::effects;
use crate::fit::{Descent, FitError, FitResult, estimates};
use crate::model::Structure;
use crate::tell::Tell;

/// A model that was just extended, without those of its earlier effects that it needs no more, and their names: what an
/// effect took away in place of another it leaves to that one once it is there. What remains costs less than the model
/// `before`, so that no round undoes another. An effect that was added beside one that goes may have made up for that
/// one, and is asked for as well then; so are the rivals of the last effect, which were judged in the same company.
pub(super) fn needed(
    bench: &Bench,
    before: &Standing,
    mut model: Standing,
    progress: &dyn Tell,
) -> (Standing, Vec<String>) {
    let mut dropped = Vec::new();
    let mut some = before.structure.effects.clone();
    while let Some((smaller, id)) = spared(bench, &model, &some, before.fitted.cost, progress) {
        dropped.push(id);
        some.clone_from(&smaller.structure.effects);
        model = Standing {
            rivals: model.rivals,
            ..smaller
        };
    }
    if !dropped.is_empty() {
        let rivals = std::mem::take(&mut model.rivals);
        model.rivals = rivals_of_less(bench, &model, rivals, progress);
    }
    (model, dropped)
}

/// The model without the first of some effects that may be nothing and is not needed, where that costs less than `below`,
/// and the effect's name.
fn spared(
    bench: &Bench,
    model: &Standing,
    some: &[usize],
    below: f64,
    progress: &dyn Tell,
) -> Option<(Standing, String)> {
    doubtful(model, some).into_iter().find_map(|effect| {
        let id = effects::ALL[effect].id;
        progress.say(&format!("asking whether {id} is still needed"));
        let smaller = without(bench, model, effect)?;
        (smaller.fitted.cost < below).then(|| {
            progress.say(&format!("{id} is not needed any more"));
            (smaller, id.to_owned())
        })
    })
}

/// What is left of the rivals of a model that lost some effects: each without those of its own that it does not need, if
/// it still ties and is not the model itself, or more or less of it.
pub(super) fn rivals_of_less(
    bench: &Bench,
    model: &Standing,
    rivals: Vec<KeptModel>,
    progress: &dyn Tell,
) -> Vec<KeptModel> {
    let mut left: Vec<KeptModel> = Vec::new();
    for rival in rivals {
        let Ok(mut rival) = rival.again(bench) else {
            continue;
        };
        let below = f64::INFINITY;
        while let Some((smaller, _)) = spared(bench, &rival, &rival.structure.effects, below, progress) {
            rival = smaller;
        }
        let kept = by_another_way(model, &rival);
        let known = |kept: &KeptModel| left.iter().any(|one| one.effects == kept.effects);
        left.extend(kept.filter(|kept| !known(kept)));
    }
    left
}

/// Which of the effects that a model was extended by together it does not need.
pub(super) fn needs_not(bench: &Bench, model: &Standing, added: &[String]) -> Vec<String> {
    let added = Structure::of_ids(added).effects;
    let not = doubtful(model, &added)
        .into_iter()
        .filter(|&effect| without(bench, model, effect).is_some());
    not.map(|effect| effects::ALL[effect].id.to_owned()).collect()
}

/// Those of some effects that may be nothing.
fn doubtful(model: &Standing, some: &[usize]) -> Vec<usize> {
    let all = estimates(&model.fitted.best, &model.structure);
    let nothing = some.iter().filter(|&&effect| {
        let own = &all[model.structure.entries(effect)];
        !clear_of_nothing(&effects::ALL[effect], own)
    });
    nothing.copied().collect()
}

/// The model without an effect, where it is no worse than chance lets it be and its other effects keep physical values.
fn without(bench: &Bench, model: &Standing, effect: usize) -> Option<Standing> {
    let without = refitted_without(bench, model, &[effect])?;
    let free = bench
        .fit
        .free_entries(&model.structure, &model.fitted.best, effect);
    (!needs(free, [&without, model])).then_some(without)
}

/// The model without some effects, fitted again, where its others keep physical values.
pub(super) fn refitted_without(bench: &Bench, model: &Standing, gone: &[usize]) -> Option<Standing> {
    let (mut theta, mut structure) = (model.fitted.best.theta.clone(), model.structure.clone());
    for &effect in gone {
        theta.drain(structure.entries(effect));
        structure = structure.without(effect);
    }
    let start = Descent::at(&bench.fit, &structure, &theta).ok()?;
    let fitted = refitted(start, model);
    let without = Standing::of(bench, structure, fitted).ok()?;
    let values = estimates(&without.fitted.best, &without.structure);
    within_ranges(&without.structure, &values).then_some(without)
}

/// Where a fit ends that is compared with a model: with the prior as heavy as in the model's own.
fn refitted(start: Descent, model: &Standing) -> FitResult {
    let start = start.under(model.fitted.prior_weight);
    start.run(REFIT_EVALUATIONS).finish()
}

/// The model that a loop ended with, fitted again where refits with one more effect came upon a better fit of it: along
/// a valley, as of a cable's stiffness and end mass, a descent may end early, and an effect that then turns out to be
/// next to nothing only gave it another start. No gate is asked again: the model explains more than when it passed them.
pub(super) fn better(
    bench: &Bench,
    last: Standing,
    rounds: &[Round],
    progress: &dyn Tell,
) -> Result<Standing, FitError> {
    let starts = better_starts(&last, rounds);
    if starts.is_empty() {
        return Ok(last);
    }
    progress.say("asking whether the model fits better where refits left less");
    let start = Descent::at_first(&bench.fit, &last.structure, starts, last.fitted.cost);
    let again = start.map(|start| refitted(start, &last));
    let Some(again) = again.ok().filter(|again| again.cost < last.fitted.cost) else {
        return Ok(last);
    };
    let again = Standing::of(bench, last.structure.clone(), again)?;
    let physical = all_physical(&again.structure, &estimates(&again.fitted.best, &again.structure));
    if !physical || again.held.rms_mm > last.held.rms_mm {
        return Ok(last);
    }
    Ok(Standing {
        rivals: last.rivals,
        ..again
    })
}

/// Parameters of a model in the refits of it with one more effect that leave less than it does, least first.
fn better_starts(last: &Standing, rounds: &[Round]) -> Vec<Vec<f64>> {
    /// A start costs an evaluation at least.
    const MOST: usize = 3;
    let left_mm = last.left.rms_mm;
    // Refits of a round that accepted an effect are of the model before.
    let of_it = rounds.last().filter(|round| round.known == last.structure.ids());
    let refits = of_it.map_or(&[][..], |round| &round.refits);
    let mut less: Vec<&Refit> = refits.iter().filter(|refit| refit.fit.rms_mm < left_mm).collect();
    less.sort_by(|a, b| a.fit.rms_mm.total_cmp(&b.fit.rms_mm));
    let own = last.structure.parameters().len();
    less.iter()
        .take(MOST)
        .map(|refit| refit.theta[..own].to_vec())
        .collect()
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::conclude::tests::fitted;
    use super::*;
    use crate::bench_diagnosis::experiment::MOTIONS;
    use crate::bench_diagnosis::reality::{Finer, Part, Reality, part};
    use crate::demo::Demo;
    use crate::diagnose::{LoopOptions, ScoreTable};
    use crate::fit::{Resolution, fit_from};
    use crate::residual::ResidualSummary;
    use crate::tell::Silent;
    use std::collections::BTreeMap;
    use std::sync::{Arc, Mutex, OnceLock};

    fn of_effects(ids: &[&str]) -> Structure {
        Structure::of_ids(&ids.iter().map(ToString::to_string).collect::<Vec<_>>())
    }

    /// A model that leaves `rms_mm` everywhere.
    pub fn standing(ids: &[&str], rms_mm: f64) -> Standing {
        let structure = of_effects(ids);
        let fitted = fitted(&structure, 1e-3 * rms_mm);
        let held = ResidualSummary::of(&fitted.best);
        Standing::judged(structure, fitted, held)
    }

    fn refit(theta: &[f64], rms_mm: f64) -> Refit {
        let left = standing(&[], rms_mm).held;
        Refit {
            ids: vec!["tilted_gravity".into()],
            parameters: Vec::new(),
            theta: theta.to_vec(),
            cost: rms_mm * rms_mm,
            fit: left.clone(),
            held_out: left,
            gates: Vec::new(),
            passed: false,
        }
    }

    /// Seen on a cable: a model left 4.90 mm, and with a table that leans by 1e-4 rad 4.41 mm. Where the last round
    /// accepted an effect, what follows a refit's own parameters there is another effect's.
    #[test]
    fn refits_that_leave_less_show_where_the_model_fits_better() {
        let refits = vec![
            refit(&[16.0, 0.3, 0.1, 0.0, 0.0], 4.90),
            refit(&[16.3, 0.3, 0.2, 1.0], 4.49),
            refit(&[16.4, 0.3, 0.25, -1e-4, 0.0], 4.41),
        ];
        let round = |known: &[&str]| Round {
            known: known.iter().map(ToString::to_string).collect(),
            table: ScoreTable::of(Vec::new()),
            refits: refits.clone(),
            accepted: Vec::new(),
            dropped: Vec::new(),
            nothing: Vec::new(),
            only_numerical: false,
            instead_of: Vec::new(),
        };
        let starts = |left_mm, known| better_starts(&standing(&["tip_mass"], left_mm), &[round(known)]);
        assert_eq!(starts(4.90, &["tip_mass"]), [[16.4, 0.3, 0.25], [16.3, 0.3, 0.2]]);
        assert!(starts(4.40, &["tip_mass"]).is_empty());
        assert!(starts(4.90, &[]).is_empty(), "refits of the model before");
    }

    /// Young's modulus of the ropes below, Pa.
    pub const YOUNG_PA: f64 = 0.6e6;

    /// Every motion of a rope with some causes; simulated once for all tests that ask for them.
    pub fn recorded(parts: &[Part]) -> Arc<Vec<Demo>> {
        type Recorded = OnceLock<Arc<Vec<Demo>>>;
        static ALL: Mutex<BTreeMap<String, Arc<Recorded>>> = Mutex::new(BTreeMap::new());
        let of_these = Arc::clone(ALL.lock().unwrap().entry(format!("{parts:?}")).or_default());
        let record = || {
            let tracks = Finer.rough_tracks(YOUNG_PA, parts, &MOTIONS).unwrap();
            let motions = MOTIONS.iter().zip(&tracks);
            let demos = motions.map(|(motion, track)| motion.demo(track, 1e-3, 5));
            Arc::new(demos.collect())
        };
        Arc::clone(of_these.get_or_init(record))
    }

    /// Usual options.
    pub fn options() -> LoopOptions {
        LoopOptions::new(Resolution::COARSEST, 5)
    }

    /// Where a model with some effects comes to soon.
    pub fn with(bench: &Bench, ids: &[&str]) -> Standing {
        once(bench, ids, || {
            let structure = of_effects(ids);
            let start = Descent::at(&bench.fit, &structure, &structure.start(YOUNG_PA)).unwrap();
            Standing::of(bench, structure, start.run(10).finish()).unwrap()
        })
    }

    /// A model that is fitted once for all tests that ask for it with the same demonstration of [`recorded`].
    fn once(bench: &Bench, ids: &[&str], fit: impl FnOnce() -> Standing) -> Standing {
        type Fits = BTreeMap<(usize, String), Arc<OnceLock<KeptModel>>>;
        static ALL: Mutex<Fits> = Mutex::new(Fits::new());
        // What was recorded is kept for ever, so its place tells it apart.
        let demo = std::ptr::from_ref(bench.fit.demos[0]).addr();
        let of_these = Arc::clone(ALL.lock().unwrap().entry((demo, format!("{ids:?}"))).or_default());
        let model = of_these.get_or_init(|| KeptModel::of(&fit()));
        model.again(bench).unwrap()
    }

    /// What is told of a model whose last effect passed.
    pub fn passed(model: &Standing) -> Refit {
        Refit {
            ids: model.structure.ids().pop().into_iter().collect(),
            parameters: Vec::new(),
            theta: model.fitted.best.theta.clone(),
            cost: model.fitted.cost,
            fit: model.left.clone(),
            held_out: model.held.clone(),
            gates: Vec::new(),
            passed: true,
        }
    }

    /// The base model's best.
    pub fn base(bench: &Bench) -> Standing {
        once(bench, &[], || {
            let structure = Structure::default();
            let fitted = fit_from(&bench.fit, &structure, vec![YOUNG_PA.ln(), 0.3], 12).unwrap();
            Standing::of(bench, structure, fitted).unwrap()
        })
    }

    /// Names of the effects that stay of a model with a tip mass and a density gradient, fitted to a rope with these
    /// true sizes of them, in units.
    fn stay(tip_mass: f64, density_gradient: f64) -> Vec<String> {
        let parts = [
            part("tip_mass", tip_mass),
            part("density_gradient", density_gradient),
        ];
        let demos = recorded(&parts);
        let bench = Bench::new(&[&demos[0]], &[&demos[1]], &options()).unwrap();
        let [first, last] = parts.each_ref().map(|part| effects::find(&part.id).unwrap());
        let structure = Structure::default().with(first);
        let nothing = vec![YOUNG_PA.ln(), 0.3, 0.0];
        let fitted = fit_from(&bench.fit, &structure, nothing, 1).unwrap();
        let before = Standing::of(&bench, structure.clone(), fitted).unwrap();
        let structure = structure.with(last);
        let values = parts.iter().flat_map(|part| part.values.clone());
        let theta = [YOUNG_PA.ln(), 0.3].into_iter().chain(values).collect();
        let fitted = fit_from(&bench.fit, &structure, theta, REFIT_EVALUATIONS).unwrap();
        let model = Standing::of(&bench, structure, fitted).unwrap();
        let (model, dropped) = needed(&bench, &before, model, &Silent);
        assert_eq!(model.structure.effects.len() + dropped.len(), 2);
        model.structure.ids()
    }

    /// Seen on the benchmark's ropes: the tip mass that passed for a density gradient stayed when that was found, with
    /// a mass of nothing.
    #[test]
    fn an_effect_that_another_replaced_goes() {
        assert_eq!(stay(0.0, 12.0), ["density_gradient"]);
    }

    /// Seen on the benchmark's ropes: a relaxation of nothing stayed of a rope that yields, because clamps that give did
    /// as well as that, with the same relaxation of nothing.
    #[test]
    fn an_effect_that_another_replaced_goes_from_what_ties_too() {
        let demos = recorded(&[part("gripper_lag", 0.5)]);
        let bench = Bench::new(&[&demos[0]], &[&demos[1]], &options()).unwrap();
        let beside_nothing = |id: &str| KeptModel {
            effects: vec!["tip_mass".to_owned(), id.to_owned()],
            theta: vec![YOUNG_PA.ln(), 0.3, 0.0, part("gripper_lag", 0.5).values[0]],
            prior_weight: 1.0,
        };
        let model = Standing {
            rivals: vec![beside_nothing("clock_offset")],
            ..beside_nothing("gripper_lag").again(&bench).unwrap()
        };
        let (model, dropped) = needed(&bench, &with(&bench, &["tip_mass"]), model, &Silent);
        assert_eq!(
            (model.structure.ids(), dropped),
            (vec!["gripper_lag".into()], vec!["tip_mass".into()])
        );
        let rivals: Vec<_> = model.rivals.into_iter().map(|rival| rival.effects).collect();
        assert_eq!(rivals, [["clock_offset"]]);
    }

    #[test]
    fn an_effect_beside_another_stays() {
        assert_eq!(stay(3.0, 12.0), ["tip_mass", "density_gradient"]);
    }
}
