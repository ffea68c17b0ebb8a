//! The last stage before a target leaves: it checks the finite differences of what was sent against
//! every limit of the arm and knows how to stop within them. There is no way around it.

use crate::constants::BRAKE_SHARE;
use nalgebra::Vector3;
use shared::arm::{
    self, ACCELERATION_MAX_RAD_S2, FLANGE_SPEED_MAX_M_S, JERK_MAX_RAD_S3, JOINTS, Joints, SPEED_MAX_RAD_S,
};

/// Which limit a target would have broken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Violation {
    /// Outside a joint's range, or not a number.
    Range,
    /// Joint speed.
    Speed,
    /// Joint acceleration.
    Acceleration,
    /// Joint jerk.
    Jerk,
    /// Speed of the flange.
    FlangeSpeed,
}

/// Remembers the last three targets of a stream; the differences of the next one are taken from them.
#[derive(Clone, Debug)]
pub struct Guard {
    period_s: f64,
    /// Newest first.
    sent_rad: [Joints; 3],
    flange_m: Vector3<f64>,
}

impl Guard {
    /// A stream that begins at rest at `pose_rad`, with one target every `period_s`.
    pub fn at_rest(pose_rad: Joints, period_s: f64) -> Self {
        Self {
            period_s,
            sent_rad: [pose_rad; 3],
            flange_m: arm::flange(&pose_rad).position_m,
        }
    }

    /// The newest target sent (or the pose at rest that the stream begins with), rad.
    pub fn last_rad(&self) -> Joints {
        self.sent_rad[0]
    }

    /// Lets `next_rad` pass and returns the speed that leads to it, rad/s; or says which limit it breaks,
    /// in which case nothing changes.
    pub fn pass(&mut self, next_rad: &Joints) -> Result<Joints, Violation> {
        if arm::joint_out_of_range(next_rad).is_some() {
            return Err(Violation::Range);
        }
        let speed = self.speed_to(next_rad);
        let (before, earlier) = (self.speed(), self.speed_before());
        for i in 0..JOINTS {
            let acceleration = (speed[i] - before[i]) / self.period_s;
            let acceleration_before = (before[i] - earlier[i]) / self.period_s;
            if speed[i].abs() > SPEED_MAX_RAD_S {
                return Err(Violation::Speed);
            }
            if acceleration.abs() > ACCELERATION_MAX_RAD_S2 {
                return Err(Violation::Acceleration);
            }
            if (acceleration - acceleration_before).abs() > JERK_MAX_RAD_S3 * self.period_s {
                return Err(Violation::Jerk);
            }
        }
        let flange_m = arm::flange(next_rad).position_m;
        if (flange_m - self.flange_m).norm() > FLANGE_SPEED_MAX_M_S * self.period_s {
            return Err(Violation::FlangeSpeed);
        }
        self.sent_rad = [*next_rad, self.sent_rad[0], self.sent_rad[1]];
        self.flange_m = flange_m;
        Ok(speed)
    }

    /// The stop that begins after the newest target.
    pub fn brake(&self) -> Brake {
        let speed = self.speed();
        let before = self.speed_before();
        let acceleration: Joints = std::array::from_fn(|i| (speed[i] - before[i]) / self.period_s);
        let mut duration_s = 0.0f64;
        for i in 0..JOINTS {
            duration_s = duration_s.max(stop_time_s(speed[i].abs(), acceleration[i].abs()));
        }
        Brake {
            speed_rad_s: speed,
            acceleration_rad_s2: acceleration,
            steps: (duration_s / self.period_s).ceil().max(1.0) as u32,
            step: 0,
        }
    }

    /// The next target of a stop, or `None` when it is complete.
    pub fn next_of(&self, brake: &mut Brake) -> Option<Joints> {
        if brake.step == brake.steps {
            return None;
        }
        brake.step += 1;
        let speed = brake.speed(self.period_s);
        Some(std::array::from_fn(|i| {
            self.sent_rad[0][i] + speed[i] * self.period_s
        }))
    }

    fn speed_to(&self, next: &Joints) -> Joints {
        std::array::from_fn(|i| (next[i] - self.sent_rad[0][i]) / self.period_s)
    }

    fn speed(&self) -> Joints {
        std::array::from_fn(|i| (self.sent_rad[0][i] - self.sent_rad[1][i]) / self.period_s)
    }

    fn speed_before(&self) -> Joints {
        std::array::from_fn(|i| (self.sent_rad[1][i] - self.sent_rad[2][i]) / self.period_s)
    }
}

/// A stop: each joint's speed follows the cubic that starts with the present speed and acceleration
/// and ends with both zero, all joints in the same time.
#[derive(Clone, Debug)]
pub struct Brake {
    speed_rad_s: Joints,
    acceleration_rad_s2: Joints,
    steps: u32,
    step: u32,
}

