//! What is done with the rope: lifted from the table along a path, held, let go. Every reality plays the
//! same motions, and every diagnosis fits the first demonstration, as is the rule with measured ropes, and
//! is judged on the second.
//!
//! Letting go at the end shows the clocks apart: a clock that is off shifts lift and fall alike, a lagging
//! gripper only the lift, a late release only the fall.

use super::noise::{CORRELATION, correlated};
use crate::demo::{
    ClampSample, ClampSpec, Demo, DemoSpec, FORMAT, MarkerSample, Observations, RopeEnd, RopeSpec, SceneKind,
    StartState, TableSpec,
};
use shared::profile::{LineProfile, MotionLimits};
use std::f64::consts::FRAC_PI_4;

/// Length of the rope, m.
pub const LENGTH_M: f64 = 0.25;
/// Diameter of the rope, m.
pub const DIAMETER_M: f64 = 0.014;
/// Density of the rope, kg/m³.
pub const DENSITY_KG_M3: f64 = 1000.0;
/// Coefficient of friction that is declared.
pub const FRICTION: f64 = 0.5;
/// Length of rope in the gripper, m.
pub const GRIP_M: f64 = 0.02;
/// Frames per second.
const FRAME_RATE_HZ: f64 = 30.0;
/// Recorded gripper poses per second.
const CLAMP_RATE_HZ: f64 = 100.0;
/// Labelled points along the rope.
const MARKERS: usize = 16;
/// Rest at the beginning, s: a dozen frames from which the noise is measured.
const REST_S: f64 = 0.4;
/// Rest before the gripper opens, s.
const HOLD_S: f64 = 0.25;
/// Recorded fall, s: it ends before the rope meets the table.
const FALL_S: f64 = 0.1;
/// Demonstrations that are fitted; the others only judge.
pub const FITTED: usize = 1;

/// A straight line of the gripper.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Leg {
    /// Where it ends, m.
    pub to_m: [f64; 3],
    /// Largest speed, m/s.
    pub speed_m_s: f64,
}

impl Leg {
    /// Bounds of the motion along it.
    pub fn limits(&self) -> MotionLimits {
        MotionLimits {
            speed_m_s: self.speed_m_s,
            acceleration_m_s2: 4.0,
            jerk_m_s3: 100.0,
        }
    }
}

/// One demonstration: rest, the legs one after another, hold, open, fall.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Name.
    pub name: &'static str,
    /// The legs.
    pub legs: &'static [Leg],
}

const fn leg(to_m: [f64; 3], speed_m_s: f64) -> Leg {
    Leg { to_m, speed_m_s }
}

/// The demonstrations: quick with a bend, and, held out, slower and straight.
pub const MOTIONS: [Motion; 2] = [
    Motion {
        name: "bent",
        legs: &[leg([0.05, 0.05, 0.2], 0.6), leg([-0.04, -0.03, 0.34], 0.6)],
    },
    Motion {
        name: "held-out",
        legs: &[leg([0.03, -0.03, 0.33], 0.45)],
    },
];

/// A further motion, which no diagnosis is given: what is held out chooses among models too, so only this one tells how
/// well the chosen one foresees.
pub const SEALED: Motion = Motion {
    name: "sealed",
    legs: &[leg([0.06, 0.0, 0.16], 0.5), leg([-0.02, 0.05, 0.33], 0.7)],
};

/// Every motion that a reality plays: [`MOTIONS`], then [`SEALED`].
pub fn played() -> Vec<Motion> {
    MOTIONS.into_iter().chain([SEALED]).collect()
}

impl Motion {
    /// Where the gripper is at first: the rope lies on the table.
    pub const START_M: [f64; 3] = [0.0, 0.0, 0.5 * DIAMETER_M];

    fn lines(&self) -> Vec<(f64, LineProfile)> {
        let (mut from_m, mut t_s) = (Self::START_M, REST_S);
        let mut lines = Vec::new();
        for leg in self.legs {
            let line = LineProfile::new(from_m, leg.to_m, &leg.limits());
            lines.push((t_s, line));
            t_s += line.duration_s();
            from_m = leg.to_m;
        }
        lines
    }

    /// Time before the first leg, s.
    pub fn rest_s(&self) -> f64 {
        REST_S
    }

    /// When the gripper opens, s.
    pub fn opens_at_s(&self) -> f64 {
        let lines = self.lines();
        lines
            .last()
            .map_or(REST_S, |(start, line)| start + line.duration_s())
            + HOLD_S
    }

    /// Times at which the rope is seen, s.
    pub fn frame_times_s(&self) -> Vec<f64> {
        let count = ((self.opens_at_s() + FALL_S) * FRAME_RATE_HZ) as usize;
        (0..=count).map(|i| i as f64 / FRAME_RATE_HZ).collect()
    }

