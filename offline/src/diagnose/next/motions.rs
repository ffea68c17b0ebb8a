//! What an engineer with the same rig can do next: a small family of motions around the one that was
//! recorded, each as a demonstration in which nothing was seen yet. They are in the order of the effort that
//! they take.

use crate::demo::{ClampSample, Demo, MarkerSample, Observations, RopeEnd, SceneKind, StartState};
use shared::profile::{LineProfile, MotionLimits};

/// A motion that could be recorded next.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// Short name.
    pub id: &'static str,
    /// What to do, as an order.
    pub words: String,
    /// The demonstration; its markers stand for the places along the rope that would be seen.
    pub demo: Demo,
}

/// The places along the rope that are seen, and where they are at first.
#[derive(Clone, Copy, Debug)]
pub struct Places<'a> {
    /// Arc lengths, m, increasing.
    pub arcs_m: &'a [f64],
    /// Positions at the first instant, m.
    pub first_m: &'a [[f64; 3]],
}

/// Least motion of a clamp that counts, m or parts of a quaternion.
const MOVED: f64 = 1e-4;
/// Fastest gripper, m/s: below the 1 m/s at which the arm's box stops.
const FASTEST_M_S: f64 = 0.9;
/// How much slower and faster the motion is tried.
const SPEED_FACTOR: f64 = 2.0;
/// Least change of speed that is worth a recording.
const LEAST_FACTOR: f64 = 1.3;
/// How long a pose is held, s.
const HOLD_S: f64 = 1.5;
/// Rest before the gripper does something else, s.
const PAUSE_S: f64 = 0.3;
/// Length of the stroke that makes the rope ring, m.
const STROKE_M: f64 = 0.08;
/// How long it is seen ringing, s.
const RINGING_S: f64 = 1.5;
/// The stroke: well within the arm's limits.
const STROKE: MotionLimits = MotionLimits {
    speed_m_s: 0.8,
    acceleration_m_s2: 10.0,
    jerk_m_s3: 300.0,
};
/// How long a fall is seen, s.
const FALL_S: f64 = 0.15;
/// Known mass that is added, as a share of the rope's.
const ADDED_SHARE: f64 = 0.25;

/// The motions that can be made in place of a recorded one, which is slowed down where the arm cannot move as fast.
///
/// # Errors
/// No other motion can be made of this recording; says why.
pub fn family(demo: &Demo, places: Places) -> Result<Vec<Candidate>, &'static str> {
    let recorded = Recording::new(demo, places)?;
    let slower = recorded.peak_m_s / FASTEST_M_S;
    let slowed = recorded.replay(slower, 1.0, 0.0);
    let recording = if slower > 1.0 {
        let name = format!("{} at {:.1} times its speed", recorded.name, 1.0 / slower);
        Recording {
            name,
            slowed: true,
            ..Recording::new(&slowed, places)?
        }
    } else {
        recorded
    };
    let mut found = recording.timings();
    found.extend(recording.holds());
    found.extend(recording.endings());
    found.extend(recording.set_ups());
    Ok(found)
}

/// A recording and when what happens in it.
struct Recording<'a> {
    demo: &'a Demo,
    places: Places<'a>,
    /// What people call the motion.
    name: String,
    /// Whether it is slower than the recorded one.
    slowed: bool,
    /// Until when nothing moves, s.
    rest_s: f64,
    /// When the last motion of a closed clamp has ended, s.
    still_s: f64,
    /// When a clamp opens, s.
    opens_s: Option<f64>,
    /// Time between frames and between samples of the clamps, s.
    frame_s: f64,
    clamp_s: f64,
    peak_m_s: f64,
}

fn differ(a: &ClampSample, b: &ClampSample) -> bool {
    (0..3).any(|k| (a.position_m[k] - b.position_m[k]).abs() > MOVED)
        || (0..4).any(|k| (a.quaternion_xyzw[k] - b.quaternion_xyzw[k]).abs() > MOVED)
}

