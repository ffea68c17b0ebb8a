//! How alike neighbouring offsets are, in time and along the rope, and what that does to an estimate.

use super::problem::Evaluation;
use crate::observe::Row;
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

/// How alike neighbouring residuals are, and what that does to their information.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Correlation {
    /// Between successive frames that were seen, at one station.
    pub in_time: f64,
    /// Between neighbouring stations of one frame.
    pub along_rope: f64,
    /// Mean square of the whitened residual: 1 for a perfect model with the right noise.
    pub reduced_chi_square: f64,
}

impl Correlation {
    /// Measured on the whitened residual.
    pub fn of(evaluation: &Evaluation) -> Self {
        let mut sums = [(0.0, 0.0), (0.0, 0.0)];
        let mut square = 0.0;
        for rows in &evaluation.rows {
            for (i, a) in rows.iter().enumerate() {
                let ra = a.offset_m / a.sigma_m;
                square += ra * ra;
                let others = &rows[i + 1..];
                // Of what is held out of poses, or where a frame is lost, the next is not the one that follows.
                let next = others.iter().map(|b| b.frame).find(|&frame| frame > a.frame);
                for b in others
                    .iter()
                    .take_while(|b| b.frame == a.frame || Some(b.frame) == next)
                {
                    let neighbours = [
                        Some(b.frame) == next && b.station == a.station,
                        b.frame == a.frame && b.station.abs_diff(a.station) == 1,
                    ];
                    // Rows are compared as vectors: parts along different directions do not mix.
                    let alike: f64 = (0..3).map(|k| a.direction[k] * b.direction[k]).sum();
                    let rb = b.offset_m / b.sigma_m;
                    for (sum, &neighbour) in sums.iter_mut().zip(&neighbours) {
                        if neighbour {
                            sum.0 += ra * rb * alike;
                            sum.1 += 0.5 * (ra * ra + rb * rb) * alike * alike;
                        }
                    }
                }
            }
        }
        let ratio = |(product, norm): (f64, f64)| {
            if norm > 0.0 {
                (product / norm).clamp(0.0, 0.99)
            } else {
                0.0
            }
        };
        Self {
            in_time: ratio(sums[0]),
            along_rope: ratio(sums[1]),
            reduced_chi_square: square / evaluation.len() as f64,
        }
    }

    /// Factor on the variance of a mean: misfit, and the loss of effective sample size of an autoregressive
    /// residual, (1 + r)/(1 − r) in time and along the rope. Few slopes lose as much.
    pub fn variance_factor(&self) -> f64 {
        let loss = |r: f64| (1.0 + r) / (1.0 - r);
        self.reduced_chi_square.max(1.0) * loss(self.in_time) * loss(self.along_rope)
    }

    /// Number of independent residuals that carry the same information as `rows` correlated ones.
    pub fn effective_rows(&self, rows: usize) -> f64 {
        let keep = |r: f64| (1.0 - r) / (1.0 + r);
        rows as f64 * keep(self.in_time) * keep(self.along_rope)
    }

    /// Covariance of the gradient of the cost, Σᵢⱼ gᵢ Rᵢⱼ gⱼᵀ with gᵢ the row's part of it and R the correlation of the
    /// whitened offsets, times their mean square where that is more than one: the middle of the sandwich covariance of
    /// least squares (White 1980). The loss of effective sample size is that of a mean; slopes that change along the rope
    /// and over time lose less, because neighbours' errors partly cancel in them.
    pub(super) fn gradient_covariance(
        &self,
        rows: &[Vec<Row>],
        (weighted_jacobian, roots): (&DMatrix<f64>, &DVector<f64>),
    ) -> DMatrix<f64> {
        let n = weighted_jacobian.ncols();
        let mut sum = DMatrix::zeros(n, n);
        let mut first = 0;
        for rows in rows {
            let part = |i: usize, k: usize| roots[first + i] * weighted_jacobian[(first + i, k)];
            sum += of_demonstration(rows, &DMatrix::from_fn(rows.len(), n, part), self);
            first += rows.len();
        }
        sum * self.reduced_chi_square.max(1.0)
    }
}

/// The sum of [`Correlation::gradient_covariance`] over one demonstration, as vectors at the places that were seen: the
/// correlation is a product of one in time and one along the rope, and each is two passes of a filter.
fn of_demonstration(rows: &[Row], gradients: &DMatrix<f64>, correlation: &Correlation) -> DMatrix<f64> {
    let mut seen_in: Vec<usize> = rows.iter().map(|row| row.frame).collect();
    seen_in.dedup();
    let frames = seen_in.len();
    let stations = rows.iter().map(|row| row.station + 1).max().unwrap_or(0);
    let place = |row: &Row, axis: usize| {
        let frame = seen_in
            .binary_search(&row.frame)
            .expect("rows are in the order of frames");
        (frame * stations + row.station) * 3 + axis
    };
    let n = gradients.ncols();
    let mut seen = DMatrix::zeros(frames * stations * 3, n);
    for (i, row) in rows.iter().enumerate() {
        for (axis, part) in row.direction.iter().enumerate() {
            for k in 0..n {
                seen[(place(row, axis), k)] += part * gradients[(i, k)];
            }
        }
    }
    let mut correlated = seen.clone();
    for mut column in correlated.column_iter_mut() {
        let column = column.as_mut_slice();
        for start in (0..frames).flat_map(|f| (0..3).map(move |axis| f * stations * 3 + axis)) {
            filter(column, (start, 3, stations), correlation.along_rope);
        }
        for start in 0..stations * 3 {
            filter(column, (start, stations * 3, frames), correlation.in_time);
        }
    }
    seen.tr_mul(&correlated)
}

