//! Which refit of a round is the cause: the likeliest that passes every gate, the finer grid's last.

use super::bench::Bench;
use super::gates::{Gate, excuse, superfluous};
use super::memory::KeptModel;
use super::noise::independent_squares;
use super::refinement::{not_refined, refine};
use super::revise::needs_not;
use super::round::Refit;
use super::rounds::{LoopOptions, Part};
use crate::effects;
use crate::fit::{Evaluation, FitError, FitResult};
use crate::model::Structure;
use crate::residual::ResidualSummary;
use crate::tell::Tell;

/// Standard deviation of how a rig was set up, in smallest sizes of interest: a table level to three degrees, cameras
/// placed to 5 mm and one and a half degrees.
pub(super) const CARE_SIZES: f64 = 5.0;

/// A refit with the model that it gave.
pub(super) struct Tried {
    /// What is reported of it.
    pub(super) refit: Refit,
    /// Effects of the model.
    pub(super) structure: Structure,
    /// Its fit.
    pub(super) fitted: FitResult,
    /// Where its descent came to before the prior held it.
    pub(super) cost: f64,
}

impl Tried {
    /// How unlikely it is, with so many independent offsets where held out.
    fn unlikely(&self, rows: f64) -> f64 {
        let rig_off = rig_off(&self.structure, &self.fitted.best.theta);
        unlikely(rows, (&self.refit.held_out, rig_off))
    }
}

/// A model and what it leaves.
pub(super) struct Standing {
    /// Its effects.
    pub(super) structure: Structure,
    /// Its fit.
    pub(super) fitted: FitResult,
    /// What it leaves where fitted.
    pub(super) left: ResidualSummary,
    /// What it leaves where held out.
    pub(super) held: ResidualSummary,
    /// Models that fit as well.
    pub(super) rivals: Vec<KeptModel>,
}

impl Standing {
    /// A fitted model, judged where held out.
    ///
    /// # Errors
    /// What is held out cannot be simulated.
    pub(super) fn of(bench: &Bench, structure: Structure, fitted: FitResult) -> Result<Self, FitError> {
        let held = bench.held_out.residuals(&structure, &fitted.best.theta)?;
        Ok(Self::judged(structure, fitted, ResidualSummary::of(&held)))
    }

    /// The model followed to where the finer grid has it, and the bench refined there.
    ///
    /// # Errors
    /// It cannot be simulated.
    pub(super) fn followed<'a>(&self, bench: &Bench<'a>) -> Result<(Bench<'a>, Self), FitError> {
        let (here, fitted) = bench.followed(&self.structure, &self.fitted)?;
        let there = Self::of(&here, self.structure.clone(), fitted)?;
        let rivals = self.rivals.clone();
        Ok((here, Self { rivals, ..there }))
    }

    /// The model as a bench has it now, and its evaluation where held out.
    ///
    /// # Errors
    /// It cannot be simulated.
    pub(super) fn anew(self, bench: &Bench) -> Result<(Self, Evaluation), FitError> {
        let again = bench.again(&self.structure, &self.fitted.best.theta)?;
        let fitted = FitResult {
            best: again.best,
            cost: again.cost,
            ..self.fitted
        };
        let held_out = bench.held_out.residuals(&self.structure, &fitted.best.theta)?;
        let there = Self::judged(self.structure, fitted, ResidualSummary::of(&held_out));
        let rivals = self.rivals;
        Ok((Self { rivals, ..there }, held_out))
    }

    /// A fitted model that leaves `held` where held out.
    pub(super) fn judged(structure: Structure, fitted: FitResult, held: ResidualSummary) -> Self {
        Self {
            left: ResidualSummary::of(&fitted.best),
            held,
            structure,
            fitted,
            rivals: Vec::new(),
        }
    }
}

/// What the refits of a round have come to so far.
#[derive(Default)]
pub(super) struct Choice {
    /// What the model leaves where fitted is no more than the simulation's own error.
    pub(super) only_numerical: bool,
    /// All of them, the likelier first of those that were judged together.
    pub(super) refits: Vec<Refit>,
    /// What the winner adds, and the model with it and with those that tie with it.
    pub(super) accepted: Option<(Vec<String>, Standing)>,
    /// The model with what passed second, the finer grid not asked.
    pub(super) second: Option<KeptModel>,
}

