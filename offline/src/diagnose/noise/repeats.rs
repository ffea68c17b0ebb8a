//! Noise by what recordings of one motion that was repeated differ by: what cameras, robot and rope do not do again.
//!
//! Offsets from a model are compared, each at its own time: what the model is off by is the same in both.

use super::MIN_FRAMES;
use super::series::{Series, in_frame, offset_along};
use crate::demo::{Demo, pose_at};
use crate::fit::{Evaluation, Problem};
use crate::observe::{Row, station_arcs_m};
use nalgebra::Vector3;

/// Series of what those recordings of a problem differ by that repeat each other, each and the last before it that it
/// repeats: so many series tell as much as that many independent differences.
pub(super) fn repeat_series(problem: &Problem, evaluation: &Evaluation) -> Vec<Series> {
    let demos = &problem.demos;
    let mut found = Vec::new();
    for j in 1..demos.len() {
        let Some(i) = (0..j).rfind(|&i| repeats(demos[i], demos[j])) else {
            continue;
        };
        let seen = |d: usize| (&evaluation.rows[d][..], &problem.scenes[d].frame_times_s[..]);
        for station in 0..station_arcs_m(demos[i]).len() {
            found.extend(differences(seen(i), seen(j), station, problem.noise_scale));
        }
    }
    found
}

/// Whether two recordings are of one motion: the same rope, held the same way and led within the noise along the same path.
/// One that was copied repeats nothing.
fn repeats(a: &Demo, b: &Demo) -> bool {
    let set_up = |demo: &Demo| {
        (
            demo.spec.scene,
            demo.spec.start,
            demo.spec.planar,
            demo.clamps.len(),
        )
    };
    let alike = set_up(a) == set_up(b)
        && a.spec.rope == b.spec.rope
        && a.spec.clamps == b.spec.clamps
        && a.spec.table == b.spec.table;
    if !alike || a.spec.is_static() || a.observations == b.observations {
        return false;
    }
    let near_m = a.spec.noise_m.max(b.spec.noise_m);
    let (times, others) = (a.times_s(), b.times_s());
    let until_s = others.last().copied().unwrap_or(0.0);
    let led_alike = |t_s: f64| {
        a.clamps.iter().zip(&b.clamps).all(|(one, other)| {
            let (one, other) = (pose_at(one, t_s), pose_at(other, t_s));
            let apart_m = (Vector3::from(one.position_m) - Vector3::from(other.position_m)).norm();
            let turned_m = one.turn().angle_to(&other.turn()) * a.spec.rope.length_m;
            one.closed == other.closed && apart_m <= near_m && turned_m <= near_m
        })
    };
    times.into_iter().take_while(|&t_s| t_s <= until_s).all(led_alike)
}

/// What two recordings differ by at a station, over what their declared standard errors make of it, in the frames in which
/// both saw it; along directions that hold until the rope has turned too much.
fn differences(
    (one, times_s): (&[Row], &[f64]),
    (other, other_times_s): (&[Row], &[f64]),
    station: usize,
    scale: f64,
) -> Vec<Series> {
    let here: Vec<&Row> = one.iter().filter(|row| row.station == station).collect();
    let there: Vec<&Row> = other.iter().filter(|row| row.station == station).collect();
    let difference = |direction: &[f64; 3], frame: usize| {
        let twin = nearest(other_times_s, times_s[frame])?;
        let (a_m, a) = offset_along(&here, direction, frame)?;
        let (b_m, b) = offset_along(&there, direction, twin)?;
        Some(scale * (a_m - b_m) / (a + b).sqrt())
    };
    let from = |axis: &Row| {
        let rest = axis.frame..times_s.len();
        let places: Vec<f64> = rest
            .map_while(|frame| difference(&axis.direction, frame))
            .collect();
        Series {
            station,
            first: axis.frame,
            direction: axis.direction,
            per_metre: vec![0.0; places.len()],
            places,
        }
    };
    let (mut found, mut frame) = (Vec::new(), 0);
    while frame < times_s.len() {
        let runs: Vec<Series> = in_frame(&here, frame).iter().map(|axis| from(axis)).collect();
        frame += runs.iter().map(|run| run.places.len()).fold(1, usize::max);
        found.extend(runs.into_iter().filter(|run| run.places.len() >= MIN_FRAMES));
    }
    found
}

