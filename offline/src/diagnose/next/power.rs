//! How well a demonstration tells two models apart, and how much it narrows a parameter, to first order.
//!
//! The test of one model against another that is true asks for the other's signature in what is left, one
//! direction that is known beforehand (Davidson and MacKinnon 1981). Its statistic is a non-central χ² with
//! one degree of freedom; the non-centrality is the squared whitened distance between what the two models
//! predict once the wrong one has been fitted anew to all data (Hunter and Reiner 1965).

use nalgebra::{DMatrix, DVector};

/// Level of the test.
pub const LEVEL: f64 = 0.05;
/// Normal quantile of that level, two-sided.
const QUANTILE: f64 = 1.959_963_985;

/// What a model says of a demonstration, in whitened units.
#[derive(Clone, Debug)]
pub struct Prospect {
    /// Slopes of its prediction, whitened.
    pub slopes: DMatrix<f64>,
    /// Information about its parameters in the data so far, priors included.
    pub information: DMatrix<f64>,
    /// Mean square of what the model leaves of the data so far, whitened; at least one. New data cannot
    /// be expected to fit better.
    pub misfit: f64,
}

impl Prospect {
    /// Non-centrality of the test of this model where `miss`, whitened, is what the true model predicts
    /// minus what this one does: what is left of it when this model's parameters follow.
    pub fn noncentrality(&self, miss: &DVector<f64>) -> f64 {
        let pull = self.slopes.tr_mul(miss) / self.misfit;
        let absorbed = match self.after().cholesky() {
            Some(factor) => pull.dot(&factor.solve(&pull)),
            None => 0.0,
        };
        (miss.norm_squared() / self.misfit - absorbed).max(0.0)
    }

    /// Standard deviation of a parameter with the data so far, and with the new ones besides.
    pub fn narrowing(&self, parameter: usize) -> Option<[f64; 2]> {
        let spread = |information: DMatrix<f64>| -> Option<f64> {
            Some(information.cholesky()?.inverse()[(parameter, parameter)].sqrt())
        };
        Some([spread(self.information.clone())?, spread(self.after())?])
    }

    fn after(&self) -> DMatrix<f64> {
        self.slopes.tr_mul(&self.slopes) / self.misfit + &self.information
    }
}

/// Probability that a two-sided test at [`LEVEL`] finds a non-centrality.
pub fn power(noncentrality: f64) -> f64 {
    let shift = noncentrality.sqrt();
    normal_above(QUANTILE - shift) + normal_above(QUANTILE + shift)
}

fn normal_above(z: f64) -> f64 {
    0.5 * libm::erfc(z * std::f64::consts::FRAC_1_SQRT_2)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Non-centralities for 80 and 90 % power at 5 % with one degree of freedom (Saris, Satorra and van der
    /// Veld 2009, and any table of the non-central χ²).
    #[test]
    fn the_power_is_that_of_the_tables() {
        assert!((power(0.0) - LEVEL).abs() < 1e-9);
        assert!((power(7.849) - 0.8).abs() < 1e-3);
        assert!((power(10.507) - 0.9).abs() < 1e-3);
    }

    const FRAMES: usize = 50;

    /// What an effect whose force goes with a power of the speed does over a motion at a speed; the base
    /// parameter does the same whatever the speed.
    fn trace(speed: f64, power: f64) -> DVector<f64> {
        DVector::from_fn(FRAMES, |i, _| {
            let share = (i as f64 + 0.5) / FRAMES as f64;
            speed.powf(power) * (std::f64::consts::PI * share).sin()
        })
    }

    fn base() -> DVector<f64> {
        DVector::from_fn(FRAMES, |i, _| i as f64 / FRAMES as f64)
    }

    /// Two models, each the base and one effect; sizes fit data at speed one equally well.
    fn tell_apart(speed: f64, powers: [f64; 2]) -> f64 {
        const SIZE: f64 = 10.0;
        let slopes = |s: f64| DMatrix::from_columns(&[base(), trace(s, powers[1])]);
        let old = slopes(1.0);
        let prospect = Prospect {
            slopes: slopes(speed),
            information: old.tr_mul(&old) + DMatrix::identity(2, 2) * 1e-6,
            misfit: 1.0,
        };
        prospect.noncentrality(&((trace(speed, powers[0]) - trace(speed, powers[1])) * SIZE))
    }

    #[test]
    fn effects_that_differ_with_speed_are_told_apart_by_another_speed_only() {
        let [same, half, double] = [1.0, 0.5, 2.0].map(|speed| tell_apart(speed, [1.0, 2.0]));
        assert!(same < 1e-9, "{same}");
        assert!(
            power(double) > 0.99 && double > half && half > same,
            "{half} {double}"
        );
    }

    #[test]
    fn identical_twins_are_never_told_apart() {
        for speed in [0.5, 1.0, 2.0, 5.0] {
            assert!(tell_apart(speed, [1.0, 1.0]) < 1e-9);
        }
    }

    /// A misfit of four halves every distance; a second demonstration like the first halves the variance.
    #[test]
    fn misfit_and_repetition_count_as_they_should() {
        let slopes = DMatrix::from_columns(&[base()]);
        let information = slopes.tr_mul(&slopes);
        let of = |misfit: f64| Prospect {
            slopes: slopes.clone(),
            information: &information / misfit,
            misfit,
        };
        let miss = trace(1.0, 1.0);
        let (clean, rough) = (of(1.0).noncentrality(&miss), of(4.0).noncentrality(&miss));
        assert!((clean / rough - 4.0).abs() < 1e-9);
        let [before, after] = of(1.0).narrowing(0).unwrap();
        assert!((before / after - 2f64.sqrt()).abs() < 1e-9);
    }
}