/// The middle one of the steps between rising times.
fn middle_step(times: &[f64]) -> Option<f64> {
    let mut steps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    steps.sort_by(f64::total_cmp);
    steps.get(steps.len() / 2).copied()
}

impl<'a> Recording<'a> {
    fn new(demo: &'a Demo, places: Places<'a>) -> Result<Self, &'static str> {
        if demo.spec.is_static() {
            return Err("the demonstration is a row of poses at rest, without a motion that could be varied");
        }
        if demo.spec.start == StartState::Moving {
            return Err("the demonstration starts in motion, which cannot be repeated otherwise");
        }
        let frame_s = middle_step(&demo.times_s()).ok_or("the demonstration has one frame only")?;
        let (mut rest_s, mut still_s, mut peak_m_s) = (f64::INFINITY, 0.0f64, 0.0f64);
        let (mut opens_s, mut clamp_s): (Option<f64>, _) = (None, f64::INFINITY);
        for path in &demo.clamps {
            let opens = path.iter().position(|s| !s.closed);
            let closed = &path[..opens.unwrap_or(path.len())];
            let (Some(first), Some(last)) = (closed.first(), closed.last()) else {
                return Err("a clamp never holds the rope");
            };
            if let Some(index) = opens {
                let earlier = opens_s.unwrap_or(f64::INFINITY);
                opens_s = Some(path[index].t_s.min(earlier));
            }
            let leaves = closed.windows(2).find(|pair| differ(&pair[1], first));
            rest_s = leaves.map_or(rest_s, |pair| rest_s.min(pair[0].t_s));
            let stops = closed.windows(2).rev().find(|pair| differ(&pair[0], last));
            still_s = stops.map_or(still_s, |pair| still_s.max(pair[1].t_s));
            for pair in closed.windows(2) {
                let way = (0..3).map(|k| (pair[1].position_m[k] - pair[0].position_m[k]).powi(2));
                peak_m_s = peak_m_s.max(way.sum::<f64>().sqrt() / (pair[1].t_s - pair[0].t_s));
            }
            let times: Vec<f64> = path.iter().map(|s| s.t_s).collect();
            clamp_s = clamp_s.min(middle_step(&times).unwrap_or(f64::INFINITY));
        }
        if !rest_s.is_finite() || peak_m_s <= 0.0 {
            return Err("the gripper does not move in the demonstration, so there is no motion to vary");
        }
        let name = if demo.spec.scene == SceneKind::Lift {
            "lift"
        } else {
            "motion"
        };
        Ok(Self {
            demo,
            places,
            name: name.into(),
            slowed: false,
            rest_s,
            still_s,
            opens_s,
            frame_s,
            clamp_s,
            peak_m_s,
        })
    }

    fn candidate(&self, id: &'static str, words: String, mut demo: Demo) -> Candidate {
        demo.name = id.into();
        Candidate { id, words, demo }
    }

    /// The same motion, as it was, slower and faster.
    fn timings(&self) -> Vec<Candidate> {
        let name = &self.name;
        let words = format!("repeat the {name}{}", if self.slowed { "" } else { " as it was" });
        let mut found = vec![self.candidate("repeat", words, self.replay(1.0, 1.0, 0.0))];
        let faster = SPEED_FACTOR.min(FASTEST_M_S / self.peak_m_s);
        let speeds = [("slower", 1.0 / SPEED_FACTOR), ("faster", faster)];
        for (id, factor) in speeds {
            if id == "faster" && factor < LEAST_FACTOR {
                continue;
            }
            let times = match factor {
                0.5 => "half".into(),
                2.0 => "twice".into(),
                other => format!("{other:.1} times"),
            };
            let words = format!(
                "repeat the {name} at {times} the speed, at most {:.2} m/s",
                factor * self.peak_m_s
            );
            found.push(self.candidate(id, words, self.replay(1.0 / factor, 1.0, 0.0)));
        }
        found
    }

    /// Poses held still.
    fn holds(&self) -> Vec<Candidate> {
        let name = &self.name;
        let top = format!("repeat the {name} and hold still at its end, seen for {HOLD_S} s more");
        let low = format!("make the {name} only half as far and hold still there, seen for {HOLD_S} s");
        vec![
            self.candidate("hold", top, self.replay(1.0, 1.0, HOLD_S)),
            self.candidate("hold_half_way", low, self.replay(1.0, 0.5, HOLD_S)),
        ]
    }

    /// Other ends of the motion: the rope rings, or is let go.
    fn endings(&self) -> Vec<Candidate> {
        let name = &self.name;
        let words = format!(
            "repeat the {name}, wait, jerk the gripper {:.0} mm sideways and watch the rope ring for {RINGING_S} s",
            1e3 * STROKE_M
        );
        let mut found = vec![self.candidate("ring_down", words, self.ring_down())];
        if self.demo.clamps.len() == 1 {
            found.push(match self.opens_s {
                None => {
                    let words = format!("repeat the {name}, open the gripper at its end and record the fall");
                    self.candidate("release", words, self.release())
                }
                Some(_) => {
                    let words = format!("make the {name} only half as far before the gripper opens");
                    self.candidate("release_half_way", words, self.replay(1.0, 0.5, 0.0))
                }
            });
        }
        found
    }

    /// The same motion with the rig or the rope set up in another way.
    fn set_ups(&self) -> Vec<Candidate> {
        let name = &self.name;
        let plain = || self.replay(1.0, 1.0, 0.0);
        let mut found = Vec::new();
        for (id, degrees) in [("turned", 180.0f64), ("turned_quarter", 90.0)] {
            let words = format!(
                "turn rope and motion by {degrees:.0} degrees about the vertical, leave the cameras, and repeat the {name}"
            );
            found.push(self.candidate(id, words, turned(plain(), degrees.to_radians())));
        }
        for (id, degrees) in [("rolled", 180.0f64), ("rolled_quarter", 90.0)] {
            let mut demo = plain();
            demo.spec.rope.roll_rad += degrees.to_radians();
            let words = format!(
                "roll the rope by {degrees:.0} degrees about its own axis before it is gripped, and repeat the {name}"
            );
            found.push(self.candidate(id, words, demo));
        }
        if self
            .demo
            .spec
            .clamps
            .iter()
            .all(|clamp| clamp.end != RopeEnd::End)
        {
            let mut demo = plain();
            let added_kg = round_mass_kg(ADDED_SHARE * demo.spec.rope.mass_kg);
            demo.spec.rope.end_mass_kg += added_kg;
            let words = format!(
                "fix a known mass of {} g to the rope's free end and repeat the {name}",
                1e3 * added_kg
            );
            found.push(self.candidate("weighted", words, demo));
        }
        found
    }

    /// The recorded motion with its duration multiplied, its way multiplied, and a rest after it.
    fn replay(&self, slower: f64, way: f64, hold_s: f64) -> Demo {
        let moving_s = self.still_s - self.rest_s;
        let later_s = moving_s * (slower - 1.0);
        let time = |t_s: f64| {
            if t_s <= self.rest_s {
                t_s
            } else if t_s <= self.still_s {
                self.rest_s + (t_s - self.rest_s) * slower
            } else {
                t_s + later_s + hold_s
            }
        };
        let path = |samples: &Vec<ClampSample>| {
            let first = samples[0].position_m;
            let moved = samples.iter().map(|sample| ClampSample {
                t_s: time(sample.t_s),
                position_m: std::array::from_fn(|k| first[k] + way * (sample.position_m[k] - first[k])),
                ..*sample
            });
            let mut path: Vec<ClampSample> = moved.collect();
            self.add_rest(&mut path, time(self.still_s), hold_s);
            path
        };
        let clamps: Vec<Vec<ClampSample>> = self.demo.clamps.iter().map(path).collect();
        let frames = self.demo.times_s();
        let last = frames.last().map_or(0.0, |&t| time(t.max(self.still_s)));
        let end_s = if last <= time(self.still_s) {
            last + hold_s
        } else {
            last
        };
        self.unseen(clamps, end_s)
    }

    /// Puts a rest of `hold_s` at `from_s` into a path whose later samples make room for it already.
    fn add_rest(&self, path: &mut Vec<ClampSample>, from_s: f64, hold_s: f64) {
        let Some(at) = path.iter().rposition(|s| s.t_s <= from_s + 1e-9 && s.closed) else {
            return;
        };
        let still = path[at];
        let step_s = self.clamp_s.min(0.25 * hold_s);
        let mut rest = Vec::new();
        for t_s in [from_s + step_s, from_s + hold_s - step_s, from_s + hold_s] {
            let free = path.get(at + 1).is_none_or(|next| next.t_s > t_s + 1e-9);
            if hold_s > 0.0 && free {
                rest.push(ClampSample { t_s, ..still });
            }
        }
        path.splice(at + 1..at + 1, rest);
    }

    /// Paths until the motion has ended and the rope was held for a pause.
    fn held(&self) -> (Vec<Vec<ClampSample>>, f64) {
        let end_s = self.still_s + PAUSE_S;
        let path = |samples: &Vec<ClampSample>| {
            let until = samples
                .iter()
                .filter(|s| s.closed && s.t_s <= self.still_s + 1e-9);
            let mut path: Vec<ClampSample> = until.copied().collect();
            self.add_rest(&mut path, self.still_s, PAUSE_S);
            path
        };
        (self.demo.clamps.iter().map(path).collect(), end_s)
    }

    fn ring_down(&self) -> Demo {
        let (mut clamps, start_s) = self.held();
        let [x, y, _] = self.demo.spec.rope.direction;
        let level = x.hypot(y);
        let along = if level > MOVED {
            [x / level, y / level]
        } else {
            [1.0, 0.0]
        };
        let end = [-STROKE_M * along[0], -STROKE_M * along[1], 0.0];
        let line = LineProfile::new([0.0; 3], end, &STROKE);
        let count = (line.duration_s() / self.clamp_s).ceil() as usize + 2;
        let end_s = start_s + line.duration_s() + RINGING_S;
        // What stood still in the recording is fixed to something.
        let moves = |path: &Vec<ClampSample>| path.windows(2).any(|pair| differ(&pair[0], &pair[1]));
        for path in clamps.iter_mut().filter(|path| moves(path)) {
            let Some(&still) = path.last() else { continue };
            let at = |t_s: f64| ClampSample {
                t_s,
                position_m: std::array::from_fn(|k| still.position_m[k] + line.position_m(t_s - start_s)[k]),
                ..still
            };
            path.extend((1..=count).map(|i| at(start_s + i as f64 * self.clamp_s)));
            path.push(at(end_s.max(start_s + (count + 1) as f64 * self.clamp_s)));
        }
        self.unseen(clamps, end_s)
    }

    fn release(&self) -> Demo {
        let (mut clamps, opens_s) = self.held();
        for path in &mut clamps {
            if let Some(last) = path.last_mut() {
                last.closed = false;
                let open = ClampSample {
                    t_s: opens_s + FALL_S,
                    ..*last
                };
                path.push(open);
            }
        }
        self.unseen(clamps, opens_s + FALL_S)
    }

    /// A demonstration along these paths in which nothing was seen yet, at the recorded frame rate.
    fn unseen(&self, clamps: Vec<Vec<ClampSample>>, end_s: f64) -> Demo {
        let first_s = self.demo.times_s()[0];
        let count = ((end_s - first_s) / self.frame_s + 1e-6) as usize;
        let mut samples = Vec::with_capacity((count + 1) * self.places.arcs_m.len());
        for frame in 0..=count {
            for (number, &s_m) in self.places.arcs_m.iter().enumerate() {
                samples.push(MarkerSample {
                    t_s: first_s + frame as f64 * self.frame_s,
                    marker: number.to_string(),
                    s_m,
                    position_m: if frame == 0 {
                        self.places.first_m[number]
                    } else {
                        [0.0; 3]
                    },
                });
            }
        }
        let mut spec = self.demo.spec.clone();
        spec.planar = false;
        Demo {
            name: String::new(),
            commanded: vec![None; clamps.len()],
            spec,
            clamps,
            observations: Observations::Markers(samples),
        }
    }
}

