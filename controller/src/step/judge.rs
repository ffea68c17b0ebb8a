//! What becomes of a goal: why it is refused, or the plan that serves it.

use super::{Controller, Mode, Prepared};
use crate::constants::{GOAL_AGE_MAX_NS, GOAL_AHEAD_MAX_NS};
use crate::guard::Guard;
use crate::plan::{self, Pace, Plan, Start};
use crate::promise::Promise;
use crate::readiness;
use shared::arm::{Joints, LEVEL_POSTURE_RAD};
use shared::messages::{GOAL_MAGIC, Goal, Reason};

impl Controller {
    /// Plans ahead for a goal that waits for the next step, or for a likely one, so that caches and branch
    /// predictors know the way. Changes how long the next step takes, nothing else.
    pub fn prepare(&mut self, goal: &Goal) {
        let q_rad = self.guard.as_ref().map_or(LEVEL_POSTURE_RAD, Guard::last_rad);
        let start = self.start_at(q_rad);
        self.prepared = Some(Prepared {
            goal: *goal,
            start,
            outcome: self.plan(goal, &start),
        });
    }

    /// A goal that a client could ask for, another one each cycle.
    pub fn likely_goal(&self) -> Goal {
        plan::likely_goal(&self.setup.blob, self.status.cycles)
    }

    pub(super) fn judge(&mut self, goal: &Goal, now_ns: u64) {
        let verdict = self.check(goal, now_ns);
        match verdict {
            Ok(plan) => {
                self.accepted_id = goal.id;
                self.accepted_stamp_ns = goal.stamp_ns;
                self.status.goals_accepted += 1;
                self.status.active_goal_id = goal.id;
                self.mode = Mode::Running {
                    plan,
                    leg: 0,
                    target: 0,
                    promise: Promise::of(goal, self.setup.cycle_ns),
                };
            }
            Err(_) => self.status.goals_refused += 1,
        }
        self.status.judged_goal_id = goal.id;
        self.status.judged_reason = verdict.err().unwrap_or(Reason::Accepted).code();
        self.status_changed = true;
    }

    fn check(&self, goal: &Goal, now_ns: u64) -> Result<Plan, Reason> {
        if goal.magic != GOAL_MAGIC || goal.id == 0 {
            return Err(Reason::Malformed);
        }
        if !goal.x_m.is_finite() {
            return Err(Reason::NonFinite);
        }
        if goal.stamp_ns > now_ns.saturating_add(GOAL_AHEAD_MAX_NS) {
            return Err(Reason::FromFuture);
        }
        if now_ns.saturating_sub(goal.stamp_ns) > GOAL_AGE_MAX_NS {
            return Err(Reason::Stale);
        }
        if goal.id == self.accepted_id || goal.stamp_ns < self.accepted_stamp_ns {
            return Err(Reason::OutOfOrder);
        }
        if goal.stamp_ns < self.drop_sent_ns {
            return Err(Reason::Cancelled);
        }
        match (&self.mode, &self.guard) {
            (Mode::Idle, Some(_)) if self.targets_unread() => Err(Reason::TargetsUnread),
            (Mode::Idle, Some(guard)) => {
                let start = self.start_at(guard.last_rad());
                match &self.prepared {
                    Some(prepared) if prepared.goal == *goal && prepared.start == start => prepared.outcome,
                    _ => self.plan(goal, &start),
                }
            }
            (Mode::Running { .. } | Mode::Stopping { .. }, _) => Err(Reason::Busy),
            (Mode::Fault, _) => Err(Reason::Latched),
            (Mode::Ended, _) => Err(Reason::Shutdown),
            (Mode::Waiting | Mode::Idle, _) if self.silent() => Err(Reason::NotReady),
            (Mode::Waiting | Mode::Idle, _) => {
                Err(readiness::obstacle(&self.robot).unwrap_or(Reason::NotReady))
            }
        }
    }

    fn start_at(&self, q_rad: Joints) -> Start {
        let gripper = self.gripper;
        Start { q_rad, gripper }
    }

    fn plan(&self, goal: &Goal, start: &Start) -> Result<Plan, Reason> {
        let pace = Pace {
            period_s: self.period_s,
            gripper_lead_s: self.setup.gripper_lead_ns as f64 * 1e-9,
        };
        plan::plan(&self.setup.blob, self.survey.as_ref(), goal, start, &pace)
    }
}
