//! What a loop works on: the problems where it fits and where it judges, refined to the predictions of a finer grid near
//! the model in hand, and the noise that it measured.

use super::accounted::HeldOut;
use super::noise::Noise;
use super::rounds::{LoopOptions, Part};
use super::score::{Invariance, invariances};
use crate::demo::Demo;
use crate::fit::{
    Descent, Evaluation, FitError, FitResult, FrameShare, Problem, Resolution, covariance, fit_from, shift_by,
};
use crate::model::Structure;
use crate::residual::ResidualSummary;
use nalgebra::DVector;

/// Most evaluations of a fit that follows to where the finer grid has it: near by.
const FOLLOWING_EVALUATIONS: usize = 8;

/// The problems where a loop fits and where it judges: other demonstrations where there are any, else
/// a part of the same ([`FrameShare::HeldOut`]).
///
/// # Errors
/// A demonstration cannot be simulated.
pub fn problems<'a>(
    demos: &[&'a Demo],
    held_out: &[&'a Demo],
    options: &LoopOptions,
) -> Result<(Problem<'a>, Problem<'a>), FitError> {
    let all = Problem::new(demos, options.resolution)?;
    if held_out.is_empty() {
        let judge = all.clone().of_share(FrameShare::HeldOut);
        return Ok((all.of_share(FrameShare::Fitted), judge));
    }
    Ok((all, Problem::new(held_out, options.resolution)?))
}

/// The same with the noise that a loop measured, and refined at a model that it came to.
///
/// # Errors
/// A demonstration cannot be simulated.
pub fn problems_at<'a>(
    (demos, held_out): (&[&'a Demo], &[&'a Demo]),
    options: &LoopOptions,
    noise_scale: f64,
    (structure, theta): (&Structure, &[f64]),
) -> Result<(Problem<'a>, Problem<'a>), FitError> {
    let mut bench = Bench::new(demos, held_out, options)?;
    bench.set_scale(noise_scale);
    let Bench { fit, held_out, .. } = bench.refined(structure, theta)?;
    Ok((fit, held_out))
}

/// What the loop works on.
#[derive(Clone)]
pub(super) struct Bench<'a> {
    pub(super) fit: Problem<'a>,
    pub(super) held_out: Problem<'a>,
    /// What is fitted, on the finer grid.
    pub(super) finer: Problem<'a>,
    /// To whose predictions the others are refined.
    finer_grid: Resolution,
    /// Whether the simulation's own error is asked for.
    compares_grids: bool,
    pub(super) noise: Noise,
}

