//! Where markers are and how they move when a recording begins in motion.

use crate::demo::MarkerSample;
use nalgebra::{DMatrix, DVector};
use std::collections::BTreeMap;

/// How much of a recording tells how it begins, s, where its noise is [`USUAL_NOISE_M`]: short enough for a cubic to follow a
/// swing of 1 Hz to 0.01 m/s, long beside the time between frames, because the noise of two of them over that time is a
/// large velocity. A rope swung at 1.25 Hz by its clamp, seen by 12 markers 200 times a second with 1 mm of noise, leaves
/// 1.1 to 1.7 noise floors under its own parameters; started by its first two frames it left 3.4 to 10.
const USUAL_WINDOW_S: f64 = 0.14;
/// Noise of markers for which that is best, m.
const USUAL_NOISE_M: f64 = 1e-3;
/// How the best window grows with the noise: the slope's noise falls with the power 3/2 of the window, what a cubic cannot
/// follow grows with the third.
const WITH_NOISE: f64 = 1.0 / 4.5;
/// Fewest frames in it from which a cubic tells more than its first two: with fewer its slope at the end has more of their
/// noise than their difference. What was measured at 30 Hz left no less with a parabola through three (19.5 for 19.2 mm of a
/// rope held at both ends, 47.9 for 45.6 mm of a cable).
const LEAST_FRAMES: usize = 8;

/// How much of a recording with this noise tells how it begins, s.
pub fn beginning_s(noise_m: f64) -> f64 {
    USUAL_WINDOW_S * (noise_m / USUAL_NOISE_M).powf(WITH_NOISE)
}

/// Markers as they were seen at these times.
pub(super) fn seen(markers: &[MarkerSample], times_s: &[f64]) -> Vec<(f64, Vec<MarkerSample>)> {
    let at = |t_s: f64| markers.iter().filter(|m| m.t_s == t_s).cloned().collect();
    times_s.iter().map(|&t_s| (t_s, at(t_s))).collect()
}

/// Markers at the first frame, and where their first velocities would take them by the second, if there is one.
pub(super) fn first_two(
    markers: &[MarkerSample],
    times_s: &[f64],
    noise_m: f64,
) -> Vec<(f64, Vec<MarkerSample>)> {
    let wanted = &times_s[..times_s.len().min(2)];
    let window_s = beginning_s(noise_m);
    let window: Vec<f64> = times_s
        .iter()
        .copied()
        .filter(|t_s| t_s - times_s[0] <= window_s)
        .collect();
    if window.len() < LEAST_FRAMES {
        return seen(markers, wanted);
    }
    let mut tracks: BTreeMap<&str, Vec<&MarkerSample>> = BTreeMap::new();
    for sample in markers.iter().filter(|m| window.contains(&m.t_s)) {
        tracks.entry(&sample.marker).or_default().push(sample);
    }
    let tangents: Vec<(&MarkerSample, [[f64; 3]; 2])> = tracks
        .values()
        .filter(|track| track.len() >= LEAST_FRAMES)
        .map(|track| (track[0], tangent(track, times_s[0])))
        .collect();
    let at = |t_s: f64| {
        let place = |(sample, [place, rate]): &(&MarkerSample, [[f64; 3]; 2])| MarkerSample {
            t_s,
            position_m: std::array::from_fn(|k| place[k] + rate[k] * (t_s - times_s[0])),
            ..(*sample).clone()
        };
        tangents.iter().map(place).collect()
    };
    wanted.iter().map(|&t_s| (t_s, at(t_s))).collect()
}

/// Place, m, and velocity, m/s, at a time of the cubic that fits a track best.
fn tangent(track: &[&MarkerSample], at_s: f64) -> [[f64; 3]; 2] {
    let powers = DMatrix::from_fn(track.len(), 4, |i, k| (track[i].t_s - at_s).powi(k as i32));
    let solver = powers.svd(true, true);
    let mut found = [[0.0; 3]; 2];
    for axis in 0..3 {
        let places = DVector::from_fn(track.len(), |i, _| track[i].position_m[axis]);
        let cubic = solver.solve(&places, 0.0).expect("both bases are there");
        found[0][axis] = cubic[0];
        found[1][axis] = cubic[1];
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples(
        hertz: f64,
        count: usize,
        at: impl Fn(f64, usize) -> [f64; 3],
    ) -> (Vec<MarkerSample>, Vec<f64>) {
        let times_s: Vec<f64> = (0..count).map(|i| i as f64 / hertz).collect();
        let sample = |(&t_s, marker): (&f64, usize)| MarkerSample {
            t_s,
            marker: format!("m{marker}"),
            s_m: 0.1 * marker as f64,
            position_m: at(t_s, marker),
        };
        let markers = times_s
            .iter()
            .flat_map(|t_s| (0..3).map(move |marker| (t_s, marker)));
        (markers.map(sample).collect(), times_s)
    }

    /// On a cubic nothing is lost: the second place lies on its tangent.
    #[test]
    fn many_frames_tell_the_tangent_at_the_first() {
        let (markers, times_s) = samples(200.0, 30, |t, m| {
            [m as f64 + 0.5 * t, -3.0 * t * t, 1.0 - t + 5.0 * t * t * t]
        });
        let found = first_two(&markers, &times_s, 1e-3);
        for (t_s, places) in &found {
            assert_eq!(places.len(), 3);
            for (m, sample) in places.iter().enumerate() {
                let wanted = [m as f64 + 0.5 * t_s, 0.0, 1.0 - t_s];
                for (got, wanted) in sample.position_m.iter().zip(wanted) {
                    assert!((got - wanted).abs() < 1e-12, "{got}, not {wanted}");
                }
            }
        }
    }

    #[test]
    fn few_frames_are_taken_as_they_are() {
        let (markers, times_s) = samples(30.0, 30, |t, _| [(40.0 * t).sin(), 0.0, 0.0]);
        let found = first_two(&markers, &times_s, 1e-3);
        assert_eq!(found.len(), 2);
        assert_eq!([&found[0].1[..], &found[1].1[..]].concat(), markers[..6]);
    }

    /// Noise of 1 mm is a velocity of 0.28 m/s from two frames at 200 Hz.
    #[test]
    fn noise_is_a_small_velocity() {
        let noise = crate::bench_diagnosis::noise::correlated(200, 3, 1e-3, [0.0, 0.0], 7);
        let (mut square, mut count) = (0.0, 0);
        for first in 0..150 {
            let (markers, times_s) =
                samples(200.0, 40, |t, m| noise[first + (200.0 * t).round() as usize][m]);
            let [(_, from), (t_s, to)] = &first_two(&markers, &times_s, 1e-3)[..] else {
                panic!("two frames")
            };
            for (a, b) in from.iter().zip(to) {
                square += ((b.position_m[0] - a.position_m[0]) / t_s).powi(2);
                count += 1;
            }
        }
        let deviation_m_s = (square / f64::from(count)).sqrt();
        // The slope of a cubic at the end of 29 frames, by its normal equations: 41.3 σ per second.
        assert!((deviation_m_s - 0.0413).abs() < 0.01, "{deviation_m_s} m/s");
    }
}
