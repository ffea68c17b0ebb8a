//! The least that noise can be where nothing measures it: how offsets jitter from frame to frame.
//!
//! Third differences in time take out what is smooth, the rope's motion and what a model misses of it. Noise that hangs
//! together in time loses as well, so this is a lower bound; what is left of fast motion adds, which is why the quieter
//! quarter of the differences is asked.

use super::series::{in_frame, offset_along};
use super::{Noise, NoiseSource};
use crate::fit::{Evaluation, Problem};
use crate::observe::Row;
use crate::statistics::{NORMAL_99, ratio_of_mean_squares};

/// Third differences: weights of four frames in a row.
const WEIGHTS: [f64; 4] = [-1.0, 3.0, -3.0, 1.0];
/// Frames whose spacing differs by more than this share are no four in a row.
const EVEN: f64 = 0.2;
/// The value below which a quarter of the squares of standard normal numbers lie (χ² of one degree of freedom).
const LOWER_QUARTILE: f64 = 0.101531;
/// Independent squares whose lower quartile is known as well as the mean of one is: the variance of a quantile of share p and
/// density f at x is p (1 − p)/(n f²), over x² here, against 2/n.
const SQUARES_PER_VALUE: f64 = 6.4;
/// Fewest differences that tell anything.
const FEWEST: usize = 40;

/// The noise where its offsets jitter beyond doubt by more than is declared; none where they do not, or are too few to tell.
pub(super) fn more_than_declared(problem: &Problem, evaluation: &Evaluation) -> Option<Noise> {
    let mut squares = Vec::new();
    for ((demo, scene), rows) in problem.demos.iter().zip(&problem.scenes).zip(&evaluation.rows) {
        if !demo.spec.is_static() {
            squares.extend(third_differences(rows, &scene.frame_times_s, problem.noise_scale));
        }
    }
    let noise = at_least(squares)?;
    let by_chance = ratio_of_mean_squares(NORMAL_99, noise.values, f64::INFINITY);
    (noise.scale.powi(2) > by_chance).then_some(noise)
}

fn at_least(mut squares: Vec<f64>) -> Option<Noise> {
    if squares.len() < FEWEST {
        return None;
    }
    let values = squares.len() as f64 / SQUARES_PER_VALUE;
    let quarter = squares.len() / 4;
    let (_, square, _) = squares.select_nth_unstable_by(quarter, f64::total_cmp);
    Some(Noise {
        scale: (*square / LOWER_QUARTILE).sqrt(),
        values,
        source: NoiseSource::Jitter,
        ..Noise::DECLARED
    })
}

/// Squares of third differences over what the declared standard errors make of them: of every station, along every direction
/// of the first of four frames, no frame twice.
fn third_differences(rows: &[Row], times_s: &[f64], scale: f64) -> Vec<f64> {
    let stations = rows.iter().map(|row| row.station + 1).max().unwrap_or(0);
    let mut squares = Vec::new();
    for station in 0..stations {
        let at: Vec<&Row> = rows.iter().filter(|row| row.station == station).collect();
        for first in (0..times_s.len().saturating_sub(3)).step_by(4) {
            if !evenly_spaced(&times_s[first..first + 4]) {
                continue;
            }
            squares.extend(in_frame(&at, first).iter().filter_map(|axis| {
                let (mut difference_m, mut variance) = (0.0, 0.0);
                for (k, weight) in WEIGHTS.iter().enumerate() {
                    let (offset_m, square) = offset_along(&at, &axis.direction, first + k)?;
                    difference_m += weight * offset_m;
                    variance += weight * weight * square;
                }
                Some((scale * difference_m).powi(2) / variance)
            }));
        }
    }
    squares
}

fn evenly_spaced(times_s: &[f64]) -> bool {
    let steps = || times_s.windows(2).map(|two| two[1] - two[0]);
    let [least, most] = [steps().fold(f64::INFINITY, f64::min), steps().fold(0.0, f64::max)];
    most <= (1.0 + EVEN) * least
}

#[cfg(test)]
mod tests {
    use super::super::tests::rows_of;
    use super::*;
    use crate::bench_diagnosis::noise::correlated;

    const FRAMES: usize = 90;
    const STATIONS: usize = 16;

    /// Noise of twice the declared size on a swing that a model misses by 20 mm at 2 Hz, filmed at 60 Hz.
    fn found(correlation: [f64; 2], seed: u64) -> Noise {
        let mut rows = rows_of(&correlated(FRAMES, STATIONS, 0.002, correlation, seed), FRAMES);
        let times_s: Vec<f64> = (0..FRAMES).map(|k| k as f64 / 60.0).collect();
        for row in &mut rows {
            row.offset_m += 0.02 * (std::f64::consts::TAU * 2.0 * times_s[row.frame]).sin();
        }
        at_least(third_differences(&rows, &times_s, 1.0)).expect("90 frames")
    }

    #[test]
    fn jitter_tells_independent_noise_and_bounds_what_hangs_together() {
        const SETS: u64 = 20;
        let mean =
            |correlation| (0..SETS).map(|seed| found(correlation, seed).scale).sum::<f64>() / SETS as f64;
        let independent = mean([0.0, 0.0]);
        assert!((independent - 2.0).abs() < 0.1, "{independent}");
        let alike = mean([0.6, 0.7]);
        assert!(0.8 < alike && alike < 1.6, "{alike}");
    }

    /// The scatter over many sets is that of so few independent values as are said.
    #[test]
    fn a_quartile_is_as_uncertain_as_is_said() {
        const SETS: u64 = 200;
        let squares: Vec<f64> = (0..SETS)
            .map(|seed| found([0.0, 0.0], seed).scale.powi(2))
            .collect();
        let mean = squares.iter().sum::<f64>() / SETS as f64;
        let variance = squares.iter().map(|s| (s / mean - 1.0).powi(2)).sum::<f64>() / SETS as f64;
        let said = 2.0 / found([0.0, 0.0], 0).values;
        assert!((0.7..1.4).contains(&(variance / said)), "{variance} of {said}");
    }

    #[test]
    fn frames_that_are_missing_make_no_jitter() {
        assert!(evenly_spaced(&[0.0, 0.1, 0.2, 0.3]) && evenly_spaced(&[0.0, 0.1, 0.21, 0.31]));
        assert!(!evenly_spaced(&[0.0, 0.1, 0.3, 0.4]));
        assert!(at_least(vec![1.0; FEWEST - 1]).is_none(), "too few");
    }
}
