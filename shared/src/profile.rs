//! The motion of the gripper as a function of time: the simulator's gripper and the streamed
//! joint targets both follow [`LineProfile`], so they cannot differ.

use serde::{Deserialize, Serialize};

/// Bounds on the speed of the gripper along its path and on the two derivatives of that speed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MotionLimits {
    /// Largest speed, m/s.
    pub speed_m_s: f64,
    /// Largest acceleration, m/s².
    pub acceleration_m_s2: f64,
    /// Largest jerk, m/s³.
    pub jerk_m_s3: f64,
}

impl MotionLimits {
    /// The drag of the paper's rig: 100 mm/s and 2000 mm/s², with a jerk that a 250 Hz stream resolves.
    pub const PAPER: Self = Self {
        speed_m_s: 0.1,
        acceleration_m_s2: 2.0,
        jerk_m_s3: 20.0,
    };
}

/// Share of the way at the share `u` of the time.
fn minimum_jerk(u: f64) -> f64 {
    u * u * u * (10.0 + u * (6.0 * u - 15.0))
}

/// Peaks of the derivatives of [`MinimumJerk`]'s polynomial: speed 15/8, acceleration 10/√3, jerk 60.
pub const MINIMUM_JERK_PEAKS: [f64; 3] = [1.875, 5.773502691896258, 60.0];

/// The time law of a motion from rest to rest: the minimum-jerk polynomial 10u³ − 15u⁴ + 6u⁵ of the share u of the time (Flash
/// and Hogan 1985).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MinimumJerk {
    duration_s: f64,
}

impl MinimumJerk {
    /// The fastest over a way of a length whose peaks of speed, acceleration and jerk stay within `limits`, in the length's
    /// unit and seconds. Over a length D and a duration T they are those of the polynomial times D/T, D/T² and D/T³.
    pub fn within(length: f64, limits: [f64; 3]) -> Self {
        let [speed, acceleration, jerk] = MINIMUM_JERK_PEAKS.map(|peak| peak * length);
        let by_acceleration = libm::sqrt(acceleration / limits[1]);
        let by_jerk = libm::cbrt(jerk / limits[2]);
        Self {
            duration_s: (speed / limits[0]).max(by_acceleration).max(by_jerk),
        }
    }

    /// The same, or slower where it would take less than `duration_s`.
    pub fn lasting(self, duration_s: f64) -> Self {
        Self {
            duration_s: self.duration_s.max(duration_s),
        }
    }

    /// Time from rest to rest, s; zero where there is no way to go.
    pub fn duration_s(&self) -> f64 {
        self.duration_s
    }

    /// Share of the way at time `t_s` after the start: 0 before the motion, 1 after it.
    pub fn share(&self, t_s: f64) -> f64 {
        minimum_jerk(self.phase(t_s))
    }

    /// Derivative of the share, 1/s; zero outside the motion.
    pub fn rate_per_s(&self, t_s: f64) -> f64 {
        if self.duration_s <= 0.0 {
            return 0.0;
        }
        let u = self.phase(t_s);
        30.0 * u * u * (1.0 - u) * (1.0 - u) / self.duration_s
    }

    /// The law of what is left of the way after `t_s`, from rest to rest. In the cube root of the share that is left, no
    /// derivative peaks higher than before, at any place of the way.
    pub fn left_after(&self, t_s: f64) -> Self {
        Self {
            duration_s: self.duration_s * libm::cbrt(1.0 - self.share(t_s)),
        }
    }

    fn phase(&self, t_s: f64) -> f64 {
        if self.duration_s <= 0.0 {
            1.0
        } else {
            (t_s / self.duration_s).clamp(0.0, 1.0)
        }
    }
}

/// Motion from rest to rest along a straight line by [`MinimumJerk`], slow enough for the given limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineProfile {
    from_m: [f64; 3],
    to_m: [f64; 3],
    law: MinimumJerk,
}

