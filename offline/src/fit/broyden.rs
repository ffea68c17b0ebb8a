//! Slopes at no cost: what a step turned out to do corrects the slopes along it, and leaves the others
//! (Broyden 1965, "A class of methods for solving nonlinear simultaneous equations"; Madsen, Nielsen and Tingleff
//! 2004, section 3.5). The points of the rope are corrected, not the offsets: which of those are measured changes from
//! step to step.

use super::passes::only_seen;
use super::problem::{Evaluation, FitError, Problem};
use super::sensitivity::{Frames, Trace};
use crate::model::Structure;
use rayon::prelude::*;

/// Residual and slopes at one θ, with the predictions that they are of.
#[derive(Clone)]
pub(super) struct Traced {
    /// Residual and Jacobian.
    pub(super) evaluation: Evaluation,
    traces: Vec<Trace>,
}

impl Problem<'_> {
    /// Residual and slopes of a problem that is settled at θ, from tangents; columns of entries that are held are zero.
    ///
    /// # Errors
    /// A simulation stopped, or too little was measured.
    pub(super) fn traced(
        &self,
        structure: &Structure,
        theta: &[f64],
        held: &[bool],
    ) -> Result<Traced, FitError> {
        self.with_evaluation(structure, theta, self.traces(structure, theta, held)?)
    }

    /// The same with a column for every entry whose slope is a number; the others are zero.
    ///
    /// # Errors
    /// θ cannot be simulated, or too little was measured.
    pub(super) fn traced_what_runs(&self, structure: &Structure, theta: &[f64]) -> Result<Traced, FitError> {
        let (traces, _) = self.traces_that_run(structure, theta, &vec![false; theta.len()])?;
        self.with_evaluation(structure, theta, traces)
    }

    /// Residual at θ, with the slopes of another θ as the step from there corrects them. `curvature` is the cost's along
    /// each entry of θ: it makes entries of different units alike.
    ///
    /// # Errors
    /// A simulation stopped, or too little was measured.
    pub(super) fn corrected(
        &self,
        structure: &Structure,
        before: &Traced,
        (theta, held): (&[f64], &[bool]),
        curvature: impl Iterator<Item = f64>,
    ) -> Result<Traced, FitError> {
        let from = &before.evaluation.theta;
        let step: Vec<f64> = theta.iter().zip(from).map(|(to, from)| to - from).collect();
        let weighted: Vec<f64> = step.iter().zip(curvature).map(|(s, c)| s * c).collect();
        let length: f64 = step.iter().zip(&weighted).map(|(s, w)| s * w).sum();
        let share: Vec<f64> = weighted
            .iter()
            .map(|w| w / length.max(f64::MIN_POSITIVE))
            .collect();
        let seen = only_seen(structure, theta, held);
        let one = |(demo, before): (usize, &Trace)| {
            let prediction = self.prediction(demo, structure, theta)?;
            let mut slopes = corrected_slopes(before, &prediction.frames, (&step, &share));
            for (column, frames) in self.seen_slopes(demo, (structure, theta), &seen, &prediction) {
                slopes[column] = frames;
            }
            Ok(Trace { prediction, slopes })
        };
        let traces = before.traces.par_iter().enumerate().map(one);
        self.with_evaluation(structure, theta, traces.collect::<Result<_, FitError>>()?)
    }

    fn with_evaluation(
        &self,
        structure: &Structure,
        theta: &[f64],
        traces: Vec<Trace>,
    ) -> Result<Traced, FitError> {
        Ok(Traced {
            evaluation: self.evaluation(structure, theta, &traces)?,
            traces,
        })
    }
}

/// Slopes a step away from where they were known: what the step did beyond what they foretold is shared among the entries
/// of θ.
fn corrected_slopes(before: &Trace, after: &Frames, (step, share): (&[f64], &[f64])) -> Vec<Frames> {
    let mut slopes = before.slopes.clone();
    let known: Vec<usize> = (0..step.len()).filter(|&k| !slopes[k].is_empty()).collect();
    for (frame, (to, from)) in after.iter().zip(&before.prediction.frames).enumerate() {
        for (place, (to, from)) in to.iter().zip(from).enumerate() {
            for axis in 0..3 {
                let foretold: f64 = known
                    .iter()
                    .map(|&k| step[k] * slopes[k][frame][place][axis])
                    .sum();
                let beyond = to[axis] - from[axis] - foretold;
                for &k in &known {
                    slopes[k][frame][place][axis] += beyond * share[k];
                }
            }
        }
    }
    slopes
}

#[cfg(test)]
mod tests {
    use super::super::sensitivity::Prediction;
    use super::*;

    /// One point that moves as 2 a + a b along x, between (1, 1) and (1.5, 1.25).
    #[test]
    fn corrected_slopes_foretell_the_step_that_was_made_and_leave_what_is_held() {
        let at = |a: f64, b: f64| vec![vec![[2.0 * a + a * b, 0.0, 0.0]]];
        let slope = |x: f64| vec![vec![[x, 0.0, 0.0]]];
        let before = Trace {
            prediction: Prediction {
                arc_m: vec![0.0],
                frames: at(1.0, 1.0),
                particles: Vec::new(),
                tracks: Vec::new(),
            },
            slopes: vec![slope(3.0), slope(1.0), Vec::new()],
        };
        let step = [0.5, 0.25, 0.0];
        let length: f64 = step.iter().map(|s| s * s).sum();
        let share = step.map(|s| s / length);
        let slopes = corrected_slopes(&before, &at(1.5, 1.25), (&step, &share));
        let along = |k: usize| slopes[k][0][0][0];
        assert!((along(0) * step[0] + along(1) * step[1] - (at(1.5, 1.25)[0][0][0] - 3.0)).abs() < 1e-12);
        // Across the step nothing was learnt.
        assert!((along(0) * step[1] - along(1) * step[0] - (3.0 * step[1] - step[0])).abs() < 1e-12);
        assert!(slopes[2].is_empty());
    }
}
