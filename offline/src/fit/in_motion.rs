//! Ropes that are first seen in motion: where they begin and how fast, so that the simulated rope passes its first frames
//! among what was seen.
//!
//! Two frames say where the rope was half a frame later, and how fast on the way there: a cable let go before cameras at
//! 30 Hz began with 0.13 m/s that it came to have within the first frame, and was 45 mm off a quarter of a second later. What
//! the rope does meanwhile its model knows. So a start is corrected by the line through what the simulated rope leaves in
//! the frames at the beginning, marker by marker, until little is left of it. Slopes take a start as it then
//! is. That noise moved it, and with it what was fitted, is in the standard errors: the start is made anew as often as these
//! frames are seen again with noise of the same size (parametric bootstrap, Efron 1979).

use super::problem::{FitError, Problem, simulation};
use crate::collect::{standard_normal, stream};
use crate::demo::{Demo, MarkerSample, Observations};
use crate::model::Structure;
use crate::observe::{bracket, interpolate, marker_axes};
use crate::sim::rest::settle_poses;
use crate::sim::start::{Amends, Start, beginning_s};
use crate::sim::tensor::dot;
use crate::sim::{Rollout, Scene};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Fewest frames at the beginning: a line through two leaves nothing.
const FEWEST_FRAMES: usize = 3;
/// How much of what tells a cubic how a recording begins these are: a velocity moves a rope on only until it bends back, and
/// a correction that looks longer overshoots.
const SHARE: f64 = 0.7;
/// Most times that a start is corrected.
const MOST_TIMES: usize = 10;
/// Corrections that move the rope by less than this share of the noise within those frames are none.
const SMALL: f64 = 0.1;
/// How often such a demonstration is seen again: twelve tell a standard error to a fifth.
const SEEN_AGAIN: u64 = 12;

/// Offset of a marker from the simulated rope at a time.
type Offset = (f64, [f64; 3]);

