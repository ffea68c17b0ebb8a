//! Where a clamp goes: a chain of rest-to-rest lines with pauses, orientation held.

use nalgebra::Vector3;
use shared::profile::{LineProfile, MotionLimits};

/// One line of a clamp's path.
#[derive(Clone, Copy, Debug)]
pub struct Leg {
    /// Where the line ends, m.
    pub to_m: [f64; 3],
    /// Bounds of the motion along it.
    pub limits: MotionLimits,
    /// Rest at its end, s.
    pub pause_s: f64,
}

/// A clamp's position as a function of time.
#[derive(Clone, Debug)]
pub struct ClampPath {
    start_m: [f64; 3],
    /// Start time and shape of each line.
    lines: Vec<(f64, LineProfile)>,
    duration_s: f64,
}

impl ClampPath {
    /// Rests at `start_m` for `rest_s`, then follows the legs.
    pub fn new(start_m: [f64; 3], rest_s: f64, legs: &[Leg]) -> Self {
        let mut lines = Vec::new();
        let (mut from_m, mut t) = (start_m, rest_s);
        for leg in legs {
            let line = LineProfile::new(from_m, leg.to_m, &leg.limits);
            lines.push((t, line));
            t += line.duration_s() + leg.pause_s;
            from_m = leg.to_m;
        }
        Self {
            start_m,
            lines,
            duration_s: t,
        }
    }

    /// From the first rest to the end of the last pause, s.
    pub fn duration_s(&self) -> f64 {
        self.duration_s
    }

    /// Position at time `t_s`, m.
    pub fn position_m(&self, t_s: f64) -> Vector3<f64> {
        match self.current(t_s) {
            Some((start, line)) => Vector3::from(line.position_m(t_s - start)),
            None => Vector3::from(self.start_m),
        }
    }

    /// Velocity at time `t_s`, m/s.
    pub fn velocity_m_s(&self, t_s: f64) -> Vector3<f64> {
        match self.current(t_s) {
            Some((start, line)) => Vector3::from(line.velocity_m_s(t_s - start)),
            None => Vector3::zeros(),
        }
    }

    fn current(&self, t_s: f64) -> Option<&(f64, LineProfile)> {
        self.lines.iter().rev().find(|(start, _)| t_s >= *start)
    }
}
