//! One step of a descent: how far it goes under a damping, where it leads, and whether it is small.

use super::uncertainty::YOUNG;
use crate::model::ParameterInfo;
use nalgebra::{DMatrix, DVector};

/// A step smaller than this share of every standard error is small.
pub(super) const STEP_TOLERANCE: f64 = 0.1;

/// How ln E changes by a step that changes E itself by so large a share of it, be that more than all of it. Loads and
/// stiffness grow in proportion: a rope with more to carry is stiffer, one that bends so much more stiffly than it stretches
/// softer. To first order it is the same.
fn stiffness_change(share: f64) -> f64 {
    share.signum() * share.abs().ln_1p()
}

/// θ after a step, inside its bounds. Where it is one with an effect the stiffness goes in proportion, as loads do: along
/// the valley of a bending ratio, where E falls as it grows, the line along its slope leaves the valley by 2 mm where the
/// ratio is 1.3, and this by nothing.
pub fn moved(
    theta: &[f64],
    step: impl Iterator<Item = f64>,
    info: &[ParameterInfo],
    with_effect: bool,
) -> Vec<f64> {
    let entries = theta.iter().zip(step).zip(info).enumerate();
    entries
        .map(|(k, ((&value, change), p))| {
            let change = if k == YOUNG && with_effect {
                stiffness_change(change)
            } else {
                change
            };
            // value + (end - value) may lie beyond the end by a rounding.
            (value + change).clamp(p.low, p.high)
        })
        .collect()
}

/// The damped Newton step inside the box, without the entries that are held. Entries that would leave it are put
/// on the bound and the others solved again.
pub(super) fn damped_step(
    (hessian, gradient): (&DMatrix<f64>, &DVector<f64>),
    damping: f64,
    (theta, held): (&[f64], &[bool]),
    info: &[ParameterInfo],
) -> DVector<f64> {
    let n = theta.len();
    let mut fixed: Vec<Option<f64>> = held.iter().map(|held| held.then_some(0.0)).collect();
    loop {
        let mut a = hessian.clone();
        let mut b = -gradient.clone();
        for k in 0..n {
            a[(k, k)] *= 1.0 + damping;
        }
        for k in 0..n {
            if let Some(value) = fixed[k] {
                for i in 0..n {
                    b[i] -= hessian[(i, k)] * value;
                    a[(i, k)] = 0.0;
                    a[(k, i)] = 0.0;
                }
            }
        }
        for k in 0..n {
            if let Some(value) = fixed[k] {
                a[(k, k)] = 1.0;
                b[k] = value;
            }
        }
        let Some(factor) = a.cholesky() else {
            return DVector::zeros(n);
        };
        let step = factor.solve(&b);
        let mut clean = true;
        for k in 0..n {
            let allowed = step[k].clamp(info[k].low - theta[k], info[k].high - theta[k]);
            if fixed[k].is_none() && allowed != step[k] {
                fixed[k] = Some(allowed);
                clean = false;
            }
        }
        if clean {
            return step;
        }
    }
}

/// Whether a step is small against standard errors that grow with the misfit: where the model lacks
/// an effect, the place of the minimum is uncertain by more than the noise says.
pub(super) fn is_small(step: &DVector<f64>, hessian: &DMatrix<f64>, misfit: f64) -> bool {
    let inflation = misfit.sqrt();
    (0..step.len()).all(|k| step[k].abs() * hessian[(k, k)].sqrt() < STEP_TOLERANCE * inflation)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects;
    use crate::model::Structure;

    /// What bends is E (1 + c + ratio - 1), with c of what the grid adds.
    #[test]
    fn a_step_along_the_valley_of_stiffness_and_bending_ratio_stays_in_it_however_long() {
        let with = Structure::default().with(effects::find("bending_ratio").unwrap());
        let (info, grid) = (with.parameters(), 0.1);
        let bending = |theta: &[f64]| theta[YOUNG].exp() * (theta[2] + grid);
        let start = [2e6_f64.ln(), 0.3, 1.0];
        for change in [0.01, 0.3, 3.0] {
            let slope = -change / (start[2] + grid);
            let there = moved(&start, [slope, 0.0, change].into_iter(), &info, true);
            assert_eq!(there[2], 1.0 + change);
            assert!(
                (bending(&there) / bending(&start) - 1.0).abs() < 1e-12,
                "{there:?}"
            );
        }
    }

    #[test]
    fn without_an_effect_the_logarithm_of_the_stiffness_goes_straight() {
        let info = Structure::default().parameters();
        let there = moved(&[1e6_f64.ln(), 0.3], [1.0, 0.0].into_iter(), &info, false);
        assert!((there[YOUNG] - 1e6_f64.ln() - 1.0).abs() < 1e-12 && there[1] == 0.3);
    }
}