impl Problem<'_> {
    /// Whether a demonstration begins in motion, and its first frames can be seen.
    fn begins_in_motion(&self, d: usize) -> bool {
        let seen = self.scenes[d].frame_times_s.len();
        matches!(self.scenes[d].start, Start::Moving(_)) && seen >= FEWEST_FRAMES
    }

    /// Whether any does.
    pub(super) fn some_begin_in_motion(&self) -> bool {
        (0..self.demos.len()).any(|d| self.begins_in_motion(d))
    }

    /// Corrects the start of a demonstration's settled scene where that is in motion.
    ///
    /// # Errors
    /// Its first frames cannot be simulated.
    pub(super) fn begin_as_seen(
        &self,
        d: usize,
        scene: &mut Scene,
        structure: &Structure,
        theta: &[f64],
    ) -> Result<(), FitError> {
        let (true, Observations::Markers(markers)) = (self.begins_in_motion(d), &self.demos[d].observations)
        else {
            return Ok(());
        };
        let mut early = self.beginning(d, scene.clone());
        let small_m = SMALL * self.demos[d].spec.noise_m;
        let mut best = f64::INFINITY;
        for _ in 0..=MOST_TIMES {
            let rollout = early.predict_under(0, structure, theta, None)?;
            let left = early.left(markers, &rollout);
            let square: f64 = left
                .values()
                .flat_map(|(_, track)| track)
                .map(|(_, o)| dot(*o, *o))
                .sum();
            if square >= best {
                break;
            }
            best = square;
            scene.start = early.scenes[0].start.clone();
            let last_s = early.scenes[0].duration_s;
            let amends: Vec<Amends> = left
                .into_values()
                .map(|(arc_m, track)| line(arc_m, &track))
                .collect();
            if amends.iter().all(|one| one.farthest_m(last_s) < small_m) {
                break;
            }
            let physics = early.physics(0, structure, theta);
            early.scenes[0].start.amend(&amends);
            settle_poses(&mut early.scenes[0], &physics)
                .map_err(|error| simulation(early.demos[0], error))?;
        }
        Ok(())
    }

    /// Predictions of a settled problem where its starts in motion are those of other noise, once for each draw; the usual
    /// ones of what begins at rest. None where nothing begins in motion.
    ///
    /// # Errors
    /// One cannot be simulated.
    pub(super) fn begun_again(
        &self,
        structure: &Structure,
        theta: &[f64],
        usual: &[Rollout<f32>],
    ) -> Result<Vec<Vec<Rollout<f32>>>, FitError> {
        let moving: Vec<usize> = (0..self.demos.len())
            .filter(|&d| self.begins_in_motion(d))
            .collect();
        if moving.is_empty() {
            return Ok(Vec::new());
        }
        let once = |time: u64| {
            let noisy: Vec<Demo> = moving.iter().map(|&d| self.seen_again(d, time)).collect();
            let again = Problem {
                demos: noisy.iter().collect(),
                scenes: moving
                    .iter()
                    .zip(&noisy)
                    .map(|(&d, demo)| begun_as(&self.scenes[d], demo))
                    .collect(),
                refinement: None,
                ..*self
            };
            let mut there = usual.to_vec();
            for (&d, rollout) in moving.iter().zip(again.predict(structure, theta)?) {
                there[d] = rollout;
            }
            Ok(there)
        };
        (0..SEEN_AGAIN).into_par_iter().map(once).collect()
    }

    /// A demonstration by markers with as much noise again.
    fn seen_again(&self, d: usize, time: u64) -> Demo {
        let mut demo = self.demos[d].clone();
        let noise_m = self.noise_scale * demo.spec.noise_m;
        let axes = marker_axes(self.demos[d]);
        let mut random = stream(time, d as u64);
        if let Observations::Markers(samples) = &mut demo.observations {
            for sample in samples {
                for &k in axes {
                    sample.position_m[k] += noise_m * standard_normal(&mut random);
                }
            }
        }
        demo
    }

    /// The first frames of a demonstration's scene alone.
    fn beginning(&self, d: usize, mut scene: Scene) -> Self {
        let window_s = SHARE * beginning_s(self.demos[d].spec.noise_m);
        let first_s = scene.frame_times_s[0];
        let frames = scene
            .frame_times_s
            .partition_point(|t_s| t_s - first_s <= window_s);
        scene.frame_times_s.truncate(frames.max(FEWEST_FRAMES));
        scene.duration_s = scene.frame_times_s.last().copied().unwrap_or(0.0);
        Self {
            demos: vec![self.demos[d]],
            scenes: vec![scene],
            refinement: None,
            ..*self
        }
    }

    /// What the simulated rope leaves of each marker in these frames, by its arc length, m.
    fn left<'m>(
        &self,
        markers: &'m [MarkerSample],
        rollout: &Rollout<f32>,
    ) -> BTreeMap<&'m str, (f64, Vec<Offset>)> {
        let axes = marker_axes(self.demos[0]);
        let mut tracks: BTreeMap<&str, (f64, Vec<Offset>)> = BTreeMap::new();
        for (t_s, line) in self.scenes[0].frame_times_s.iter().zip(&rollout.frames) {
            for sample in markers.iter().filter(|m| m.t_s == *t_s) {
                let there = interpolate(line, bracket(&rollout.arc_m, sample.s_m));
                let mut offset_m = [0.0; 3];
                for &k in axes {
                    offset_m[k] = sample.position_m[k] - there[k];
                }
                let track = tracks.entry(&sample.marker).or_insert((sample.s_m, Vec::new()));
                track.1.push((*t_s, offset_m));
            }
        }
        tracks.retain(|_, (_, track)| track.len() >= FEWEST_FRAMES);
        tracks
    }
}

/// A scene that begins as another demonstration of it says.
fn begun_as(scene: &Scene, demo: &Demo) -> Scene {
    let mut start = Start::of_demo(demo, &scene.rope, &scene.grips);
    start.begin_near(&scene.start);
    Scene {
        start,
        ..scene.clone()
    }
}

/// The line through offsets by least squares.
fn line(arc_m: f64, track: &[Offset]) -> Amends {
    let count = track.len() as f64;
    let mean_s = track.iter().map(|(t_s, _)| t_s).sum::<f64>() / count;
    let spread: f64 = track.iter().map(|(t_s, _)| (t_s - mean_s).powi(2)).sum();
    let axis = |k: usize| {
        let mean = track.iter().map(|(_, o)| o[k]).sum::<f64>() / count;
        let slope = track.iter().map(|(t_s, o)| (t_s - mean_s) * o[k]).sum::<f64>() / spread;
        [mean - slope * mean_s, slope]
    };
    let found: [[f64; 2]; 3] = std::array::from_fn(axis);
    Amends {
        arc_m,
        offset_m: found.map(|[offset, _]| offset),
        velocity_m_s: found.map(|[_, slope]| slope),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_found_whatever_its_times_are() {
        let track: Vec<Offset> = [0.2, 0.25, 0.5].map(|t| (t, [0.1 + 2.0 * t, -t, 0.0])).into();
        let found = line(0.3, &track);
        for (got, wanted) in found
            .offset_m
            .iter()
            .chain(&found.velocity_m_s)
            .zip([0.1, 0.0, 0.0, 2.0, -1.0, 0.0])
        {
            assert!((got - wanted).abs() < 1e-12, "{found:?}");
        }
        assert!((found.farthest_m(0.5) - 1.1f64.hypot(0.5)).abs() < 1e-12);
    }
}
