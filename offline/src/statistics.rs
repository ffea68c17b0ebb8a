//! Rates with intervals, medians, and how far two mean squares of the same noise may lie apart.

use serde::{Deserialize, Serialize};

/// 97.5 % point of the normal distribution: of a two-sided test at 5 %.
pub const NORMAL_975: f64 = 1.959_963_985;

/// 99 % point of the normal distribution.
pub const NORMAL_99: f64 = 2.326_347_874;

/// What the ratio of two mean squares of the same noise, each of so many independent values, infinitely many where it is
/// known, exceeds as seldom as a normal number exceeds `z`: Paulson's approximation of the quantiles of F (1942), which takes
/// their cube roots for normal. With 65 values below and all above it is 1.57 at 99 %, where 1 + `z` standard deviations are
/// 1.41: few values that happen to be small make a ratio large.
pub fn ratio_of_mean_squares(z: f64, above: f64, below: f64) -> f64 {
    let [a, b] = [above, below].map(|values| 2.0 / (9.0 * values));
    let (of_above, of_below) = (1.0 - a, 1.0 - b);
    let least = of_below * of_below - z * z * b;
    if least <= 0.0 {
        return f64::INFINITY;
    }
    let spread = (of_above * of_above * b + of_below * of_below * a - z * z * a * b).max(0.0);
    ((of_above * of_below + z * spread.sqrt()) / least).powi(3)
}

/// How often something happened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Rate {
    /// Times it happened.
    pub hits: usize,
    /// Times it could have.
    pub of: usize,
}

impl Rate {
    /// Counts.
    pub fn of(events: impl IntoIterator<Item = bool>) -> Self {
        events.into_iter().fold(Self::default(), |rate, hit| Self {
            hits: rate.hits + usize::from(hit),
            of: rate.of + 1,
        })
    }

    /// Share, none of nothing.
    pub fn share(&self) -> Option<f64> {
        (self.of > 0).then(|| self.hits as f64 / self.of as f64)
    }

    /// 95 % interval of the probability (Wilson 1927), which holds for few events and rates near 0 and 1.
    pub fn wilson(&self) -> Option<[f64; 2]> {
        const Z: f64 = NORMAL_975;
        let (p, n) = (self.share()?, self.of as f64);
        let square = Z * Z / n;
        let middle = p + 0.5 * square;
        let half = Z * (p * (1.0 - p) / n + 0.25 * square / n).sqrt();
        Some([middle - half, middle + half].map(|end| end / (1.0 + square)))
    }
}

/// The middle value, the mean of the two middle ones where their number is even.
pub fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let half = values.len() / 2;
    match values.len() {
        0 => None,
        n if n % 2 == 1 => Some(values[half]),
        _ => Some(0.5 * (values[half - 1] + values[half])),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wilson_intervals_are_those_of_the_literature() {
        // Newcombe (1998), table I, method 3: 81 of 263, 15 of 148, 0 of 20, 1 of 29.
        let cases = [
            (81, 263, [0.2553, 0.3662]),
            (15, 148, [0.0624, 0.1605]),
            (0, 20, [0.0, 0.1611]),
            (1, 29, [0.0061, 0.1718]),
        ];
        for (hits, of, expected) in cases {
            let found = Rate { hits, of }.wilson().unwrap();
            for k in 0..2 {
                assert!((found[k] - expected[k]).abs() < 1e-4, "{hits} of {of}: {found:?}");
            }
        }
        assert_eq!(Rate::default().wilson(), None);
    }

    /// Upper 1 % points of F in the tables (Fisher and Yates), and 1 where both are known.
    #[test]
    fn ratios_of_mean_squares_are_those_of_the_tables() {
        let all = f64::INFINITY;
        let cases = [
            (10.0, 10.0, 4.849),
            (10.0, 20.0, 3.368),
            (60.0, 60.0, 1.836),
            (120.0, 60.0, 1.726),
            (60.0, all, 1.473),
            (all, 60.0, 1.601),
            (all, all, 1.0),
        ];
        for (above, below, expected) in cases {
            let found = ratio_of_mean_squares(NORMAL_99, above, below);
            assert!((found / expected - 1.0).abs() < 0.02, "{above} {below}: {found}");
        }
        assert_eq!(ratio_of_mean_squares(NORMAL_99, 10.0, 1.0), all);
    }

    #[test]
    fn the_median_is_in_the_middle() {
        assert_eq!(median(vec![]), None);
        assert_eq!(median(vec![3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median(vec![4.0, 1.0, 2.0, 3.0]), Some(2.5));
    }
}