impl Choice {
    /// Chooses among further refits of the model `now` where none was accepted before; those that passed are tried on the
    /// finer grid, and without each of several effects, likeliest first, until one is accepted, and then those that tie
    /// with it.
    pub(super) fn among(
        &mut self,
        bench: &Bench,
        now: &Standing,
        mut tried: Vec<Tried>,
        options: &LoopOptions,
        progress: &dyn Tell,
    ) {
        excuse_likelier(&mut tried, self.only_numerical);
        sort_by_likelihood(&mut tried);
        if !tried.is_empty() {
            let leave: Vec<String> = tried.iter().map(|t| t.refit.in_brief()).collect();
            progress.say(&format!(
                "they leave (fitted, held out, mm): {}",
                leave.join("; ")
            ));
        }
        for one in tried {
            let mut refit = one.refit;
            let model = Standing::judged(one.structure, one.fitted, refit.held_out.clone());
            if refit.passed && self.would_take(&model) {
                refit.ask(last_gates(
                    bench, &model, &refit.ids, &now.left, options, progress,
                ));
            }
            self.consider(&refit, model);
            // What was given up for one that the finer grid refused may come again.
            self.refits.retain(|had| had.ids != refit.ids);
            self.refits.push(refit);
        }
    }

    /// Whether a model that passes would be the winner or one that ties with it.
    fn would_take(&self, model: &Standing) -> bool {
        let best = self.accepted.as_ref().map(|(_, best)| best);
        best.is_none_or(|best| ties(&best.fitted, &model.fitted))
    }

    /// Takes a model for the winner or for one that ties with it, if it is.
    fn consider(&mut self, refit: &Refit, model: Standing) {
        if !refit.passed {
            return;
        }
        let Some((_, best)) = &mut self.accepted else {
            self.accepted = Some((refit.ids.clone(), model));
            return;
        };
        if ties(&best.fitted, &model.fitted) {
            best.rivals.push(KeptModel::of(&model));
        }
        self.second.get_or_insert_with(|| KeptModel::of(&model));
    }
}

/// What is asked last of a model that passed everything else, because it costs most: whether the effects `added` stay the
/// same on a finer grid and, of several, whether each is needed. `before` is what the model leaves without them.
pub(super) fn last_gates(
    bench: &Bench,
    model: &Standing,
    added: &[String],
    before: &ResidualSummary,
    options: &LoopOptions,
    progress: &dyn Tell,
) -> Vec<Gate> {
    let name = effects::together(added);
    let mut gates = Vec::new();
    if options.without != Some(Part::Refinement) {
        progress.say(&format!("checking {name} on a finer grid"));
        gates = refine(bench, model, added, before).unwrap_or_else(|error| vec![not_refined(&error)]);
    }
    if added.len() > 1 && gates.iter().all(|gate| gate.passed) {
        progress.say(&format!("asking whether {name} are all needed"));
        gates.push(superfluous(&needs_not(bench, model, added)));
    }
    for failed in gates.iter().filter(|gate| !gate.passed) {
        progress.say(&format!("not {}: {}", failed.name, failed.detail));
    }
    gates
}

/// Whether anything is missing is asked once, and what it is of those that are likeliest: where one effect shows that
/// something is, no likelier one has to. The score of a tilt of two noise floors was not significant, and a curl that left
/// 1.33 mm stood in for it, which left 1.02. Nor has it to take away as much of the simulation's own error where that is
/// all that the model leaves where fitted: of 0.70 mm damping took a fifth, relaxation, which stood in for it, a half.
fn excuse_likelier(tried: &mut [Tried], only_numerical: bool) {
    let passed = tried.iter().find(|t| t.refit.passed);
    let Some(shown_by) = passed.map(|t| t.refit.ids.clone()) else {
        return;
    };
    let likelier = ahead_of_all_that_passed(tried.iter());
    for (one, _) in tried.iter_mut().zip(likelier).filter(|(_, likelier)| *likelier) {
        excuse(&mut one.refit, &shown_by, only_numerical);
    }
}

/// Sorts refits, the likeliest first.
fn sort_by_likelihood(tried: &mut [Tried]) {
    let rows = rows_of_best(tried.iter().map(|t| &t.refit.held_out));
    tried.sort_by(|a, b| a.unlikely(rows).total_cmp(&b.unlikely(rows)));
}

