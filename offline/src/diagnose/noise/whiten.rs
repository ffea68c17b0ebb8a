//! Takes out of offsets and slopes what noise of earlier frames and neighbouring stations lets expect of them.

use super::Noise;
use super::series::{MOST_ALIKE, alike};
use crate::fit::Evaluation;
use crate::observe::Row;
use nalgebra::DMatrix;
use std::collections::HashMap;

impl Noise {
    /// The operator that makes this noise white on the rows of an evaluation.
    pub fn whitener(&self, evaluation: &Evaluation) -> Whitener {
        let mut first = 0;
        let (mut in_time, mut along_rope) = (Vec::new(), Vec::new());
        for rows in &evaluation.rows {
            in_time.extend(predecessors(rows, first, self.in_time, |row| {
                Some((row.frame.checked_sub(1)?, row.station))
            }));
            along_rope.extend(predecessors(rows, first, self.along_rope, |row| {
                Some((row.frame, row.station.checked_sub(1)?))
            }));
            first += rows.len();
        }
        Whitener {
            passes: [in_time, along_rope],
        }
    }
}

/// For each row what its predecessor lets expect: weights of other rows, and what is left over.
struct Expected {
    from: Vec<(usize, f64)>,
    spread: f64,
}

/// Takes the expected part out of whitened residuals and columns of tangents alike.
pub struct Whitener {
    passes: [Vec<Expected>; 2],
}

impl Whitener {
    /// Whitens every column, which is over the rows' standard errors already.
    pub fn apply(&self, columns: &DMatrix<f64>) -> DMatrix<f64> {
        let mut now = columns.clone();
        for pass in &self.passes {
            let before = now.clone();
            for (i, expected) in pass.iter().enumerate() {
                for k in 0..now.ncols() {
                    let guess: f64 = expected.from.iter().map(|&(j, w)| w * before[(j, k)]).sum();
                    now[(i, k)] = (before[(i, k)] - guess) / expected.spread;
                }
            }
        }
        now
    }
}

fn predecessors(
    rows: &[Row],
    first: usize,
    correlation: f64,
    before: impl Fn(&Row) -> Option<(usize, usize)>,
) -> Vec<Expected> {
    let mut places: HashMap<(usize, usize), Vec<usize>> = HashMap::new();
    for (i, row) in rows.iter().enumerate() {
        places.entry((row.frame, row.station)).or_default().push(i);
    }
    rows.iter()
        .map(|row| {
            let there = before(row).and_then(|place| places.get(&place));
            let Some(there) = there.filter(|_| correlation > 0.0) else {
                return Expected {
                    from: Vec::new(),
                    spread: 1.0,
                };
            };
            let weight = |&j: &usize| (first + j, correlation * alike(&row.direction, &rows[j].direction));
            let from: Vec<(usize, f64)> = there.iter().map(weight).collect();
            let known: f64 = from.iter().map(|(_, w)| w * w).sum();
            Expected {
                spread: (1.0 - known.min(MOST_ALIKE * MOST_ALIKE)).sqrt(),
                from,
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::tests::{FRAMES, LIKE_THE_BENCHMARKS, STATIONS, rows_of};
    use super::*;
    use crate::bench_diagnosis::noise::correlated;
    use nalgebra::DVector;

    /// After whitening with the true correlations the noise has unit variance and no neighbours alike.
    #[test]
    fn whitened_noise_is_white() {
        let noise = correlated(FRAMES, STATIONS, 0.001, [0.6, 0.7], 5);
        let evaluation = Evaluation {
            theta: Vec::new(),
            rows: vec![rows_of(&noise, FRAMES)],
            most_rows: FRAMES * STATIONS,
            huber: f64::INFINITY,
            jacobian: DMatrix::zeros(0, 0),
        };
        let raw = evaluation.whitened();
        let column = DMatrix::from_columns(&[raw]);
        let white: DVector<f64> = LIKE_THE_BENCHMARKS
            .whitener(&evaluation)
            .apply(&column)
            .column(0)
            .into_owned();
        let n = white.len() as f64;
        // Standard error of a variance from 2880 independent numbers: 2.6 %; four of them.
        assert!((white.norm_squared() / n - 1.0).abs() < 0.11);
        let lag = 3 * STATIONS;
        let next: f64 = (lag..white.len()).map(|i| white[i] * white[i - lag]).sum::<f64>() / n;
        let beside: f64 = (3..white.len()).map(|i| white[i] * white[i - 3]).sum::<f64>() / n;
        assert!(next.abs() < 0.08 && beside.abs() < 0.08, "{next} {beside}");
    }
}