/// Σⱼ r^|i−j| xⱼ in place, over `count` entries from `start`, `stride` apart.
fn filter(x: &mut [f64], (start, stride, count): (usize, usize, usize), r: f64) {
    let mut before = 0.0;
    let forward: Vec<f64> = (0..count)
        .map(|i| {
            before = x[start + i * stride] + r * before;
            before
        })
        .collect();
    let mut after = 0.0;
    for i in (0..count).rev() {
        let own = x[start + i * stride];
        x[start + i * stride] = forward[i] + r * after;
        after = own + r * after;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench_diagnosis::noise::correlated;
    use crate::fit::covariance;
    use crate::model::Structure;

    #[test]
    fn a_filter_sums_what_hangs_together() {
        let x = [1.0, -2.0, 0.5, 3.0, 7.0, 1.5];
        for (start, stride, count) in [(0, 1, 6), (1, 2, 3)] {
            let mut y = x;
            filter(&mut y, (start, stride, count), 0.6);
            for i in 0..count {
                let sum: f64 = (0..count)
                    .map(|j| 0.6_f64.powi(i.abs_diff(j) as i32) * x[start + j * stride])
                    .sum();
                assert!((y[start + i * stride] - sum).abs() < 1e-12);
            }
        }
    }

    const FRAMES: usize = 40;
    const STATIONS: usize = 12;
    const SIGMA_M: f64 = 1e-3;

    /// Offsets that are noise, alike in time and along the rope, and slopes of two parameters: one moves the whole rope
    /// all the time, the other a bend of it that comes and goes. Both by so much that their priors tell nothing.
    fn evaluation(seed: u64) -> Evaluation {
        let noise = correlated(FRAMES, STATIONS, SIGMA_M, [0.6, 0.7], seed);
        let row = |i: usize| Row {
            frame: i / 3 / STATIONS,
            station: i / 3 % STATIONS,
            arc_m: 0.0,
            position_m: [0.0; 3],
            direction: std::array::from_fn(|k| if k == i % 3 { 1.0 } else { 0.0 }),
            offset_m: noise[i / 3 / STATIONS][i / 3 % STATIONS][i % 3],
            sigma_m: SIGMA_M,
        };
        let rows: Vec<Row> = (0..3 * FRAMES * STATIONS).map(row).collect();
        let wave = |at: usize, of: usize| (std::f64::consts::TAU * at as f64 / of as f64).sin();
        let slopes = |i: usize, k: usize| match k {
            0 => 20.0 * SIGMA_M * [1.0, 0.5, 0.0][i % 3],
            _ => {
                100.0
                    * SIGMA_M
                    * [0.0, 1.0, 1.0][i % 3]
                    * wave(rows[i].station, STATIONS)
                    * wave(rows[i].frame, 20)
            }
        };
        let jacobian = DMatrix::from_fn(rows.len(), 2, slopes);
        Evaluation {
            theta: vec![14.0, 0.3],
            most_rows: rows.len(),
            huber: f64::INFINITY,
            rows: vec![rows],
            jacobian,
        }
    }

    /// Of three poses one is held out: none of those is another's neighbour.
    #[test]
    fn the_next_pose_is_the_next_that_was_seen() {
        let mut all = evaluation(1);
        let mut every_third = all.clone();
        every_third.rows[0]
            .iter_mut()
            .for_each(|row| row.frame = 3 * row.frame + 1);
        assert_eq!(Correlation::of(&every_third), Correlation::of(&all));
        let covariance_of = |e: &Evaluation| covariance(e, &Structure::default());
        assert_eq!(covariance_of(&every_third), covariance_of(&all));
        all.rows[0].retain(|row| row.frame % 3 == 1);
        assert!(
            (0.1..0.4).contains(&Correlation::of(&all).in_time),
            "0.6 to the third is 0.2"
        );
    }

    /// Standard errors are as large as estimates from fresh noise scatter, for both parameters; by the effective sample
    /// size alone the second's would be nearly twice as large.
    #[test]
    fn standard_errors_are_what_estimates_scatter_by() {
        let structure = Structure::default();
        let (draws, mut squares, mut said) = (600, [0.0; 2], [0.0; 2]);
        for seed in 0..draws {
            let evaluation = evaluation(seed);
            let jacobian = evaluation.whitened_jacobian();
            let residual = DVector::from_row_slice(evaluation.whitened().as_slice());
            let normal = jacobian.tr_mul(&jacobian).cholesky().unwrap();
            let estimate = normal.solve(&jacobian.tr_mul(&residual));
            let covariance = covariance(&evaluation, &structure);
            for k in 0..2 {
                squares[k] += estimate[k] * estimate[k] / draws as f64;
                said[k] += covariance[(k, k)].sqrt() / draws as f64;
            }
        }
        let factor = Correlation::of(&evaluation(1)).variance_factor();
        for k in 0..2 {
            let ratio = said[k] / squares[k].sqrt();
            assert!((0.9..1.1).contains(&ratio), "{k}: {ratio}");
        }
        let jacobian = evaluation(1).whitened_jacobian();
        let of_a_mean = (factor / jacobian.column(1).norm_squared()).sqrt();
        assert!(of_a_mean > 1.5 * said[1], "{of_a_mean} {}", said[1]);
    }
}
