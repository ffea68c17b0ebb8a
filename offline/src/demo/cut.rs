//! A part of a demonstration in time, as a demonstration of its own.

use super::plausible::{clock_problem, span};
use super::{ClampSample, Demo, DemoError, Observations, SceneKind, StartState};
use nalgebra::Vector3;
use std::path::Path;

impl Demo {
    /// What was seen from `from_s` to `to_s`. A part that leaves out the beginning is a `free` scene whose times begin
    /// at zero with its first frame; the rope starts as `start` says. One that keeps it begins at zero where the
    /// recording's clock began elsewhere, as a robot's does. Clamps that hold nothing any more are left out.
    ///
    /// # Errors
    /// Nothing was seen in that time, or a clamp closes in a part that leaves out the beginning: where it then grips
    /// the rope is only known from there; or the rope moves where the part begins, and clouds do not say how fast; or it
    /// is said to rest while a clamp moves.
    pub fn cut(&self, from_s: f64, to_s: f64, start: StartState) -> Result<Self, DemoError> {
        let fail =
            |problem: String, remedy: &str| Err(DemoError::new(Path::new(&self.name), problem, remedy));
        let times = self.times_s();
        let kept = |t_s: f64| t_s >= from_s && t_s <= to_s;
        let (Some(&first_s), Some(&last_s)) = (
            times.iter().find(|&&t_s| kept(t_s)),
            times.iter().rfind(|&&t_s| kept(t_s)),
        ) else {
            let (begin, end) = (times.first().unwrap_or(&0.0), times.last().unwrap_or(&0.0));
            return fail(
                format!("nothing was seen from {from_s} to {to_s} s"),
                &format!("choose times between {begin} and {end} s"),
            );
        };
        let mut part = self.clone();
        part.keep_frames(&kept);
        let whole = !self.spec.is_static() && Some(&first_s) == times.first();
        if whole {
            part.keep_paths(f64::NEG_INFINITY, last_s);
            part.set_clock();
            return Ok(part);
        }
        for (index, path) in self.clamps.iter().enumerate() {
            let open = path.iter().rfind(|s| s.t_s <= first_s).is_some_and(|s| !s.closed);
            let closes = |s: &ClampSample| s.closed && s.t_s > first_s && s.t_s <= last_s;
            if open && path.iter().any(closes) {
                return fail(
                    format!("clamp {index} closes between {first_s} and {last_s} s"),
                    "keep the beginning of the recording, or begin where the clamp holds",
                );
            }
        }
        let clouds = matches!(self.observations, Observations::Clouds(_));
        if clouds && !self.spec.is_static() && start == StartState::Moving {
            return fail(
                format!("the part begins at {first_s} s, and how fast a rope moves there, clouds do not say"),
                "keep the beginning of the recording, or begin where the rope hangs still and say --start rest",
            );
        }
        part.keep_paths(first_s, last_s);
        part.turn_directions(self);
        part.drop_open_clamps();
        if !self.spec.is_static() {
            if part.clamps.is_empty() {
                return fail(
                    format!("no clamp holds the rope at {first_s} s"),
                    "begin where one does: what a rope does that is let go is simulated from before that",
                );
            }
            part.spec.scene = SceneKind::Free;
            part.spec.start = start;
            part.shift(-first_s);
            // The first frame of a clamp that moves counts as one at rest.
            if start == StartState::Rest && part.rest_frames(&part.times_s()) < 2 {
                return fail(
                    format!("a clamp moves at {first_s} s, where the rope is said to rest"),
                    "begin where the clamps stand still and the rope has come to rest",
                );
            }
        } else {
            part.set_clock();
        }
        Ok(part)
    }

    fn keep_frames(&mut self, kept: &dyn Fn(f64) -> bool) {
        match &mut self.observations {
            Observations::Clouds(frames) => frames.retain(|frame| kept(frame.t_s)),
            Observations::Markers(samples) => samples.retain(|sample| kept(sample.t_s)),
        }
    }

    /// Paths begin with a sample at `first_s` and end with the first at or after `last_s`.
    fn keep_paths(&mut self, first_s: f64, last_s: f64) {
        let commanded = self.commanded.iter_mut().flatten();
        for path in self.clamps.iter_mut().chain(commanded) {
            let end = path.partition_point(|sample| sample.t_s < last_s);
            path.truncate(end + 1);
            let begin = path.partition_point(|sample| sample.t_s <= first_s);
            if begin == 0 {
                continue;
            }
            let before = path[begin - 1];
            path.drain(..begin - 1);
            path[0] = match path.get(1) {
                Some(after) if before.t_s < first_s => between(&before, after, first_s),
                _ => ClampSample {
                    t_s: first_s,
                    ..before
                },
            };
        }
    }

    /// Declared directions are those at the first samples, which are others than in `whole`.
    fn turn_directions(&mut self, whole: &Self) {
        for index in (0..self.clamps.len()).rev() {
            let since = self.clamps[index][0].turn() * whole.clamps[index][0].turn().inverse();
            let turned = |direction: [f64; 3]| (since * Vector3::from(direction)).into();
            let declared = self.spec.clamps[index]
                .direction
                .unwrap_or(whole.spec.rope.direction);
            self.spec.clamps[index].direction = Some(turned(declared));
            if index == 0 {
                self.spec.rope.direction = turned(whole.spec.rope.direction);
            }
        }
    }

    fn drop_open_clamps(&mut self) {
        for index in (0..self.clamps.len()).rev() {
            if self.clamps[index].iter().all(|sample| !sample.closed) {
                self.clamps.remove(index);
                self.commanded.remove(index);
                self.spec.clamps.remove(index);
            }
        }
    }

    /// Lets times that a simulation would not follow begin at zero.
    fn set_clock(&mut self) {
        if clock_problem(self).is_some() {
            self.shift(-span(self).first_s);
        }
    }

    fn shift(&mut self, by_s: f64) {
        let commanded = self.commanded.iter_mut().flatten();
        for sample in self.clamps.iter_mut().chain(commanded).flatten() {
            sample.t_s += by_s;
        }
        match &mut self.observations {
            Observations::Clouds(frames) => frames.iter_mut().for_each(|frame| frame.t_s += by_s),
            Observations::Markers(samples) => samples.iter_mut().for_each(|sample| sample.t_s += by_s),
        }
    }
}

/// The pose of a clamp at a time; that of its path's nearer end outside it.
pub fn pose_at(path: &[ClampSample], t_s: f64) -> ClampSample {
    let after = path.partition_point(|sample| sample.t_s <= t_s);
    match (after.checked_sub(1).map(|before| path[before]), path.get(after)) {
        (Some(before), Some(after)) => between(&before, after, t_s),
        (Some(last), None) => last,
        (None, _) => path[0],
    }
}

/// The pose at a time between two samples.
fn between(before: &ClampSample, after: &ClampSample, t_s: f64) -> ClampSample {
    let share = (t_s - before.t_s) / (after.t_s - before.t_s);
    let at = |k: usize| before.position_m[k] * (1.0 - share) + after.position_m[k] * share;
    // The two directions of a half turn are equally short; either will do.
    let turned = before.turn().try_slerp(&after.turn(), share, 1e-9);
    ClampSample {
        t_s,
        position_m: [at(0), at(1), at(2)],
        quaternion_xyzw: turned.unwrap_or_else(|| before.turn()).coords.into(),
        closed: before.closed,
    }
}