impl LineProfile {
    /// The fastest profile from `from_m` to `to_m` whose peaks stay within `limits`.
    pub fn new(from_m: [f64; 3], to_m: [f64; 3], limits: &MotionLimits) -> Self {
        let mut square = 0.0;
        for k in 0..3 {
            square += (to_m[k] - from_m[k]) * (to_m[k] - from_m[k]);
        }
        let peaks = [limits.speed_m_s, limits.acceleration_m_s2, limits.jerk_m_s3];
        Self {
            from_m,
            to_m,
            law: MinimumJerk::within(libm::sqrt(square), peaks),
        }
    }

    /// Time from rest to rest, s; zero when start and end are the same point.
    pub fn duration_s(&self) -> f64 {
        self.law.duration_s()
    }

    /// What is left of the line after `t_s`, as [`MinimumJerk::left_after`] has it.
    pub fn left_after(&self, t_s: f64) -> Self {
        Self {
            from_m: self.position_m(t_s),
            law: self.law.left_after(t_s),
            ..*self
        }
    }

    /// Position at time `t_s` after the start, m; the end points outside the motion.
    pub fn position_m(&self, t_s: f64) -> [f64; 3] {
        let s = self.law.share(t_s);
        core::array::from_fn(|k| self.from_m[k] + s * (self.to_m[k] - self.from_m[k]))
    }

    /// Velocity at time `t_s`, m/s; zero outside the motion.
    pub fn velocity_m_s(&self, t_s: f64) -> [f64; 3] {
        let rate = self.law.rate_per_s(t_s);
        core::array::from_fn(|k| rate * (self.to_m[k] - self.from_m[k]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_of_a_line_ends_there_and_peaks_no_higher() {
        let whole = LineProfile::new([0.0; 3], [0.3, 0.0, 0.4], &MotionLimits::PAPER);
        for share in [0.0, 0.1, 0.5, 0.9, 1.0] {
            let t_s = share * whole.duration_s();
            let left = whole.left_after(t_s);
            assert_eq!(left.position_m(0.0), whole.position_m(t_s));
            assert_eq!(left.position_m(left.duration_s()), [0.3, 0.0, 0.4]);
            let way = 1.0 - minimum_jerk(share);
            // Of jerk, acceleration and speed the first peaks as high as before.
            assert!(
                (way / libm::pow(left.duration_s() / whole.duration_s(), 3.0) - 1.0).abs() < 1e-9
                    || way == 0.0
            );
            assert!(left.duration_s() <= whole.duration_s());
        }
    }

    #[test]
    fn peaks_stay_within_the_limits_and_one_is_reached() {
        for distance in [1e-4, 0.01, 0.3] {
            let limits = MotionLimits::PAPER;
            let profile = LineProfile::new([0.0; 3], [0.0, 0.0, distance], &limits);
            let dt = profile.duration_s() / 2000.0;
            let z = |t: f64| profile.position_m(t)[2];
            let (mut speed, mut acceleration, mut jerk) = (0f64, 0f64, 0f64);
            for i in 2..1998 {
                let t = i as f64 * dt;
                speed = speed.max(profile.velocity_m_s(t)[2].abs());
                acceleration = acceleration.max(((z(t + dt) - 2.0 * z(t) + z(t - dt)) / (dt * dt)).abs());
                let third = z(t + 2.0 * dt) - 2.0 * z(t + dt) + 2.0 * z(t - dt) - z(t - 2.0 * dt);
                jerk = jerk.max((third / (2.0 * dt * dt * dt)).abs());
            }
            let share = [
                speed / limits.speed_m_s,
                acceleration / limits.acceleration_m_s2,
                jerk / limits.jerk_m_s3,
            ];
            let largest = share.iter().cloned().fold(0.0, f64::max);
            assert!(largest <= 1.001, "limit broken: {share:?}");
            assert!(largest >= 0.98, "slower than needed: {share:?}");
        }
    }

    #[test]
    fn a_motion_of_no_length_takes_no_time() {
        let profile = LineProfile::new([1.0; 3], [1.0; 3], &MotionLimits::PAPER);
        assert_eq!(profile.duration_s(), 0.0);
        assert_eq!(profile.position_m(0.0), [1.0; 3]);
        assert_eq!(profile.velocity_m_s(0.0), [0.0; 3]);
    }
}
