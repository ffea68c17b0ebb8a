//! Correlated sensor noise: autoregressive in time and along the rope, R_time ⊗ R_arc.

use crate::collect::{standard_normal, stream};

/// Correlation of the noise with the frame before, and with the neighbouring marker: smoothing inside a
/// depth camera and slowly changing errors of calibration.
pub const CORRELATION: [f64; 2] = [0.6, 0.7];

/// Displacements by frame, station and axis, m, each of standard deviation `sigma_m`; `correlation` is
/// that in time and along the rope.
pub fn correlated(
    frames: usize,
    stations: usize,
    sigma_m: f64,
    correlation: [f64; 2],
    seed: u64,
) -> Vec<Vec<[f64; 3]>> {
    let mut random = stream(seed, 0);
    let fresh = correlation.map(|r| (1.0 - r * r).sqrt());
    let mut frames_m: Vec<Vec<[f64; 3]>> = Vec::with_capacity(frames);
    for _ in 0..frames {
        let mut line: Vec<[f64; 3]> = Vec::with_capacity(stations);
        for _ in 0..stations {
            let own: [f64; 3] = std::array::from_fn(|_| sigma_m * standard_normal(&mut random));
            line.push(match line.last() {
                None => own,
                Some(before) => std::array::from_fn(|k| correlation[1] * before[k] + fresh[1] * own[k]),
            });
        }
        if let Some(before) = frames_m.last() {
            for (now, earlier) in line.iter_mut().zip(before) {
                for k in 0..3 {
                    now[k] = correlation[0] * earlier[k] + fresh[0] * now[k];
                }
            }
        }
        frames_m.push(line);
    }
    frames_m
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_noise_is_as_large_and_as_alike_as_asked() {
        let noise = correlated(400, 40, 0.002, [0.6, 0.7], 3);
        let (mut square, mut later, mut beside, mut n) = (0.0, 0.0, 0.0, 0.0);
        for f in 1..400 {
            for s in 1..40 {
                for k in 0..3 {
                    square += noise[f][s][k].powi(2);
                    later += noise[f][s][k] * noise[f - 1][s][k];
                    beside += noise[f][s][k] * noise[f][s - 1][k];
                    n += 1.0;
                }
            }
        }
        // About 2,100 independent numbers: 1.5 % of the standard deviation, four of them.
        assert!(((square / n).sqrt() / 0.002 - 1.0).abs() < 0.06);
        assert!((later / square - 0.6).abs() < 0.06);
        assert!((beside / square - 0.7).abs() < 0.06);
    }
}