/// Which of some refits are likelier than every one that passed.
pub(super) fn ahead_of_all_that_passed<'t>(tried: impl Iterator<Item = &'t Tried> + Clone) -> Vec<bool> {
    let rows = rows_of_best(tried.clone().map(|t| &t.refit.held_out));
    let passed = tried.clone().filter(|t| t.refit.passed);
    let best = passed.map(|t| t.unlikely(rows)).fold(f64::INFINITY, f64::min);
    tried.map(|t| t.unlikely(rows) < best).collect()
}

/// Whether a model is likelier than another.
pub(super) fn likelier(one: &Standing, other: &Standing) -> bool {
    let rows = rows_of_best([&one.held, &other.held].into_iter());
    let unlikely = |m: &Standing| unlikely(rows, (&m.held, rig_off(&m.structure, &m.fitted.best.theta)));
    unlikely(one) < unlikely(other)
}

/// Independent offsets of the model that leaves least where held out. They count for all alike: what a better model leaves
/// is less correlated, which is no merit of its offsets.
fn rows_of_best<'r>(held: impl Iterator<Item = &'r ResidualSummary>) -> f64 {
    let best = held.min_by(|a, b| a.rms_mm.total_cmp(&b.rms_mm));
    best.map_or(0.0, |best| best.effective_rows)
}

/// By what a model leaves where held out and by how far off somebody must have set up the rig for it, both as logarithms of
/// a likelihood. Where the data tell much, as nearly always, that is by the held-out error.
fn unlikely(rows: f64, (held, rig_off): (&ResidualSummary, f64)) -> f64 {
    rows * held.rms_mm.ln() + 0.5 * rig_off
}

/// How far off a rig is at θ, as the sum of squares of standard scores: somebody levelled its table and placed its
/// cameras with care.
fn rig_off(structure: &Structure, theta: &[f64]) -> f64 {
    let own = Structure::default().parameters().len();
    let effects = structure.effects.iter().map(|&effect| &effects::ALL[effect]);
    let parameters = effects.flat_map(|spec| spec.parameters.iter().map(move |p| (spec.of_the_rig, p)));
    parameters
        .zip(&theta[own..])
        .filter(|((of_the_rig, _), _)| *of_the_rig)
        .map(|((_, p), value)| ((value - p.vanishes_at) / (CARE_SIZES * p.smallest_of_interest)).powi(2))
        .sum()
}

/// Two models tie when their mean squares differ by less than two standard errors of one.
pub(super) fn ties(best: &FitResult, other: &FitResult) -> bool {
    let reduced = |f: &FitResult| ResidualSummary::of(&f.best).correlation.reduced_chi_square;
    reduced(other) - reduced(best) < tie_spread(&best.best)
}