impl Brake {
    /// v(u) = v₀ (1 − 3u² + 2u³) + a₀ T (u − 2u² + u³), the cubic Hermite polynomial.
    fn speed(&self, period_s: f64) -> Joints {
        let u = f64::from(self.step) / f64::from(self.steps);
        let duration_s = f64::from(self.steps) * period_s;
        let by_speed = 1.0 + u * u * (2.0 * u - 3.0);
        let by_acceleration = duration_s * u * (1.0 - u) * (1.0 - u);
        std::array::from_fn(|i| {
            self.speed_rad_s[i] * by_speed + self.acceleration_rad_s2[i] * by_acceleration
        })
    }
}

/// Shortest time in which that cubic stays within the shares of jerk and acceleration.
///
/// Its jerk is at most 6 v/T² + 4 a/T (at the ends), its acceleration at most 1.5 v/T + a.
fn stop_time_s(speed: f64, acceleration: f64) -> f64 {
    let jerk_max = BRAKE_SHARE * JERK_MAX_RAD_S3;
    let root = (16.0 * acceleration * acceleration + 24.0 * speed * jerk_max).sqrt();
    let by_jerk = (4.0 * acceleration + root) / (2.0 * jerk_max);
    let room = (BRAKE_SHARE * ACCELERATION_MAX_RAD_S2 - acceleration).max(0.1 * ACCELERATION_MAX_RAD_S2);
    by_jerk.max(1.5 * speed / room)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use shared::arm::LEVEL_POSTURE_RAD;

    const PERIOD_S: f64 = 0.004;

    fn moved(joint: usize, by_rad: f64) -> Joints {
        let mut q = LEVEL_POSTURE_RAD;
        q[joint] += by_rad;
        q
    }

    #[test]
    fn each_limit_is_seen_and_nothing_changes() {
        let mut guard = Guard::at_rest(LEVEL_POSTURE_RAD, PERIOD_S);
        let jerk_step = JERK_MAX_RAD_S3 * PERIOD_S * PERIOD_S * PERIOD_S;
        let mut nan = LEVEL_POSTURE_RAD;
        nan[6] = f64::NAN;
        assert_eq!(guard.pass(&nan), Err(Violation::Range));
        assert_eq!(guard.pass(&moved(1, 3.0)), Err(Violation::Range));
        assert_eq!(
            guard.pass(&moved(0, 1.01 * SPEED_MAX_RAD_S * PERIOD_S)),
            Err(Violation::Speed)
        );
        assert_eq!(guard.pass(&moved(0, 0.011)), Err(Violation::Acceleration));
        assert_eq!(guard.pass(&moved(0, 1.01 * jerk_step)), Err(Violation::Jerk));
        assert_eq!(guard.last_rad(), LEVEL_POSTURE_RAD);
        assert!(guard.pass(&moved(0, 0.99 * jerk_step)).is_ok());
    }

    #[test]
    fn flange_speed_is_bounded_by_itself() {
        // Joint 1 at 2 rad/s is within the joint's limits but moves the stretched arm too fast.
        let mut stretched = LEVEL_POSTURE_RAD;
        (stretched[1], stretched[3]) = (0.9, 2.4);
        let mut guard = Guard::at_rest(stretched, PERIOD_S);
        let mut next = stretched;
        let mut speed = 0.0;
        let refused = loop {
            speed += 0.9 * (speed + 1e-3f64).min(1.5) * PERIOD_S * 5.0;
            next[0] += speed * PERIOD_S;
            if let Err(violation) = guard.pass(&next) {
                break violation;
            }
        };
        assert_eq!(refused, Violation::FlangeSpeed);
    }

    proptest! {
        /// From any state that smooth motion reaches, the stop passes the guard and ends at rest.
        #[test]
        fn a_stop_passes_its_own_guard(
            amplitude in prop::array::uniform7(-0.25f64..0.25), rate in 1.0f64..3.0, start in 1usize..400,
        ) {
            let mut guard = Guard::at_rest(LEVEL_POSTURE_RAD, PERIOD_S);
            for k in 1..=start {
                let t = k as f64 * PERIOD_S;
                let ramp = 1.0 - (-t * t * t * 8.0).exp();
                let q = std::array::from_fn(|i| {
                    LEVEL_POSTURE_RAD[i] + ramp * amplitude[i] * (rate * t).sin()
                });
                prop_assume!(guard.pass(&q).is_ok());
            }
            let mut brake = guard.brake();
            while let Some(next) = guard.next_of(&mut brake) {
                prop_assert_eq!(guard.pass(&next).err(), None);
            }
            for _ in 0..3 {
                let hold = guard.last_rad();
                prop_assert!(guard.pass(&hold).is_ok());
            }
        }
    }
}
