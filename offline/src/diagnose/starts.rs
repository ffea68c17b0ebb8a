//! Where refits start: the model's own parameters as the data told them, changed as an effect's score says.

use crate::fit::{Evaluation, moved, tells};
use crate::model::{ParameterInfo, Structure};

/// θ of a model where the data told it, the prior's centre where they did not; and whether they did.
pub(super) fn told(best: &Evaluation, structure: &Structure) -> Vec<(f64, bool)> {
    let all = tells(best, structure).into_iter();
    let entries = all.zip(&best.theta).zip(structure.parameters());
    entries
        .map(|((told, &theta), info)| (if told { theta } else { info.prior_mean }, told))
        .collect()
}

/// θ of which some entries are told, these changed by so many times `change`.
pub(super) fn changed(told: &[(f64, bool)], info: &[ParameterInfo], change: &[f64], times: f64) -> Vec<f64> {
    let (theta, told): (Vec<f64>, Vec<bool>) = told.iter().copied().unzip();
    let change = change.iter().copied().chain(std::iter::repeat(0.0));
    let step = told
        .iter()
        .zip(change)
        .map(|(&told, change)| if told { times * change } else { 0.0 });
    moved(&theta, step, info, true)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Seen on a cable of which end mass and curl were unknown: where its stiffness stayed, or became e¹¹ times as large, no
    /// size of the two was better than nothing.
    #[test]
    fn a_heavier_rope_is_stiffer_in_proportion_and_what_the_data_do_not_tell_stays() {
        let info = Structure::default().parameters();
        let told = [(1e6_f64.ln(), true), (0.3, false)];
        let young_pa = |change: f64, times: f64| changed(&told, &info, &[change, 0.1], times)[0].exp();
        assert!((young_pa(11.0, 1.0) / 12e6 - 1.0).abs() < 1e-9);
        assert!((young_pa(11.0, 0.0) / 1e6 - 1.0).abs() < 1e-9);
        assert!((young_pa(-1.0, 1.0) / 0.5e6 - 1.0).abs() < 1e-9);
        assert_eq!(changed(&told, &info, &[11.0, 0.1], 1.0)[1], 0.3);
        assert_eq!(changed(&told, &info, &[1e9, 0.0], 1.0)[0], info[0].high);
        assert_eq!(changed(&told, &info, &[], 1.0)[0], told[0].0);
    }
}
