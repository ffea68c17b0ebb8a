//! The limits of the arm, checked by finite differences of what was sent. Written anew, apart from the
//! guard, because it judges the guard; tests across processes use it too. An arm that got no target for a while stands at
//! the newest one.

use shared::arm::{
    self, ACCELERATION_MAX_RAD_S2, FLANGE_SPEED_MAX_M_S, JERK_MAX_RAD_S3, JOINTS, SPEED_MAX_RAD_S,
};
use shared::messages::JointTarget;

/// Subtracting angles of up to 6 rad leaves 1e-15 / (1 ms)³ of noise in the jerk.
const SLACK: f64 = 1.0 + 1e-6;

/// Periods after which an arm without targets stands.
const STANDS_AFTER: f64 = 5.0;

/// Follows a stream of targets and finds the first that breaks a limit.
pub struct LimitCheck {
    period_s: f64,
    /// The newest targets of the present stream, newest first; at rest before the first.
    recent: Option<[JointTarget; 3]>,
}

impl LimitCheck {
    /// For targets `period_s` apart.
    pub fn new(period_s: f64) -> Self {
        Self {
            period_s,
            recent: None,
        }
    }

    /// Takes the next target.
    pub fn push(&mut self, target: &JointTarget) -> Result<(), String> {
        let name = format!("target {}", target.seq);
        if let Some(joint) = arm::joint_out_of_range(&target.q_rad) {
            return Err(format!("{name}: joint {joint} out of range"));
        }
        let mut recent = match &self.recent {
            Some(recent) if recent[0].stream == target.stream => *recent,
            _ => [*target; 3],
        };
        let since_ns = target.stamp_ns.saturating_sub(recent[0].stamp_ns);
        if since_ns as f64 > STANDS_AFTER * 1e9 * self.period_s * SLACK {
            recent = [recent[0]; 3];
        }
        let [a, b, c] = recent;
        if a.seq != target.seq && a.seq + 1 != target.seq {
            return Err(format!("{name} came after {}", a.seq));
        }
        let period_s = self.period_s;
        for i in 0..JOINTS {
            let speed =
                |newer: &JointTarget, older: &JointTarget| (newer.q_rad[i] - older.q_rad[i]) / period_s;
            let (v0, v1, v2) = (speed(target, &a), speed(&a, &b), speed(&b, &c));
            let (a0, a1) = ((v0 - v1) / period_s, (v1 - v2) / period_s);
            let shares = [
                v0 / SPEED_MAX_RAD_S,
                a0 / ACCELERATION_MAX_RAD_S2,
                (a0 - a1) / period_s / JERK_MAX_RAD_S3,
            ];
            if shares.iter().any(|share| share.abs() > SLACK) {
                return Err(format!("{name}, joint {i}: shares of the limits {shares:?}"));
            }
        }
        let travel = arm::flange(&target.q_rad).position_m - arm::flange(&a.q_rad).position_m;
        if travel.norm() / period_s > FLANGE_SPEED_MAX_M_S * SLACK {
            return Err(format!("{name}: flange speed"));
        }
        self.recent = Some([*target, a, b]);
        Ok(())
    }
}

/// All of `targets`, `period_s` apart.
pub fn limits_hold_at(targets: &[JointTarget], period_s: f64) -> Result<(), String> {
    let mut check = LimitCheck::new(period_s);
    targets.iter().try_for_each(|target| check.push(target))
}
