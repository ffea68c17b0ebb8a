//! Standard errors of a fit, with the correlation of the residual taken into account.

use super::correlation::Correlation;
use super::cost::{normal_equations, weighted};
use super::problem::Evaluation;
use crate::model::{Estimate, POISSON_PRIOR, ParameterInfo, Structure};
use nalgebra::{DMatrix, DVector};

/// Covariance of θ. Poisson's ratio, where the data do not tell it, keeps the width of its prior, and adds to the
/// others what that width may have moved them ("consider" covariance, Schmidt 1966).
pub fn covariance(evaluation: &Evaluation, structure: &Structure) -> DMatrix<f64> {
    Information::of(evaluation, structure).covariance()
}

/// What the data and the prior tell of θ.
pub(super) struct Information {
    /// Covariance, without what Poisson's ratio may have moved where the data do not tell it; infinite where they do not
    /// tell some other entry.
    own: DMatrix<f64>,
    /// How many times as large the variance of each entry of θ that the data tell is as if the offsets were independent
    /// and as large as declared.
    pub variance_factor: Vec<f64>,
    /// How far the width of the prior in Poisson's ratio may have moved each entry of θ; nothing where the data tell
    /// it.
    pub ratio_shift: Vec<f64>,
}

impl Information {
    pub fn of(evaluation: &Evaluation, structure: &Structure) -> Self {
        let info = structure.parameters();
        let precisions = info.iter().map(|p| p.prior_sd.powi(-2));
        let prior = DMatrix::from_diagonal(&DVector::from_iterator(info.len(), precisions));
        let correlation = Correlation::of(evaluation);
        let (_, jacobian, roots) = weighted(evaluation);
        let data = jacobian.tr_mul(&jacobian);
        let gradient = correlation.gradient_covariance(&evaluation.rows, (&jacobian, &roots));
        let told = told(evaluation);
        let of_told = |matrix: &DMatrix<f64>| told.tr_mul(matrix) * &told;
        let information = of_least_squares(&of_told(&data), &of_told(&gradient));
        let own = (information + of_told(&prior)).cholesky();
        let infinite = || DMatrix::from_diagonal_element(info.len(), info.len(), f64::INFINITY);
        let factors = variance_factors(&of_told(&(&data + &prior)), &of_told(&(gradient + &prior)));
        // Correlated offsets count no more than they tell. The prior is not data: it does not shrink with them.
        let shrunk = data + prior * correlation.variance_factor();
        Self {
            own: own.map_or_else(infinite, |own| &told * own.inverse() * told.transpose()),
            variance_factor: (&told * factors).data.into(),
            ratio_shift: ratio_shift(&shrunk, &told, info[POISSON].prior_sd),
        }
    }

    /// See [`covariance`].
    pub fn covariance(&self) -> DMatrix<f64> {
        let moved = DVector::from_column_slice(&self.ratio_shift);
        &self.own + &moved * moved.transpose()
    }
}

/// Information of least squares from its Hessian H and the covariance M of its gradient: H M⁻¹ H, the inverse of the
/// sandwich covariance, which what the data do not tell leaves finite.
fn of_least_squares(hessian: &DMatrix<f64>, gradient: &DMatrix<f64>) -> DMatrix<f64> {
    let roots = hessian.diagonal().map(|h| if h > 0.0 { h.sqrt() } else { 1.0 });
    let scales = &roots * roots.transpose();
    let scaled = gradient.component_div(&scales);
    let least = SINGULAR * scaled.trace().max(1.0);
    let slight = DMatrix::from_diagonal_element(roots.len(), roots.len(), least);
    let Some(factored) = (scaled + slight).cholesky() else {
        return DMatrix::zeros(roots.len(), roots.len());
    };
    let hessian = hessian.component_div(&scales);
    (hessian.tr_mul(&factored.solve(&hessian))).component_mul(&scales)
}

/// How many times as large the variances of an estimate are with this covariance of its gradient as with its Hessian for
/// that.
fn variance_factors(hessian: &DMatrix<f64>, gradient: &DMatrix<f64>) -> DVector<f64> {
    let Some(factored) = hessian.clone().cholesky() else {
        return DVector::repeat(hessian.nrows(), f64::INFINITY);
    };
    let alone = factored.inverse();
    (&alone * gradient * &alone)
        .diagonal()
        .component_div(&alone.diagonal())
}