    fn clamp(&self) -> Vec<ClampSample> {
        let lines = self.lines();
        let opens_at_s = self.opens_at_s();
        let count = ((opens_at_s + FALL_S) * CLAMP_RATE_HZ).ceil() as usize;
        let position = |t_s: f64| {
            let current = lines.iter().rev().find(|(start, _)| t_s >= *start);
            current.map_or(Self::START_M, |(start, line)| line.position_m(t_s - start))
        };
        let mut times: Vec<f64> = (0..=count).map(|i| i as f64 / CLAMP_RATE_HZ).collect();
        times.retain(|t| (t - opens_at_s).abs() > 1e-6);
        times.push(opens_at_s);
        times.sort_by(f64::total_cmp);
        let sample = |t_s: f64| ClampSample {
            t_s,
            position_m: position(t_s),
            quaternion_xyzw: [0.0, 0.0, 0.0, 1.0],
            closed: t_s < opens_at_s,
        };
        times.into_iter().map(sample).collect()
    }

    /// The demonstration with what was seen of `track`, displaced by noise of `noise_m`.
    pub fn demo(&self, track: &Track, noise_m: f64, seed: u64) -> Demo {
        let samples = seen(&self.frame_times_s(), track, noise_m, seed);
        Demo {
            name: self.name.into(),
            spec: self.spec(noise_m),
            clamps: vec![self.clamp()],
            commanded: vec![None],
            observations: Observations::Markers(samples),
        }
    }

    /// Everything that is declared.
    fn spec(&self, noise_m: f64) -> DemoSpec {
        DemoSpec {
            format: FORMAT.into(),
            scene: SceneKind::Free,
            noise_m,
            planar: false,
            notes: String::new(),
            start: StartState::Straight,
            rope: rope(),
            table: Some(TableSpec {
                height_m: 0.0,
                friction: FRICTION,
            }),
            clamps: vec![ClampSpec {
                end: RopeEnd::Start,
                grip_m: GRIP_M,
                direction: None,
            }],
            cameras: Vec::new(),
        }
    }
}

/// What the cameras see of a track: displaced by noise of `noise_m`.
pub fn seen(times_s: &[f64], track: &Track, noise_m: f64, seed: u64) -> Vec<MarkerSample> {
    let arcs_m = marker_arcs_m();
    let noise = correlated(track.len(), arcs_m.len(), noise_m, CORRELATION, seed);
    let mut samples = Vec::with_capacity(track.len() * arcs_m.len());
    for ((&t_s, line), errors) in times_s.iter().zip(track).zip(&noise) {
        for (number, &s_m) in arcs_m.iter().enumerate() {
            samples.push(MarkerSample {
                t_s,
                marker: number.to_string(),
                s_m,
                position_m: std::array::from_fn(|k| line[number][k] + errors[number][k]),
            });
        }
    }
    samples
}

/// Where each marker is in each frame, m.
pub type Track = Vec<Vec<[f64; 3]>>;

/// Arc lengths of the markers, m: the middles of equal parts of the free rope.
pub fn marker_arcs_m() -> Vec<f64> {
    let free_m = LENGTH_M - GRIP_M;
    let middle = |i: usize| GRIP_M + (i as f64 + 0.5) / MARKERS as f64 * free_m;
    (0..MARKERS).map(middle).collect()
}

/// The rope as declared.
pub fn rope() -> RopeSpec {
    RopeSpec {
        length_m: LENGTH_M,
        diameter_m: DIAMETER_M,
        mass_kg: DENSITY_KG_M3 * FRAC_PI_4 * DIAMETER_M * DIAMETER_M * LENGTH_M,
        direction: [1.0, 0.0, 0.0],
        end_mass_kg: 0.0,
        roll_rad: 0.0,
        assumed: Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_demonstration_rests_first_and_ends_before_the_rope_meets_the_table() {
        for motion in played() {
            let times = motion.frame_times_s();
            let track: Track = times
                .iter()
                .map(|_| vec![[0.0; 3]; marker_arcs_m().len()])
                .collect();
            let demo = motion.demo(&track, 0.001, 1);
            assert_eq!(demo.times_s().len(), times.len());
            assert!(demo.rest_frames(&times) >= 12);
            let end = motion.legs[motion.legs.len() - 1].to_m[2];
            let fallen = 0.5 * 9.81 * FALL_S * FALL_S;
            assert!(end - LENGTH_M - fallen > 0.5 * DIAMETER_M, "{}", motion.name);
            assert!(times[times.len() - 1] > motion.opens_at_s() + 0.03);
        }
    }
}