/// Difference of mean squares below which a model ties with the best. Correlation leaves more independent squares than
/// independent offsets.
pub(super) fn tie_spread(best: &Evaluation) -> f64 {
    let ResidualSummary {
        rows, correlation, ..
    } = ResidualSummary::of(best);
    let squares = independent_squares(rows as f64, correlation.in_time, correlation.along_rope);
    2.0 * (2.0 / squares.max(1.0)).sqrt() * correlation.reduced_chi_square
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::conclude::tests::fitted;
    use super::super::revise::tests::{base, options, passed, recorded, with};
    use super::*;
    use crate::bench_diagnosis::reality::part;
    use crate::fit::Correlation;
    use crate::tell::Silent;

    /// A refit that leaves `held_out_mm` of ten independent offsets.
    pub(in super::super) fn tried(id: &str, values: &[f64], held_out_mm: f64) -> Tried {
        let effect = effects::find(id).expect("in the registry");
        let structure = Structure::default().with(effect);
        let theta = [&[14.0, 0.3], values].concat();
        let left = ResidualSummary {
            rms_mm: held_out_mm,
            floor_mm: 1.0,
            floors: held_out_mm,
            rows: 100,
            effective_rows: 10.0,
            correlation: Correlation {
                in_time: 0.0,
                along_rope: 0.8,
                reduced_chi_square: held_out_mm * held_out_mm,
            },
        };
        let refit = Refit {
            ids: vec![id.into()],
            parameters: Vec::new(),
            theta: theta.clone(),
            cost: held_out_mm * held_out_mm,
            fit: left.clone(),
            held_out: left,
            gates: Vec::new(),
            passed: true,
        };
        let model = fitted(&structure, 1e-3 * held_out_mm);
        let fitted = FitResult {
            best: Evaluation { theta, ..model.best },
            ..model
        };
        Tried {
            refit,
            structure,
            cost: fitted.cost,
            fitted,
        }
    }

    /// Seen on the benchmark: a tilt was refused for its score alone, and a curl that left more was accepted.
    #[test]
    fn where_something_is_missing_the_likelier_cause_need_not_show_that_it_is() {
        let failing = |mut one: Tried, gates: &[&str]| {
            let gate = |name: &&str| Gate {
                name: (*name).to_owned(),
                passed: false,
                detail: String::new(),
            };
            one.refit.ask(gates.iter().map(gate).collect());
            one
        };
        let tilt = |mm: f64| tried("tilted_gravity", &[0.02, 0.0], mm);
        let passes_where = |only_numerical: bool, tilt: Tried, curl: Tried| {
            let mut both = [tilt, curl];
            excuse_likelier(&mut both, only_numerical);
            both.map(|one| one.refit.passed)
        };
        let passes = |tilt: Tried, curl: Tried| passes_where(false, tilt, curl);
        let curl = || tried("rest_curvature", &[0.0, -1.1], 1.33);
        let slight = |mm: f64| failing(tilt(mm), &["significant"]);
        assert_eq!(passes(slight(1.02), curl()), [true, true]);
        assert_eq!(passes(slight(1.4), curl()), [false, true], "it is not likelier");
        assert_eq!(
            passes(failing(tilt(1.02), &["significant", "physical value"]), curl()),
            [false, true]
        );
        assert_eq!(
            passes(slight(1.02), failing(curl(), &["significant"])),
            [false, false],
            "nothing may be missing"
        );
        let little = |mm: f64| failing(tilt(mm), &["explained share"]);
        assert_eq!(passes_where(true, little(1.02), curl()), [true, true]);
        assert_eq!(passes_where(false, little(1.02), curl()), [false, true]);
        assert_eq!(passes_where(true, little(1.4), curl()), [false, true]);
    }

    /// What ties is named beside the cause as what may be it: the finer grid has to bear it out as well.
    #[test]
    fn what_the_finer_grid_refuses_is_no_rival() {
        let demos = recorded(&[part("gripper_lag", 0.5)]);
        let options = options();
        let bench = Bench::new(&[&demos[0]], &[&demos[1]], &options).unwrap();
        let now = base(&bench);
        let [lag, offset] = ["gripper_lag", "clock_offset"].map(|id| KeptModel::of(&with(&bench, &[id])));
        let rivals = |share_of_it: f64| {
            let [lag, mut offset] = [&lag, &offset].map(|kept| kept.again(&bench).unwrap());
            offset.fitted.best.theta[2] *= share_of_it;
            let tried = Tried {
                refit: passed(&offset),
                structure: offset.structure,
                cost: offset.fitted.cost,
                fitted: offset.fitted,
            };
            let mut choice = Choice {
                accepted: Some((lag.structure.ids(), lag)),
                ..Choice::default()
            };
            choice.among(&bench, &now, vec![tried], &options, &Silent);
            choice.accepted.unwrap().1.rivals.len()
        };
        assert_eq!((rivals(0.3), rivals(1.0)), (0, 1));
    }

    /// Seen on a cable that is bent where it rests: a table that leans by 14 degrees left 4.03 mm, the curl 4.06.
    #[test]
    fn a_rig_that_nobody_would_have_set_up_so_is_no_cause_where_another_does_as_well() {
        let first = |of: [Tried; 2]| {
            let mut of = of;
            sort_by_likelihood(&mut of);
            of[0].refit.ids[0].clone()
        };
        let leans = |rad: f64, mm: f64| tried("tilted_gravity", &[rad, 0.0], mm);
        let curl = || tried("rest_curvature", &[0.0, -1.1], 4.06);
        assert_eq!(first([leans(0.24, 4.03), curl()]), "rest_curvature");
        assert_eq!(first([leans(0.02, 3.9), curl()]), "tilted_gravity");
        assert_eq!(
            first([leans(0.24, 1.0), curl()]),
            "tilted_gravity",
            "where nothing else explains it"
        );
    }
}