/// See [`Information::ratio_shift`].
fn ratio_shift(hessian: &DMatrix<f64>, told: &DMatrix<f64>, prior_sd: f64) -> Vec<f64> {
    let n = hessian.nrows();
    if told.ncols() == n {
        return vec![0.0; n];
    }
    match (told.tr_mul(hessian) * told).cholesky() {
        None => vec![f64::INFINITY; n],
        Some(factored) => {
            let mut moved = -(told * factored.solve(&told.tr_mul(&hessian.column(POISSON))));
            moved[POISSON] = 1.0;
            moved *= prior_sd;
            moved.data.into()
        }
    }
}

/// What makes θ of the entries that the data tell: the unit matrix without the columns of the others.
fn told(evaluation: &Evaluation) -> DMatrix<f64> {
    let n = evaluation.theta.len();
    let all = DMatrix::identity(n, n);
    if tells_poisson(evaluation, STIFFNESS_ACCURACY) {
        all
    } else {
        all.remove_column(POISSON)
    }
}

/// How far errors of the prediction along each row, over its standard error, move the optimum, to first order.
pub fn shift_by(evaluation: &Evaluation, structure: &Structure, over_noise: &DVector<f64>) -> Vec<f64> {
    let (hessian, _) = normal_equations(evaluation, &structure.parameters());
    let (_, jacobian, weights) = weighted(evaluation);
    let pull = jacobian.tr_mul(&weights.component_mul(over_noise));
    let told = told(evaluation);
    match (told.tr_mul(&hessian) * &told).cholesky() {
        Some(factored) => (&told * factored.solve(&told.tr_mul(&pull))).data.into(),
        None => vec![f64::INFINITY; evaluation.theta.len()],
    }
}

/// Share of the variance of a gradient that keeps its covariance from being singular.
const SINGULAR: f64 = 1e-12;
/// Share of the prior's standard deviation above which a parameter counts as not identified.
const IDENTIFIED_SHARE: f64 = 0.5;
/// The same of ln E, whose prior is a range of orders of magnitude: E is known to a factor of 1.6 either way.
const IDENTIFIED_LN_YOUNG: f64 = 0.5;
/// How far the model's own bending stiffness may be off on the coarsest grid that the program takes
/// ([`crate::sim::scene::MIN_CELLS_PER_DIAMETER`]).
pub const STIFFNESS_ACCURACY: f64 = 0.05;
/// Places of ln E and of Poisson's ratio in θ.
pub const YOUNG: usize = 0;
pub(super) const POISSON: usize = 1;

/// Root mean square by which a change of parameter `k` moves the measured offsets, m.
fn moves_m(evaluation: &Evaluation, k: usize, change: f64) -> f64 {
    evaluation.jacobian.column(k).norm() * change / (evaluation.len() as f64).sqrt()
}

/// Whether half the width of its prior in Poisson's ratio moves the rope by more than a bending stiffness that is
/// wrong by a share of `accuracy`. If not, whatever ratio fits best is what makes up for the grid: with 4,500
/// offsets of a lift it went to its bound, and took E along by one per cent.
pub(super) fn tells_poisson(evaluation: &Evaluation, accuracy: f64) -> bool {
    moves_m(evaluation, POISSON, IDENTIFIED_SHARE * POISSON_PRIOR[1]) > moves_m(evaluation, YOUNG, accuracy)
}

/// θ with standard errors, E in Pa. A parameter counts as identified when its error is small against
/// its prior (that of E: where it is known to a factor of 1.6), it is not at a bound, and a change of as much as that error
/// may be moves the rope by more than the model leaves unexplained: else that rest could pass for a value of it. Poisson's ratio must also move the rope
/// by more than the model's stiffness may be wrong, an error that leaves nothing unexplained where the two look
/// alike: by its noise alone a lift knows the ratio to a thousandth, and is off by a tenth on another grid.
pub fn estimates(evaluation: &Evaluation, structure: &Structure) -> Vec<Estimate> {
    estimates_within(evaluation, structure, &vec![0.0; evaluation.theta.len()])
}

/// The same where each entry of θ may be off by `shift` besides, as one standard error.
pub fn estimates_within(evaluation: &Evaluation, structure: &Structure, shift: &[f64]) -> Vec<Estimate> {
    judged(evaluation, structure, shift, |k, info| match k {
        YOUNG => IDENTIFIED_LN_YOUNG,
        _ => IDENTIFIED_SHARE * info.prior_sd,
    })
}

/// Whether the data tell more of each entry of θ than its prior does, be it little: of E to a factor of a hundred.
pub fn tells(evaluation: &Evaluation, structure: &Structure) -> Vec<bool> {
    let least = |_, info: &ParameterInfo| IDENTIFIED_SHARE * info.prior_sd;
    let judged = judged(evaluation, structure, &vec![0.0; evaluation.theta.len()], least);
    judged.into_iter().map(|estimate| estimate.identified).collect()
}