/// Everything but the cameras turned about the vertical through the first clamp's first place.
fn turned(mut demo: Demo, angle_rad: f64) -> Demo {
    let (sin, cos) = angle_rad.sin_cos();
    let spin = |v: [f64; 3]| [cos * v[0] - sin * v[1], sin * v[0] + cos * v[1], v[2]];
    let pivot = demo.clamps[0][0].position_m;
    let around = |p: [f64; 3]| {
        let moved = spin(std::array::from_fn(|k| p[k] - pivot[k]));
        std::array::from_fn(|k| pivot[k] + moved[k])
    };
    let (half_sin, half_cos) = (0.5 * angle_rad).sin_cos();
    for sample in demo.clamps.iter_mut().flatten() {
        sample.position_m = around(sample.position_m);
        let [x, y, z, w] = sample.quaternion_xyzw;
        sample.quaternion_xyzw = [
            half_cos * x - half_sin * y,
            half_cos * y + half_sin * x,
            half_cos * z + half_sin * w,
            half_cos * w - half_sin * z,
        ];
    }
    demo.spec.rope.direction = spin(demo.spec.rope.direction);
    for clamp in &mut demo.spec.clamps {
        clamp.direction = clamp.direction.map(spin);
    }
    if let Observations::Markers(samples) = &mut demo.observations {
        let start_s = samples.first().map_or(0.0, |s| s.t_s);
        for sample in samples.iter_mut().filter(|s| s.t_s == start_s) {
            sample.position_m = around(sample.position_m);
        }
    }
    demo
}