impl<'a> Bench<'a> {
    pub(super) fn new(
        demos: &[&'a Demo],
        held_out: &[&'a Demo],
        options: &LoopOptions,
    ) -> Result<Self, FitError> {
        let (fit, held_out) = problems(demos, held_out, options)?;
        Ok(Self {
            finer: fit.on(options.finer),
            finer_grid: options.finer,
            fit,
            held_out,
            noise: Noise::DECLARED,
            compares_grids: options.without != Some(Part::Refinement),
        })
    }

    /// The same with the finer grid's predictions of models near one at θ. Where what is held out cannot be had on it, that
    /// keeps its own grid's.
    ///
    /// # Errors
    /// What is fitted cannot be simulated.
    pub(super) fn refined(&self, structure: &Structure, theta: &[f64]) -> Result<Self, FitError> {
        if !self.compares_grids {
            return Ok(self.clone());
        }
        let held_out = || self.held_out.refined(self.finer_grid, structure, theta);
        let fit = || self.fit.refined(self.finer_grid, structure, theta);
        let (fit, held_out) = if self.judges_itself() {
            let held_out = held_out();
            let same = |whole: &Problem| Ok(self.fit.refined_as(whole));
            (held_out.as_ref().map_or_else(|_| fit(), same), held_out)
        } else {
            rayon::join(fit, held_out)
        };
        Ok(Self {
            fit: fit?,
            held_out: held_out.unwrap_or_else(|_| self.held_out.unrefined()),
            ..self.clone()
        })
    }

    /// The same with the predictions of its own grid.
    pub(super) fn unrefined(&self) -> Self {
        Self {
            fit: self.fit.unrefined(),
            held_out: self.held_out.unrefined(),
            ..self.clone()
        }
    }

    /// What is fitted, on a grid that is as much finer than the finer one as that is than the fit's.
    pub(super) fn finest(&self) -> Problem<'a> {
        self.finer.on(self.finer_grid.finer())
    }

    /// As [`Noise::slight_doubt`] says of what a fit leaves.
    pub(super) fn slight_doubt(&self, evaluation: &Evaluation) -> f64 {
        self.noise.slight_doubt(evaluation.len())
    }

    /// As [`Noise::doubt`] says of what a fit leaves.
    pub(super) fn doubt(&self, evaluation: &Evaluation) -> f64 {
        self.noise.doubt(evaluation.len())
    }

    /// What base and final model leave where held out.
    pub(super) fn where_held_out(
        &self,
        [before, after]: [&Evaluation; 2],
        (structure, fitted): (&Structure, &FitResult),
    ) -> HeldOut {
        // Where slopes or the finer grid cannot be had, neither excuses anything.
        let [numerical_mm, uncertain_mm] = self.excused_mm(structure, fitted).unwrap_or_default();
        HeldOut {
            before: ResidualSummary::of(before),
            after: ResidualSummary::of(after),
            doubt: self.doubt(after),
            numerical_mm,
            uncertain_mm,
            of_the_same: self.judges_itself(),
        }
    }

    /// Whether parts of what is fitted judge, and no other recording.
    pub(super) fn judges_itself(&self) -> bool {
        self.fit.frames != FrameShare::All
    }

    /// Root mean squares of what a right model may leave where held out, mm: of the simulation's own error there, without
    /// what its parameters, which follow that error where they are fitted, make of it there; and of what their standard errors
    /// let expect, g Σ gᵀ over the slopes g of all offsets.
    fn excused_mm(&self, structure: &Structure, fitted: &FitResult) -> Result<[f64; 2], FitError> {
        let theta = &fitted.best.theta;
        let there = self.held_out.evaluate(structure, theta)?;
        let spread = &there.jacobian * covariance(&fitted.best, structure);
        let mean = spread.component_mul(&there.jacobian).sum() / there.len() as f64;
        let followed = shift_by(&fitted.best, structure, &self.fit.grid_errors(&fitted.best));
        let made_of_it = there.whitened_jacobian() * DVector::from_vec(followed);
        let numerical_mm = 1e3 * there.rms_of_m(&(self.held_out.grid_errors(&there) - made_of_it));
        Ok([
            // Where it is not known what they follow, nothing is excused.
            if numerical_mm.is_finite() {
                numerical_mm
            } else {
                0.0
            },
            1e3 * mean.max(0.0).sqrt(),
        ])
    }

    /// How the effects of a fit fare in parts of what was fitted. None where the finer grid cannot be had: what the
    /// simulation's own error makes of them is not known then.
    pub(super) fn invariances(
        &self,
        (best, structure): (&Evaluation, &Structure),
        options: &LoopOptions,
    ) -> Vec<Invariance> {
        let unknown = self.compares_grids && !self.fit.is_refined();
        if structure.effects.is_empty() || unknown {
            return Vec::new();
        }
        let errors = self.fit.grid_errors(best);
        invariances(
            (best, structure),
            &self.noise,
            &errors,
            options.nuisances(),
            options.seed,
        )
    }

    /// Every model is sought near the base model's best, where ropes hang.
    pub(super) fn settle(&mut self, theta: &[f64]) -> Result<(), FitError> {
        let base = Structure::default();
        self.fit = self.fit.settled(&base, theta)?;
        for other in [&mut self.held_out, &mut self.finer] {
            *other = other.settled_near(&self.fit, &base, theta)?;
        }
        Ok(())
    }

    pub(super) fn set_scale(&mut self, noise_scale: f64) {
        for problem in [&mut self.fit, &mut self.held_out, &mut self.finer] {
            problem.noise_scale = noise_scale;
        }
    }

    pub(super) fn set_noise(&mut self, noise: Noise, options: &LoopOptions) {
        self.set_scale(noise.scale);
        self.noise = if options.without == Some(Part::Whitening) {
            noise.as_if_independent()
        } else {
            noise
        };
    }

    /// The evaluation at a known optimum, with the noise as it is set now.
    pub(super) fn again(&self, structure: &Structure, theta: &[f64]) -> Result<FitResult, FitError> {
        fit_from(&self.fit, structure, theta.to_vec(), 1)
    }

    /// A fit followed to where the finer grid has it, and the bench refined there.
    ///
    /// # Errors
    /// The model cannot be simulated.
    pub(super) fn followed(
        &self,
        structure: &Structure,
        fitted: &FitResult,
    ) -> Result<(Self, FitResult), FitError> {
        let here = self.refined(structure, &fitted.best.theta)?;
        let start = Descent::at(&here.fit, structure, &fitted.best.theta)?;
        let there = start
            .under(fitted.prior_weight)
            .run(FOLLOWING_EVALUATIONS)
            .finish();
        let here = self.refined(structure, &there.best.theta)?;
        let again = here.again(structure, &there.best.theta)?;
        let fitted = FitResult {
            stop: there.stop,
            evaluations: fitted.evaluations + there.evaluations,
            prior_weight: fitted.prior_weight,
            ends: fitted.ends.clone(),
            ..again
        };
        Ok((here, fitted))
    }
}

#[cfg(test)]
mod tests {
    use super::super::revise::tests::{YOUNG_PA, options};
    use super::*;
    use crate::bench_diagnosis::experiment::MOTIONS;
    use crate::bench_diagnosis::reality::{Finer, Reality};

    /// A rope that lacks nothing, on a grid finer than both, without noise. What follows the finer grid leaves less where
    /// fitted and where held out, and stays where it is followed to.
    #[test]
    fn a_fit_that_follows_the_finer_grid_leaves_less_and_stays() {
        let tracks = Finer.rough_tracks(YOUNG_PA, &[], &MOTIONS[..2]).unwrap();
        let demos = [0, 1].map(|i: usize| MOTIONS[i].demo(&tracks[i], 0.0, 0));
        let bench = Bench::new(&[&demos[0]], &[&demos[1]], &options()).unwrap();
        let structure = Structure::default();
        let own = fit_from(&bench.fit, &structure, structure.start(YOUNG_PA), 12).unwrap();
        let (here, followed) = bench.followed(&structure, &own).unwrap();
        let (_, again) = here.followed(&structure, &followed).unwrap();
        let left_m = |bench: &Bench, fit: &FitResult| {
            let held_out = bench.held_out.residuals(&structure, &fit.best.theta).unwrap();
            [fit.best.rms_m(), held_out.rms_m()]
        };
        let [before_m, after_m] = [left_m(&bench, &own), left_m(&here, &followed)];
        assert!(
            after_m[0] < before_m[0] && after_m[1] < before_m[1],
            "{before_m:?} {after_m:?}"
        );
        let young = |fit: &FitResult| fit.best.theta[0];
        let [moved, more] = [young(&followed) - young(&own), young(&again) - young(&followed)];
        assert!(more.abs() < 0.1 * moved.abs(), "{moved} {more}");
    }
}
