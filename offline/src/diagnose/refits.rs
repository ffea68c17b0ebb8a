//! The full refits of a round, with one more effect or several: the likely ones first, the hopeless ones given up early.

use super::accounted::{NEARLY_ALL_HELD_OUT, excess_mm, explains};
use super::batch::{Batch, Failures, batches};
use super::bench::Bench;
use super::choice::{Standing, Tried};
use super::gates::{
    MOST, beyond_fewer, excess_removed, explain_their_share, given_up, most_of_the_same, smallest_share,
    statistical_gates,
};
use super::round::Refit;
use super::rounds::{LoopOptions, physical_effects};
use super::score::{ScoreTable, Subset, whitened_left};
use super::starts::{changed, told};
use crate::effects;
use crate::fit::{Budget, Descent, Evaluation, FitError, StopReason, estimates};
use crate::model::Structure;
use crate::residual::ResidualSummary;
use crate::tell::{Pieces, Tell};
use rayon::prelude::*;

/// Most evaluations of a refit: it starts from a one-step estimate.
pub(super) const REFIT_EVALUATIONS: usize = 24;
/// Evaluations after which a refit that has come less than half as far as the best is given up.
const HEAT_EVALUATIONS: usize = 8;
/// Cost over the least of its rivals at which a refit is given up.
pub(super) const HOPELESS: f64 = 2.0;
/// Cost over the least of its rivals up to which a refit whose evaluations are spent goes on beside the best.
const NEAR_THE_BEST: f64 = 1.5;
/// Evaluations after which only so many as a [`Batch`] says go on.
const SPRINT_EVALUATIONS: usize = 3;
/// Sizes of an effect, as multiples of the one-step estimate, at which a refit starts: the first that is better than
/// nothing. From a rope far off a one-step estimate overshoots, as far as to ropes that cannot be simulated. They are tried
/// where the model's own parameters change with the effect as its score says, a heavier tip being a stiffer rope, and where
/// they stay.
const FIRST_SIZES: [f64; 3] = [1.0, 0.25, 0.0625];
/// Most evaluations on the way from a refit's best to where the prior holds it, see [`Descent::shrunk`].
const SHRINK_EVALUATIONS: usize = 8;
/// Share of the cost which a refit took away that its prior leaves it on that way. On a real foam rod the damping that
/// took away a third of the misfit lost half of that.
const LEAST_KEPT: f64 = 0.9;

/// What all refits of a round have in common.
pub(super) struct Refits<'a> {
    pub(super) bench: &'a Bench<'a>,
    /// The model that lacks an effect.
    pub(super) now: &'a Standing,
    /// Its parameters where the data told them, and that they did; the prior's centres where they did not: what a model
    /// that lacks an effect makes of the rest, often a value at its bound, is a bad start for one that has it.
    told: Vec<(f64, bool)>,
    table: &'a ScoreTable,
    /// The likely effects, the others that are worth it, and those of slight score.
    batches: [Vec<Subset>; 3],
    options: &'a LoopOptions,
    /// Effects that these demonstrations could not be refitted with.
    pub(super) failures: Failures,
}

/// What a refit adds and the descent with it.
type Runner<'c, 'a> = (&'c Subset, Descent<'a>);

impl<'a> Refits<'a> {
    pub(super) fn new(
        bench: &'a Bench<'a>,
        now: &'a Standing,
        table: &'a ScoreTable,
        options: &'a LoopOptions,
    ) -> Self {
        let mut batches =
            batches(table, options.refits).map(|scores| scores.into_iter().map(Subset::from).collect());
        if !now.structure.effects.is_empty() {
            // A model that has an effect already is near enough for scores to be right about the others.
            batches[2] = Vec::new();
        }
        Self {
            bench,
            now,
            told: told(&now.fitted.best, &now.structure),
            table,
            batches,
            options,
            failures: Failures::default(),
        }
    }