/// The frame of another recording at a time, if it has one within half of what lies between its frames there.
fn nearest(times_s: &[f64], t_s: f64) -> Option<usize> {
    let after = times_s.partition_point(|&other_s| other_s < t_s);
    let around = after.saturating_sub(1)..(after + 1).min(times_s.len());
    let near = around.min_by(|&a, &b| {
        let apart_s = |k: usize| (times_s[k] - t_s).abs();
        apart_s(a).total_cmp(&apart_s(b))
    })?;
    let beside = near.checked_sub(1).map_or(near + 1, |before| before);
    let period_s = (times_s.get(beside)? - times_s[near]).abs();
    ((times_s[near] - t_s).abs() <= 0.5 * period_s).then_some(near)
}

#[cfg(test)]
mod tests {
    use super::super::tests::{FRAMES, STATIONS, rows_of};
    use super::super::{Noise, NoiseSource};
    use super::*;
    use crate::bench_diagnosis::noise::correlated;
    use crate::demo::{Demo, Observations};
    use std::path::Path;

    const PERIOD_S: f64 = 0.03;

    /// Two recordings of noise of twice the declared size with correlations 0.6 and 0.7, not in step, of a rope that the model
    /// misses by centimetres: what they differ by tells all three within three of their own scatters.
    #[test]
    fn size_and_correlation_are_found_in_repeats() {
        const SETS: u64 = 40;
        let (mut scales, mut times, mut alongs) = (0.0, 0.0, 0.0);
        for seed in 0..SETS {
            let recorded = |which: u64| {
                let noise = correlated(FRAMES, STATIONS, 0.002, [0.6, 0.7], 2 * seed + which);
                let mut rows = rows_of(&noise, FRAMES);
                for row in &mut rows {
                    row.offset_m += 0.03 * (0.3 * row.frame as f64).sin();
                }
                rows
            };
            let (one, other) = (recorded(0), recorded(1));
            let clock =
                |late_s: f64| -> Vec<f64> { (0..FRAMES).map(|k| PERIOD_S * k as f64 + late_s).collect() };
            let (own, others) = (clock(0.0), clock(0.2 * PERIOD_S));
            let series: Vec<Series> = (0..STATIONS)
                .flat_map(|station| differences((&one, &own), (&other, &others), station, 1.0))
                .collect();
            let found = Noise::of_series(&series, NoiseSource::Repeats).expect("frames that both saw");
            scales += found.scale / SETS as f64;
            times += found.in_time / SETS as f64;
            alongs += found.along_rope / SETS as f64;
        }
        assert!((scales - 2.0).abs() < 0.1, "{scales}");
        assert!((times - 0.6).abs() < 0.03, "{times}");
        assert!((alongs - 0.7).abs() < 0.03, "{alongs}");
    }

    #[test]
    fn a_recording_repeats_one_that_was_led_alike_and_seen_anew() {
        let load = |name: &str| {
            let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("demos/sample-rope");
            Demo::load(folder.join(name)).unwrap()
        };
        let demo = load("fit");
        let seen_anew = |of: &Demo| {
            let mut again = of.clone();
            let Observations::Clouds(frames) = &mut again.observations else {
                panic!("clouds");
            };
            frames.pop();
            again
        };
        let again = seen_anew(&demo);
        assert!(repeats(&demo, &again) && repeats(&again, &demo));
        assert!(!repeats(&demo, &demo.clone()), "a copy");
        assert!(!repeats(&demo, &load("held-out-1")), "another motion");
        let mut elsewhere = seen_anew(&demo);
        elsewhere.clamps[0]
            .iter_mut()
            .for_each(|sample| sample.position_m[1] += 0.005);
        assert!(!repeats(&demo, &elsewhere), "led 5 mm aside");
        let mut other_rope = seen_anew(&demo);
        other_rope.spec.rope.mass_kg *= 2.0;
        assert!(!repeats(&demo, &other_rope), "another rope");
    }

    #[test]
    fn frames_are_compared_with_those_at_the_same_time() {
        let times_s = [0.0, 0.1, 0.2, 0.5];
        let found = [-0.04, 0.06, 0.1, 0.26, 0.34, 0.36, 0.8].map(|t_s| nearest(&times_s, t_s));
        assert_eq!(found, [Some(0), Some(1), Some(1), None, None, Some(3), None]);
        assert_eq!(nearest(&[], 0.0), None);
    }
}
