//! Which refit of a round is the cause: the likeliest that passes every gate, the finer grid's last.

use super::gates::{
    Gate, MOST, excess_removed, pass_in_company, pass_overdone, refinement_gate, taken_away_mm,
};
use super::round::Refit;
use super::rounds::{Bench, LoopOptions, Part};
use crate::effects;
use crate::fit::{Evaluation, FitError, FitResult, estimates, fit_from};
use crate::model::Structure;
use crate::residual::ResidualSummary;
use nalgebra::DVector;

/// Standard deviation of how a rig was set up, in smallest sizes of interest: a table level to three degrees, cameras
/// placed to 5 mm and one and a half degrees.
pub(super) const CARE_SIZES: f64 = 5.0;

/// A refit with the model that it gave.
pub(super) type Tried = (Refit, Structure, FitResult);

/// A model and what it leaves.
pub(super) struct Standing {
    /// Its effects.
    pub(super) structure: Structure,
    /// Its fit.
    pub(super) fitted: FitResult,
    /// What it leaves where held out.
    pub(super) held: ResidualSummary,
    /// Effects that tie with its last one.
    pub(super) rivals: Vec<String>,
}

impl Standing {
    /// A fitted model, judged where held out.
    ///
    /// # Errors
    /// What is held out cannot be simulated.
    pub(super) fn of(bench: &Bench, structure: Structure, fitted: FitResult) -> Result<Self, FitError> {
        let held = bench.held_out.residuals(&structure, &fitted.best.theta)?;
        Ok(Self {
            held: ResidualSummary::of(&held),
            structure,
            fitted,
            rivals: Vec::new(),
        })
    }

    /// Name of the effect that came last.
    pub(super) fn last_effect(&self) -> Option<String> {
        self.structure.effects.last().map(|&e| effects::ALL[e].id.into())
    }
}

/// What a round came to.
pub(super) enum Found {
    /// A model with one more effect that passed every gate.
    Accepted(Box<Standing>),
    /// Models with one more effect that may be right in company of another that is missing, likelier first; none where
    /// there is nothing.
    OnTrial(Vec<Standing>),
}

/// What the refits of a round have come to so far.
#[derive(Default)]
pub(super) struct Choice {
    /// All of them, the likelier first of those that were judged together.
    pub(super) refits: Vec<Refit>,
    /// The winner and those that tie with it.
    accepted: Option<Standing>,
    /// The best of those that fail only because of what another cause that is missing beside them does.
    in_company: Option<Standing>,
    /// The best of those that take away most where fitted, but with a value beyond what is physical: it makes up for
    /// another cause, as a cable's end mass and stiffness do for its curl.
    overdone: Option<Standing>,
}

impl Choice {
    /// Whether there is a winner.
    pub(super) fn accepted(&self) -> bool {
        self.accepted.is_some()
    }

    /// All refits, and what they came to.
    pub(super) fn end(self) -> (Vec<Refit>, Found) {
        let found = match self.accepted {
            Some(winner) => Found::Accepted(Box::new(winner)),
            None => Found::OnTrial(self.in_company.into_iter().chain(self.overdone).collect()),
        };
        (self.refits, found)
    }

    /// Chooses among further refits of the model `now` where none was accepted before; the finer grid is tried on those
    /// that passed, likeliest first.
    pub(super) fn among(
        &mut self,
        bench: &Bench,
        now: &Standing,
        mut tried: Vec<Tried>,
        options: &LoopOptions,
        progress: &dyn Fn(&str),
    ) -> Result<(), FitError> {
        let refined = options.without != Some(Part::Refinement);
        let left = ResidualSummary::of(&now.fitted.best);
        sort_by_likelihood(&mut tried);
        for (mut refit, structure, fitted) in tried {
            if refined && !self.accepted() && refit.passed {
                progress(&format!("checking {} on a finer grid", refit.id));
                let gate = refine(bench, &structure, &fitted, &left)?;
                refit.passed &= gate.passed;
                refit.gates.push(gate);
            }
            let standing = Standing {
                structure,
                fitted,
                held: refit.held_out.clone(),
                rivals: Vec::new(),
            };
            self.consider(&refit, standing, &left);
            self.refits.push(refit);
        }
        Ok(())
    }

    /// Takes a model for the winner, for one that ties with it, or for one that may be right in company, if it is;
    /// `left` is what was left without it.
    fn consider(&mut self, refit: &Refit, model: Standing, left: &ResidualSummary) {
        let better = |best: &Option<Standing>, of: fn(&Standing) -> f64| {
            best.as_ref().is_none_or(|best| of(&model) < of(best))
        };
        if refit.passed {
            match &mut self.accepted {
                Some(best) if ties(&best.fitted, &model.fitted) => best.rivals.push(refit.id.clone()),
                Some(_) => {}
                None => self.accepted = Some(model),
            }
        } else if pass_in_company(&refit.gates) {
            // With another cause missing few offsets are independent, and the rig's care would decide alone.
            if better(&self.in_company, |model| model.held.rms_mm) {
                self.in_company = Some(model);
            }
        } else if pass_overdone(&refit.gates)
            && excess_removed(left, &refit.fit, 0.0) >= MOST
            && better(&self.overdone, |model| model.fitted.cost)
        {
            self.overdone = Some(model);
        }
    }
}