    /// Refits the leading effects and, unless one that passes leaves nothing to explain, all others that are worth it:
    /// those that look like it to first order are among the first. The score holds to first order only: where the base
    /// model is far off, the cause may well be tenth. Where only such pass as leave something, so are those of slight score:
    /// a tilt was taken for a wind, whose slope at rest is next to nothing, and left an eighth of the excess.
    pub(super) fn leading(&self, progress: &dyn Tell) -> Vec<Tried> {
        let [first, others, slight] = &self.batches;
        if self.batches.iter().all(Vec::is_empty) {
            progress.say("refitting with nothing: no effect is significant");
        }
        let first = Batch {
            go_on: first.len(),
            ..Batch::of(first)
        };
        let explained = |tried: &[(&Subset, Tried)]| tried.iter().any(|(_, tried)| self.explained(tried));
        let beside = |candidates, tried: &[(&Subset, Tried)]| {
            let least = tried.iter().map(|t| t.1.cost).fold(f64::INFINITY, f64::min);
            let batch = Batch {
                least,
                ..Batch::of(candidates)
            };
            self.batch(&batch, progress)
        };
        let mut tried = self.batch(&first, progress);
        if !explained(&tried) {
            tried.extend(beside(others, &tried));
        }
        if tried.iter().any(|(_, tried)| tried.refit.passed) && !explained(&tried) {
            tried.extend(beside(slight, &tried));
        }
        self.followed(tried, &Batch::of(&[]), progress)
    }

    /// Refits the others alone, for where the finer grid refused what left nothing to them; none where they have had
    /// their refits.
    pub(super) fn others(&self, had: &[Refit], progress: &dyn Tell) -> Vec<Tried> {
        let others = self.batches[1].iter();
        let others: Vec<Subset> = others
            .filter(|candidate| had.iter().all(|refit| refit.ids != candidate.ids))
            .cloned()
            .collect();
        let others = Batch::of(&others);
        self.followed(self.batch(&others, progress), &others, progress)
    }

    /// Refits the effects of slight score, for where no other is accepted: damping that only a slope at zero makes strong
    /// had thirteen times the score of a density gradient of 0.8, the cause.
    pub(super) fn slight(&self, progress: &dyn Tell) -> Vec<Tried> {
        // What failed before is no measure of what is tried because it did.
        let slight = Batch::of(&self.batches[2]);
        let mut tried = self.batch(&slight, progress);
        self.restart_where_one_passed(&mut tried);
        self.followed(tried, &slight, progress)
    }

    /// Refits with the best subsets of so many effects, for where no effect passes alone: two causes can hide each other,
    /// as a cable's curl and the mass at its end do. What was refitted with fewer of them is where they may start.
    pub(super) fn together(&self, members: usize, had: &[Refit], progress: &dyn Tell) -> Vec<Tried> {
        let fits = |candidate: &&Subset| {
            candidate.ids.len() == members
                && physical_effects(&candidate.added_to(&self.now.structure)) <= self.options.max_effects
        };
        let subsets: Vec<Subset> = self.table.subsets.iter().filter(fits).cloned().collect();
        let together = Batch {
            had,
            ..Batch::of(&subsets)
        };
        self.followed(self.batch(&together, progress), &together, progress)
    }