/// The nearest of 1, 2, 5, 10, … g.
fn round_mass_kg(mass_kg: f64) -> f64 {
    let grams = (1e3 * mass_kg).max(1.0);
    let power = 10f64.powf(grams.log10().floor());
    let steps = [1.0, 2.0, 5.0, 10.0].map(|step| step * power);
    let nearest = steps.into_iter().min_by(|a, b| {
        let off = |s: f64| (s / grams).ln().abs();
        off(*a).total_cmp(&off(*b))
    });
    1e-3 * nearest.unwrap_or(grams)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench_diagnosis::experiment::{MOTIONS, marker_arcs_m};
    use crate::sim::Scene;
    use crate::sim::scene::MIN_CELLS_PER_DIAMETER;
    use std::path::Path;

    fn lift() -> Demo {
        let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("demos/sample-rope/fit");
        Demo::load(dir).unwrap()
    }

    fn thrown() -> Demo {
        let motion = MOTIONS[0];
        let unseen = vec![vec![[0.0; 3]; marker_arcs_m().len()]; motion.frame_times_s().len()];
        motion.demo(&unseen, 0.001, 1)
    }

    /// The lift as if a hand had made it, at 1.5 m/s.
    fn hurled() -> Demo {
        let lift = lift();
        let places = Places {
            arcs_m: &[0.05],
            first_m: &[[0.05, 0.0, 0.007]],
        };
        let recording = Recording::new(&lift, places).unwrap();
        recording.replay(recording.peak_m_s / 1.5, 1.0, 0.0)
    }

    fn family_of(demo: &Demo) -> Vec<Candidate> {
        let arcs_m = [0.05, 0.15, 0.25];
        let first_m = arcs_m.map(|s| [s, 0.0, 0.007]);
        let places = Places {
            arcs_m: &arcs_m,
            first_m: &first_m,
        };
        family(demo, places).unwrap()
    }

    fn speed(demo: &Demo) -> f64 {
        let step = |pair: &[ClampSample]| {
            let way = (0..3).map(|k| (pair[1].position_m[k] - pair[0].position_m[k]).powi(2));
            way.sum::<f64>().sqrt() / (pair[1].t_s - pair[0].t_s)
        };
        demo.clamps[0].windows(2).map(step).fold(0.0, f64::max)
    }

    /// Every motion can be simulated, is within what the arm does, and is told apart by name.
    #[test]
    fn every_motion_can_be_made() {
        for demo in [lift(), thrown(), hurled()] {
            let found = family_of(&demo);
            let mut names: Vec<&str> = found.iter().map(|c| c.id).collect();
            names.sort_unstable();
            names.dedup();
            assert_eq!(names.len(), found.len());
            for candidate in &found {
                let scene = Scene::of_demo(&candidate.demo, MIN_CELLS_PER_DIAMETER);
                let scene = scene.unwrap_or_else(|error| panic!("{}: {error}", candidate.id));
                scene.check().unwrap();
                assert!(speed(&candidate.demo) <= 1.0, "{}", candidate.id);
                for path in &candidate.demo.clamps {
                    assert!(path.windows(2).all(|p| p[1].t_s > p[0].t_s), "{}", candidate.id);
                    let end = candidate.demo.times_s().last().copied().unwrap();
                    assert!(path[path.len() - 1].t_s >= end - 0.02, "{}", candidate.id);
                }
            }
        }
    }

    /// What was "faster" once stood for 0.6 times the speed.
    #[test]
    fn what_the_arm_cannot_repeat_is_slowed_down() {
        let demo = hurled();
        assert!((speed(&demo) - 1.5).abs() < 1e-9);
        let found = family_of(&demo);
        assert!(found.iter().all(|c| c.id != "faster"));
        let repeat = &found.iter().find(|c| c.id == "repeat").unwrap();
        assert!((speed(&repeat.demo) - FASTEST_M_S).abs() < 1e-9);
        assert_eq!(repeat.words, "repeat the lift at 0.6 times its speed");
    }

    #[test]
    fn a_slower_lift_takes_longer_and_a_held_one_stays() {
        let demo = lift();
        let found = family_of(&demo);
        let of = |id: &str| &found.iter().find(|c| c.id == id).unwrap().demo;
        let last = |demo: &Demo| demo.times_s().last().copied().unwrap();
        assert!((speed(of("slower")) / speed(&demo) - 0.5).abs() < 0.01);
        assert!((speed(of("faster")) / speed(&demo) - 2.0).abs() < 0.04);
        assert!((last(of("repeat")) - last(&demo)).abs() < 0.05);
        assert!((last(of("hold")) - last(&demo) - HOLD_S).abs() < 0.05);
        let top = |demo: &Demo| demo.clamps[0].last().unwrap().position_m[2];
        let start = demo.clamps[0][0].position_m[2];
        assert!((top(of("hold_half_way")) - start - 0.5 * (top(&demo) - start)).abs() < 1e-9);
        assert!(!of("release").clamps[0].last().unwrap().closed);
    }

    /// The gripped piece points where the rope does after a turn, and the clamp's way turns with it.
    #[test]
    fn a_turned_rig_points_the_other_way() {
        let demo = turned(lift(), std::f64::consts::PI);
        assert!((demo.spec.rope.direction[0] + 1.0).abs() < 1e-12);
        let q = demo.clamps[0][0].quaternion_xyzw;
        assert!((q[2].abs() - 1.0).abs() < 1e-12 && q[3].abs() < 1e-12, "{q:?}");
    }

    #[test]
    fn what_cannot_be_repeated_is_said() {
        let arcs_m = [0.1];
        let places = Places {
            arcs_m: &arcs_m,
            first_m: &[[0.0; 3]],
        };
        let mut moving = thrown();
        moving.spec.start = StartState::Moving;
        assert!(family(&moving, places).unwrap_err().contains("starts in motion"));
        let mut poses = thrown();
        poses.spec.scene = SceneKind::Static;
        assert!(family(&poses, places).unwrap_err().contains("poses"));
    }

    #[test]
    fn masses_are_round() {
        assert_eq!(round_mass_kg(0.0096), 0.01);
        assert_eq!(round_mass_kg(0.0002), 0.001);
        assert_eq!(round_mass_kg(0.045), 0.05);
    }
}