/// Sorts refits by what they leave where held out and by how far off somebody must have set up the rig for them, both as
/// logarithms of a likelihood. Where the data tell much, as nearly always, that is by the held-out error.
fn sort_by_likelihood(tried: &mut [Tried]) {
    let held = |t: &Tried| t.0.held_out.rms_mm;
    let Some(best) = tried.iter().min_by(|a, b| held(a).total_cmp(&held(b))) else {
        return;
    };
    // For all alike: what a better model leaves is less correlated, which is no merit of its offsets.
    let rows = best.0.held_out.effective_rows;
    let unlikely = |t: &Tried| rows * held(t).ln() + 0.5 * rig_off(&t.1, &t.2.best.theta);
    tried.sort_by(|a, b| unlikely(a).total_cmp(&unlikely(b)));
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

/// Two models tie when their sums of squares per independent offset differ by less than two standard
/// errors of such a sum.
pub(super) fn ties(best: &FitResult, other: &FitResult) -> bool {
    let reduced = |f: &FitResult| ResidualSummary::of(&f.best).correlation.reduced_chi_square;
    reduced(other) - reduced(best) < tie_spread(&best.best)
}

/// Difference of sums of squares per offset below which a model ties with the best.
pub(super) fn tie_spread(best: &Evaluation) -> f64 {
    let summary = ResidualSummary::of(best);
    2.0 * (2.0 / summary.effective_rows.max(1.0)).sqrt() * summary.correlation.reduced_chi_square
}

/// One Gauss-Newton step on the finer grid from the estimate on the fit's grid; `before` is what was left without the
/// effect.
fn refine(
    bench: &Bench,
    structure: &Structure,
    fitted: &FitResult,
    before: &ResidualSummary,
) -> Result<Gate, FitError> {
    let fine = fit_from(&bench.finer, structure, fitted.best.theta.clone(), 2)?;
    let effect = structure.effects[structure.effects.len() - 1];
    let spec = &effects::ALL[effect];
    let entries = structure.entries(effect);
    let own = fitted.best.jacobian.columns(entries.start, entries.len());
    let [coarse, fine] = [&fitted.best, &fine.best].map(|evaluation| {
        let own = evaluation.theta[entries.clone()].iter().zip(spec.parameters);
        DVector::from_iterator(entries.len(), own.map(|(t, p)| t - p.vanishes_at))
    });
    let errors: Vec<f64> = estimates(&fitted.best, structure)[entries]
        .iter()
        .map(|e| e.standard_error)
        .collect();
    let apart = own * (&fine - &coarse);
    let apart_mm = 1e3 * apart.norm() / (apart.len() as f64).sqrt();
    let explained_mm = taken_away_mm(before, &ResidualSummary::of(&fitted.best));
    Ok(refinement_gate(
        coarse.as_slice(),
        fine.as_slice(),
        &errors,
        [apart_mm, explained_mm],
    ))
}

#[cfg(test)]
mod tests {
    use super::super::conclude::tests::fitted;
    use super::*;
    use crate::fit::Correlation;

    /// A refit that leaves `held_out_mm` of ten independent offsets.
    fn tried(id: &str, values: &[f64], held_out_mm: f64) -> Tried {
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
            id: id.into(),
            parameters: Vec::new(),
            theta: theta.clone(),
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
        (refit, structure, fitted)
    }

    /// Seen on a cable that is bent where it rests: a table that leans by 14 degrees left 4.03 mm, the curl 4.06.
    #[test]
    fn a_rig_that_nobody_would_have_set_up_so_is_no_cause_where_another_does_as_well() {
        let first = |of: [Tried; 2]| {
            let mut of = of;
            sort_by_likelihood(&mut of);
            of[0].0.id.clone()
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

    /// Seen on a cable whose end mass and curl were both unknown: the mass alone went to the end of its range, took away
    /// three quarters of what was left, and was refused for its value.
    #[test]
    fn what_makes_up_for_another_cause_goes_along_where_nothing_else_does() {
        let mut choice = Choice::default();
        let left = tried("tip_mass", &[0.0], 40.0).0.fit;
        let mut consider = |id: &str, mm: f64, failed: &[&str]| {
            let (mut refit, structure, fitted) = tried(id, &[0.5], mm);
            refit.passed = false;
            refit.gates = failed
                .iter()
                .map(|name| Gate {
                    name: (*name).into(),
                    passed: false,
                    detail: String::new(),
                })
                .collect();
            let held = refit.held_out.clone();
            let model = Standing {
                structure,
                fitted,
                held,
                rivals: Vec::new(),
            };
            choice.consider(&refit, model, &left);
            let name = |model: &Option<Standing>| model.as_ref().and_then(Standing::last_effect);
            [&choice.in_company, &choice.overdone].map(name)
        };
        let [nothing, tip_mass, curl] = ["", "tip_mass", "rest_curvature"].map(|id| Some(id.to_owned()));
        let nothing = nothing.filter(|id| !id.is_empty());
        let beyond = &["physical value", "held-out gain"];
        let all = [
            (consider("density_gradient", 36.0, beyond), [&nothing, &nothing]),
            (consider("tip_mass", 19.0, beyond), [&nothing, &tip_mass]),
            (consider("air_drag", 22.0, beyond), [&nothing, &tip_mass]),
            (
                consider("yield", 15.0, &["grid refinement"]),
                [&nothing, &tip_mass],
            ),
            (
                consider("rest_curvature", 30.0, &["off nothing"]),
                [&curl, &tip_mass],
            ),
        ];
        for (got, wanted) in all {
            assert_eq!(got.each_ref(), wanted);
        }
        let Found::OnTrial(models) = choice.end().1 else {
            panic!("nothing passed");
        };
        let order: Vec<Option<String>> = models.iter().map(Standing::last_effect).collect();
        assert_eq!(order, [curl, tip_mass]);
    }
}