    /// Refits side by side. None is followed that does not promise to come near the least cost of them and of what was
    /// tried before.
    fn batch<'c>(&self, batch: &Batch<'c>, progress: &dyn Tell) -> Vec<(&'c Subset, Tried)> {
        if batch.candidates.is_empty() {
            return Vec::new();
        }
        let names: Vec<String> = batch.candidates.iter().map(Subset::name).collect();
        progress.say(&format!("refitting with {}", names.join(", ")));
        let pieces = Pieces::of(progress, "refits", 3 * batch.candidates.len());
        let heats = self.heats(batch, &pieces);
        let costs = heats.iter().map(|heat| heat.1.cost());
        let batch = &Batch {
            least: costs.fold(batch.least, f64::min),
            ..*batch
        };
        let ended = heats.into_par_iter().map(|(candidate, descent)| {
            pieces.ended((candidate, self.to_the_end(candidate, descent, batch)))
        });
        let mut tried: Vec<(&Subset, Tried)> = self
            .best_to_rest(ended.collect(), batch)
            .into_par_iter()
            .filter_map(|(candidate, descent)| {
                let judged = pieces.ended(self.judge(candidate, descent, batch));
                Some((candidate, judged?))
            })
            .collect();
        if self.starts_are_far(batch) && !tried.iter().any(|(_, tried)| self.explained(tried)) {
            progress.say("none of them explains it: starting them elsewhere");
            let pieces = Pieces::of(progress, "refits", tried.len());
            tried.par_iter_mut().for_each(|(candidate, tried)| {
                let better = self.restart_elsewhere(candidate, tried.cost, batch);
                if let Some(better) = better.and_then(|descent| self.judge(candidate, descent, batch)) {
                    *tried = better;
                }
                pieces.ended(());
            });
        }
        tried
    }

    /// Whether refits may have started far from their best. A model that lacks a strong effect is far off in everything,
    /// and so is a one-step estimate from there; one that has an effect already is nearer, and several effects start where
    /// refits with fewer of them ended.
    fn starts_are_far(&self, batch: &Batch) -> bool {
        self.now.structure.effects.is_empty() && batch.had.is_empty()
    }

    /// Whether a refit passed and leaves nothing to explain: where it was fitted, and hardly anything where held out,
    /// because what looks like the cause in one motion does not in others.
    fn explained(&self, Tried { refit, fitted, .. }: &Tried) -> bool {
        let doubt = self.bench.slight_doubt(&fitted.best);
        let numerical_mm = self.table.discretisation_mm;
        refit.passed
            && explains(&self.now.left, fitted, doubt, numerical_mm)
            && excess_removed(&self.now.held, &refit.held_out, numerical_mm)
                .is_none_or(|share| share >= NEARLY_ALL_HELD_OUT)
    }

    /// Whether what the model leaves where fitted is no more than the simulation's own error.
    pub(super) fn only_numerical(&self) -> bool {
        let doubt = self.bench.doubt(&self.now.fitted.best);
        excess_mm(&self.now.left, doubt) <= self.table.discretisation_mm
    }

    /// Cost of which a refit has to promise to come near: a multiple of the least of its rivals, and one at which its effects
    /// explain a good part of what they must, together of what the model leaves, and the last of them of what a refit with
    /// fewer left. Half the share, because the cost of what lies far off grows with the distance, what is explained with
    /// its square.
    pub(super) fn worth(&self, candidate: &Subset, batch: &Batch) -> f64 {
        let now = &self.now.fitted;
        let noise = 0.5 * now.best.most_rows as f64;
        let explained =
            |cost: f64, effects| cost - 0.5 * smallest_share(effects, self.options) * (cost - noise).max(0.0);
        let worth = f64::min(HOPELESS * batch.least, explained(now.cost, candidate.ids.len()));
        batch
            .fewer(candidate)
            .map_or(worth, |fewer| worth.min(explained(fewer.cost, 1)))
    }

    /// The first evaluations of refits; where there are more than [`Batch::go_on`], the others do not get all of them.
    fn heats<'c>(&self, batch: &Batch<'c>, pieces: &Pieces) -> Vec<Runner<'c, 'a>> {
        let (candidates, go_on) = (batch.candidates, batch.go_on);
        let budget = |candidate: &Subset, evaluations| Budget {
            evaluations,
            worth: self.worth(candidate, batch),
        };
        let sprint = if candidates.len() > go_on {
            SPRINT_EVALUATIONS
        } else {
            HEAT_EVALUATIONS
        };
        let started = |candidate| {
            let descent = pieces.ended(self.started(candidate, batch, budget(candidate, sprint)));
            Some((candidate, self.failures.heard(candidate, descent)?))
        };
        let mut runners: Vec<Runner> = candidates.par_iter().filter_map(started).collect();
        if candidates.len() <= go_on {
            return runners;
        }
        runners.sort_by(|a, b| a.1.cost().total_cmp(&b.1.cost()));
        let behind = runners.split_off(go_on.min(runners.len()));
        let ahead = runners
            .into_par_iter()
            .map(|(candidate, descent)| (candidate, descent.run(budget(candidate, HEAT_EVALUATIONS))));
        let mut heats: Vec<Runner> = ahead.collect();
        heats.extend(behind);
        heats
    }

    /// The other evaluations of a refit, where there is hope that they find the least cost.
    pub(super) fn to_the_end(&self, candidate: &Subset, descent: Descent<'a>, batch: &Batch) -> Descent<'a> {
        if descent.cost() > HOPELESS * batch.least {
            return descent;
        }
        descent.run(Budget {
            evaluations: REFIT_EVALUATIONS,
            worth: self.worth(candidate, batch),
        })
    }

    /// The best of some refits, and those that may still come as far, go on with as many evaluations again: along the
    /// narrow valley of stiffness and yield a descent takes thirty, and what it has not yet come to looks as if the effect
    /// did not explain it.
    fn best_to_rest<'c>(&self, descents: Vec<Runner<'c, 'a>>, batch: &Batch) -> Vec<Runner<'c, 'a>> {
        let costs = descents.iter().map(|runner| runner.1.cost());
        let near = NEAR_THE_BEST * costs.fold(f64::INFINITY, f64::min);
        let to_rest = |(candidate, descent): Runner<'c, 'a>| {
            if descent.cost() > near {
                return (candidate, descent);
            }
            let budget = Budget {
                evaluations: 2 * REFIT_EVALUATIONS,
                worth: self.worth(candidate, batch),
            };
            (candidate, descent.run(budget))
        };
        descents.into_par_iter().map(to_rest).collect()
    }

    /// The very first evaluations of a refit, from the one-step estimate, or nearer to nothing where that is worse than
    /// nothing; at worst from the model as it stands. Where some of its effects had refits without the others, at worst
    /// from the best of these: two that hide each other are far from where either is better than nothing.
    fn started(&self, candidate: &Subset, batch: &Batch, budget: Budget) -> Result<Descent<'a>, FitError> {
        let with_own = FIRST_SIZES.map(|size| candidate.start(&self.own(candidate, size), size));
        let alone = FIRST_SIZES.map(|size| candidate.start(&self.own(candidate, 0.0), size));
        let now = &self.now.fitted;
        let (at_worst, enough) = match batch.fewer(candidate) {
            Some(fewer) => (candidate.beyond(fewer, &self.now.structure), fewer.cost),
            None => (candidate.nothing(&now.best.theta), now.cost),
        };
        let starts = with_own.into_iter().chain(alone).chain([at_worst]);
        let next = candidate.added_to(&self.now.structure);
        let start = Descent::at_first(&self.bench.fit, &next, starts, enough)?;
        Ok(start.run(budget))
    }

    /// The model's own parameters where a refit starts, changed so many times as much as a candidate's score says.
    pub(super) fn own(&self, candidate: &Subset, times: f64) -> Vec<f64> {
        changed(
            &self.told,
            &self.now.structure.parameters(),
            &candidate.own_change,
            times,
        )
    }

    /// A refit with what another model, of effects `known`, was extended by, from the sizes that this has in the refit there.
    pub(super) fn like(&self, candidate: &Subset, refit: &Refit, known: &Structure) -> Option<Tried> {
        let next = candidate.added_to(&self.now.structure);
        let had = &refit.theta[known.parameters().len()..];
        let own = &self.now.fitted.best.theta;
        let starts = [[own, had].concat(), candidate.nothing(own)];
        let start = Descent::at_first(&self.bench.fit, &next, starts, self.now.fitted.cost).ok()?;
        self.judge(candidate, start.run(2 * REFIT_EVALUATIONS), &Batch::of(&[]))
    }

    /// Whether a refit explains as much of the excess where fitted as the gates ask for.
    fn explains_its_share(&self, candidate: &Subset, descent: &Descent, batch: &Batch) -> bool {
        let left = ResidualSummary::of(descent.best());
        explain_their_share(candidate.ids.len(), [&self.now.left, &left], self.options)
            && batch
                .fewer(candidate)
                .is_none_or(|fewer| beyond_fewer(fewer, &left, self.options).passed)
    }

    /// Cost up to which a refit that came to `cost` may be held by its prior.
    fn most_cost(&self, cost: f64) -> f64 {
        cost + (1.0 - LEAST_KEPT) * (self.now.fitted.cost - cost).max(0.0)
    }

    /// What a refit takes away in the measure of the scores: the cameras are free where they are in its effects' scores.
    fn taken_away(&self, candidate: &Subset, (best, structure): (&Evaluation, &Structure)) -> f64 {
        let of_cameras = candidate.effects().any(|effect| effects::ALL[effect].nuisance);
        let nuisances = !of_cameras && self.options.nuisances();
        let left = |evaluation, structure| whitened_left(evaluation, structure, &self.bench.noise, nuisances);
        left(&self.now.fitted.best, &self.now.structure) - left(best, structure)
    }

    /// What became of a refit; nothing where what is held out cannot be simulated with it.
    pub(super) fn judge(&self, candidate: &Subset, descent: Descent, batch: &Batch) -> Option<Tried> {
        let cost = descent.cost();
        // Where the prior holds it, a refit explains no more than here.
        let fitted =
            if descent.has_had(REFIT_EVALUATIONS) && self.explains_its_share(candidate, &descent, batch) {
                descent.shrunk(SHRINK_EVALUATIONS, self.most_cost(cost)).finish()
            } else {
                descent.finish()
            };
        let next = candidate.added_to(&self.now.structure);
        let held_out = self.bench.held_out.residuals(&next, &fitted.best.theta);
        let held_out = self.failures.heard(candidate, held_out)?;
        let mut refit = Refit {
            ids: candidate.ids.clone(),
            parameters: estimates(&fitted.best, &next).split_off(self.told.len()),
            theta: fitted.best.theta.clone(),
            cost: fitted.cost,
            fit: ResidualSummary::of(&fitted.best),
            held_out: ResidualSummary::of(&held_out),
            gates: Vec::new(),
            passed: false,
        };
        let entries = |effect| self.bench.fit.free_entries(&next, &fitted.best, effect);
        let free = candidate.effects().map(entries).sum();
        refit.gates = statistical_gates(
            candidate,
            (&self.now.left, &self.now.held),
            (&refit, free, self.taken_away(candidate, (&fitted.best, &next))),
            self.options,
        );
        if let Some(fewer) = batch.fewer(candidate) {
            refit.gates.push(beyond_fewer(fewer, &refit.fit, self.options));
        }
        if self.bench.judges_itself() && self.only_numerical() {
            // Doubt about the noise may be all that makes it so.
            let surely = excess_mm(&self.now.left, 0.0) <= self.table.discretisation_mm;
            let asked = if surely { NEARLY_ALL_HELD_OUT } else { MOST };
            let gate = most_of_the_same(&self.now.held, &refit.held_out, asked);
            refit.gates.push(gate);
        }
        if fitted.stop == StopReason::GivenUp {
            refit.gates.insert(0, given_up(fitted.evaluations));
        }
        refit.passed = refit.gates.iter().all(|g| g.passed);
        Some(Tried {
            refit,
            structure: next,
            fitted,
            cost,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::revise::tests::{YOUNG_PA, base, options, recorded};
    use super::super::score::Score;
    use super::*;
    use crate::bench_diagnosis::reality::part;
    use crate::effects;
    use crate::tell::Silent;

    /// Seen on the benchmark: a tilt was accepted for a wind of slight score, which was not refitted.
    #[test]
    fn effects_of_slight_score_are_refitted_where_what_passed_leaves_something() {
        let options = options();
        let refitted = |cause: &str| {
            let demos = recorded(&[part(cause, 8.0)]);
            let bench = Bench::new(&[&demos[0]], &[&demos[1]], &options).unwrap();
            let now = base(&bench);
            let score = |id: &str, statistic: f64| Score {
                estimate: part(id, 4.0).values,
                ..Score::alone(id, statistic, 6.0)
            };
            let table = ScoreTable::of(vec![score("tilted_gravity", 1000.0), score("steady_wind", 50.0)]);
            let tried = Refits::new(&bench, &now, &table, &options).leading(&Silent);
            let left = tried
                .into_iter()
                .map(|t| (t.refit.ids[0].clone(), t.refit.passed, t.refit.held_out.rms_mm));
            left.collect::<Vec<_>>()
        };
        let [(_, tilt_passed, tilt_mm), (wind, wind_passed, wind_mm)] = &refitted("steady_wind")[..] else {
            panic!("both are refitted");
        };
        assert!(wind == "steady_wind" && *tilt_passed && *wind_passed);
        assert!(wind_mm < tilt_mm, "{wind_mm} and {tilt_mm} mm");
        assert_eq!(refitted("tilted_gravity").len(), 1, "a tilt leaves nothing");
    }

    /// What is not worth following: what explains far too little, two effects that explain what one may, or hardly more than
    /// one of them did, and what leaves twice as much as a rival.
    #[test]
    fn a_refit_is_followed_towards_a_good_part_of_the_share_that_it_must_explain() {
        let demos = recorded(&[part("tilted_gravity", 8.0)]);
        let options = options();
        let bench = Bench::new(&[&demos[0]], &[&demos[1]], &options).unwrap();
        let now = base(&bench);
        let table = ScoreTable::of(Vec::new());
        let refits = Refits::new(&bench, &now, &table, &options);
        let one = Subset::from(&Score::alone("tilted_gravity", 60.0, 80.0));
        let two = Subset {
            ids: ["tip_mass", "air_drag"].map(String::from).into(),
            ..Subset::from(&Score::alone("tip_mass", 60.0, 80.0))
        };
        let noise = 0.5 * now.fitted.best.most_rows as f64;
        let excess = |cost: f64| (now.fitted.cost - cost) / (now.fitted.cost - noise);
        let none = Batch::of(&[]);
        let [alone, together] = [&one, &two].map(|candidate| excess(refits.worth(candidate, &none)));
        assert!(0.1 < alone && alone < options.smallest_share, "{alone}");
        assert!(alone < together && together < 0.5, "{together}");
        let rival = Batch {
            least: 0.3 * now.fitted.cost,
            ..none
        };
        assert_eq!(refits.worth(&one, &rival), HOPELESS * rival.least);
        let left = 0.5 * (now.fitted.cost + noise);
        let mass = Subset::from(&Score::alone("tip_mass", 60.0, 80.0));
        let nothing = mass.nothing(&now.fitted.best.theta);
        let there = Descent::at(&bench.fit, &mass.added_to(&now.structure), &nothing).unwrap();
        let mass = Refit {
            cost: left,
            ..refits.judge(&mass, there, &none).unwrap().refit
        };
        let after_mass = Batch {
            had: std::slice::from_ref(&mass),
            ..Batch::of(&[])
        };
        let of_the_rest = (left - refits.worth(&two, &after_mass)) / (left - noise);
        assert!(
            0.1 < of_the_rest && of_the_rest < options.smallest_share,
            "{of_the_rest}"
        );
    }

    /// A rope in a tilted rig with drag in the tilt's place goes to the end of drag's range; what is left hangs together so
    /// much that it tells nothing of drag. Where the tilt is fitted, noise is left and nothing changes.
    #[test]
    fn what_correlated_offsets_hardly_tell_the_prior_holds() {
        let tilt = part("tilted_gravity", 8.0);
        let demos = recorded(std::slice::from_ref(&tilt));
        let bench = Bench::new(&[&demos[0]], &[&demos[1]], &options()).unwrap();
        let ends = |id: &str, values: &[f64]| {
            let structure = Structure::default().with(effects::find(id).unwrap());
            let theta = [&[YOUNG_PA.ln(), 0.3], values].concat();
            let end = Descent::at(&bench.fit, &structure, &theta)
                .unwrap()
                .run(REFIT_EVALUATIONS);
            let free = end.best().theta[2];
            let held = end.shrunk(SHRINK_EVALUATIONS, f64::INFINITY);
            [free, held.best().theta[2]]
        };
        let [free, held] = ends("air_drag", &[0.1; 3]);
        assert!(held < 0.5 * free, "{free} {held}");
        let [free, held] = ends("tilted_gravity", &tilt.values);
        assert!((held / free - 1.0).abs() < 0.01, "{free} {held}");
    }

    /// Seen on a foam rod whose clamp held it askew, which nobody knew: its damping explained much, and a prior as heavy as
    /// what was left took half of that away. Here a lag is what is missing beside it.
    #[test]
    fn a_prior_takes_no_more_than_it_may_of_what_a_refit_explained() {
        let demos = recorded(&[part("internal_damping", 60.0), part("gripper_lag", 7.0)]);
        let bench = Bench::new(&[&demos[0]], &[&demos[1]], &options()).unwrap();
        let structure = Structure::default().with(effects::find("internal_damping").unwrap());
        let end = Descent::at(&bench.fit, &structure, &[YOUNG_PA.ln(), 0.3, 0.11])
            .unwrap()
            .run(10);
        let shrunk = |most_cost: f64| {
            let fit = end.clone().shrunk(SHRINK_EVALUATIONS, most_cost).finish();
            (fit.best.theta[2], fit.cost)
        };
        let (free_s, heaviest) = (end.best().theta[2], shrunk(f64::INFINITY));
        assert!(heaviest.0 < 0.8 * free_s, "{heaviest:?} of {free_s} s");
        let most = 0.5 * (end.cost() + heaviest.1);
        let kept = shrunk(most);
        assert!(kept.1 <= most, "{kept:?}, at most {most}");
        assert!(heaviest.0 < kept.0 && kept.0 < free_s, "{kept:?} of {free_s} s");
    }
}