/// The same where an entry counts as identified that is known to as much as `known` says.
fn judged(
    evaluation: &Evaluation,
    structure: &Structure,
    shift: &[f64],
    known: impl Fn(usize, &ParameterInfo) -> f64,
) -> Vec<Estimate> {
    let covariance = covariance(evaluation, structure);
    let unexplained_m = (evaluation.rms_m().powi(2) - evaluation.floor_m().powi(2))
        .max(0.0)
        .sqrt();
    let unexplained_of_m = |k: usize| match k {
        POISSON => unexplained_m.max(moves_m(evaluation, YOUNG, STIFFNESS_ACCURACY)),
        _ => unexplained_m,
    };
    structure
        .parameters()
        .into_iter()
        .enumerate()
        .map(|(k, info)| {
            let se = covariance[(k, k)].sqrt().hypot(shift[k]);
            let theta = evaluation.theta[k];
            let inside = info.holds(theta);
            let known = known(k, &info);
            let (value, standard_error) = if k == YOUNG {
                (theta.exp(), theta.exp() * se)
            } else {
                (theta, se)
            };
            Estimate {
                name: info.name,
                unit: info.unit.into(),
                value,
                standard_error,
                identified: se < known && inside && moves_m(evaluation, k, known) > unexplained_of_m(k),
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observe::Row;

    /// A thousand exact offsets; E moves each by a hundredth per unit of its logarithm, ν by `per_ratio` in another
    /// pattern: by the noise alone both are known very well.
    fn evaluation(per_ratio: f64) -> Evaluation {
        let row = |i: usize| Row {
            frame: i / 20,
            station: i % 20,
            arc_m: 0.01 * (i % 20) as f64,
            position_m: [0.0; 3],
            direction: [0.0, 0.0, 1.0],
            offset_m: [1e-6, -1e-6][i % 2],
            sigma_m: 1e-6,
        };
        let slopes = |i: usize, k: usize| match k {
            YOUNG => 1e-2,
            _ => per_ratio * if i % 4 < 2 { 1.0 } else { -1.0 },
        };
        Evaluation {
            theta: vec![14.0, 0.25],
            rows: vec![(0..1000).map(row).collect()],
            most_rows: 1000,
            huber: f64::INFINITY,
            jacobian: DMatrix::from_fn(1000, 2, slopes),
        }
    }

    #[test]
    fn what_a_ratio_that_is_not_told_may_move_is_in_the_error_of_e() {
        // It moves every offset as E does, 4e-4 a unit against 1e-2: its prior's 0.1 counts as 0.4 % of E.
        let mut alike = evaluation(4e-4);
        alike.jacobian.column_mut(POISSON).fill(4e-4);
        let of_young = |e: &Evaluation| {
            let young = &estimates(e, &Structure::default())[YOUNG];
            young.standard_error / young.value
        };
        assert!((of_young(&alike) - 0.004).abs() < 1e-4, "{}", of_young(&alike));
        assert!(of_young(&evaluation(4e-4)) < 1e-4);
    }

    /// A rope that hangs at rest tells E to a factor of a hundred: less than its range, and still nothing.
    #[test]
    fn a_stiffness_known_to_no_factor_of_two_is_not_identified() {
        for (noise_m, identified) in [(0.01, true), (0.1, false)] {
            let mut noisy = evaluation(4e-4);
            for row in noisy.rows.iter_mut().flatten() {
                (row.offset_m, row.sigma_m) = (row.offset_m * 1e6 * noise_m, noise_m);
            }
            let young = &estimates(&noisy, &Structure::default())[YOUNG];
            assert_eq!(young.identified, identified, "{young:?}");
        }
    }

    #[test]
    fn a_ratio_that_moves_the_rope_less_than_the_models_own_error_keeps_its_prior() {
        // Half of the prior's 0.1 against 5 % of E: 0.02 mm and 2 mm against 0.5 mm.
        for (per_ratio, identified) in [(4e-4, false), (4e-2, true)] {
            let list = estimates(&evaluation(per_ratio), &Structure::default());
            let se = list[POISSON].standard_error;
            assert!(
                if identified {
                    se < 0.01
                } else {
                    se == POISSON_PRIOR[1]
                },
                "{list:?}"
            );
            assert!(
                list[YOUNG].identified && list[POISSON].identified == identified,
                "{list:?}"
            );
        }
    }
}
