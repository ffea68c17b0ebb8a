//! From a goal to the whole motion: policy, release point, inverse kinematics and the sequence of legs.
//! Everything that can be refused is refused here, before the arm moves.

use crate::constants::{GRIPPER_S, HOMING_DIP_M};
use crate::motion::{self, JointMove, LineError};
use crate::survey::Survey;
use shared::arm::{self, Joints};
use shared::blob::{Blob, TaskFrame};
use shared::ik;
use shared::messages::{GOAL_MAGIC, Goal, Gripper, Phase, Reason};
use shared::profile::LineProfile;
use shared::task::STANDOFF_M;

/// Number of legs of every motion.
pub const LEGS: usize = 9;

/// What the arm does during a leg.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Motion {
    /// Nothing.
    Hold,
    /// All joints from rest to rest.
    Joints(JointMove),
    /// The gripper along a straight line of the task.
    Line(LineProfile),
}

/// One part of the motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Leg {
    /// What it is called in targets and statuses.
    pub phase: Phase,
    /// What the gripper is told from the first target of the leg on.
    pub gripper: Gripper,
    /// How the arm moves.
    pub motion: Motion,
    /// Targets of the leg; a leg of none is skipped.
    pub targets: u32,
}

impl Leg {
    /// Joint angles at time `t_s` after the leg's start, rad, when those of the target before are `last_rad`.
    pub fn joints_rad(&self, frame: &TaskFrame, t_s: f64, last_rad: &Joints) -> Result<Joints, Reason> {
        match &self.motion {
            Motion::Hold => Ok(*last_rad),
            Motion::Joints(path) => Ok(path.joints_rad(t_s)),
            Motion::Line(profile) => {
                let pose = motion::pose_on_line(frame, profile, t_s);
                ik::solve_near(&pose, last_rad).map_err(|_| Reason::Unreachable)
            }
        }
    }

    /// What is left of the leg after its target number `target`, from rest again; none where it holds still.
    pub fn left_after(&self, target: u32, period_s: f64) -> Option<Self> {
        let t_s = f64::from(target) * period_s;
        let (motion, duration_s) = match &self.motion {
            Motion::Hold => return None,
            Motion::Joints(path) => {
                let left = path.left_after(t_s);
                (Motion::Joints(left), left.duration_s())
            }
            Motion::Line(profile) => {
                let left = profile.left_after(t_s);
                (Motion::Line(left), left.duration_s())
            }
        };
        Some(Self {
            motion,
            targets: targets_in(duration_s, period_s),
            ..*self
        })
    }
}

/// Targets that it takes to last so long.
fn targets_in(duration_s: f64, period_s: f64) -> u32 {
    (duration_s / period_s).ceil() as u32
}

/// The motion that serves one goal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plan {
    /// The goal.
    pub goal_id: u64,
    /// Where the gripper opens, (x, z) in the task frame, m.
    pub release_m: [f64; 2],
    /// In order of time.
    pub legs: [Leg; LEGS],
}

/// Where the policy releases this rope for this goal, (x, z) in m, once both are found sensible.
pub fn release_point(blob: &Blob, goal: &Goal) -> Result<([f64; 2], f64), Reason> {
    let rope = blob.ropes.get(goal.rope as usize).ok_or(Reason::UnknownRope)?;
    let task = &blob.task;
    let trained = blob
        .policy
        .ranges()
        .contain(goal.x_m, rope.young_pa, rope.poisson);
    if !(trained && task.goal_x_m.contains(goal.x_m) && rope.reach_m.contains(goal.x_m)) {
        return Err(Reason::OutOfRange);
    }
    let release_m = blob.policy.release_point_m(goal.x_m, rope.young_pa, rope.poisson);
    // A NaN is in no interval and within no length.
    let inside = task.release_x_m.contains(release_m[0]) && task.release_z_m.contains(release_m[1]);
    let within_rope = task.span_m(release_m) <= task.free_length_m(rope.length_m);
    if inside && within_rope {
        Ok((release_m, rope.length_m))
    } else {
        Err(Reason::ReleaseOutOfRange)
    }
}

/// The goal number `k` of many that a client could ask for: the ropes in turn, each over what it may be asked.
pub fn likely_goal(blob: &Blob, k: u64) -> Goal {
    const SHARES: u64 = 16;
    let ropes = blob.ropes.len().max(1) as u64;
    let rope = k % ropes;
    let share = ((k / ropes) % SHARES) as f64 / (SHARES - 1) as f64;
    let (trained, task) = (&blob.policy.ranges().goal_x_m, &blob.task.goal_x_m);
    let x_m = blob.ropes.get(rope as usize).map_or(f64::NAN, |rope| {
        let x_m = rope.reach_m.at(share);
        x_m.max(trained.low)
            .max(task.low)
            .min(trained.high)
            .min(task.high)
    });
    Goal {
        magic: GOAL_MAGIC,
        id: 1,
        x_m,
        rope: rope as u32,
        ..Goal::default()
    }
}

/// Where a motion begins, at rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Start {
    /// The newest target, rad.
    pub q_rad: Joints,
    /// What the gripper was told last.
    pub gripper: Gripper,
}

/// The times that a motion is laid out with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pace {
    /// Time between two targets, s.
    pub period_s: f64,
    /// How long before the release the gripper is told to open, s; at most the dwell.
    pub gripper_lead_s: f64,
}

/// Plans the motion for `goal`; lines that the survey vouches for need no check of their own.
pub fn plan(
    blob: &Blob,
    survey: Option<&Survey>,
    goal: &Goal,
    from: &Start,
    pace: &Pace,
) -> Result<Plan, Reason> {
    let (release_m, length_m) = release_point(blob, goal)?;
    let tip_m = blob.task.hanging_tip_m(length_m);
    let before_tip_m = [tip_m[0] - STANDOFF_M, tip_m[1]];
    let after_m = [release_m[0] - STANDOFF_M, release_m[1]];
    let line = |from, to| {
        let profile = motion::profile_in_plane(from, to, &blob.motion);
        match survey {
            Some(survey) if survey.vouches_for(from, to, &profile) => Ok(profile),
            _ => motion::plan_line(&blob.frame, from, to, &blob.motion).map_err(refusal),
        }
    };
    let approach = line(before_tip_m, tip_m)?;
    let drag = line(tip_m, release_m)?;
    let retreat = line(release_m, after_m)?;
    let start = arm::task_pose(&blob.frame, before_tip_m);
    let start_rad = ik::solve(&start).map_err(|error| refusal(LineError::Pose(error)))?;
    let homing = homing(&blob.frame, from.q_rad, start_rad)?;

    let targets = |duration_s: f64| targets_in(duration_s, pace.period_s);
    let hold = |phase, gripper, targets| Leg {
        phase,
        gripper,
        motion: Motion::Hold,
        targets,
    };
    let straight = |phase, gripper, profile: LineProfile| Leg {
        phase,
        gripper,
        motion: Motion::Line(profile),
        targets: targets(profile.duration_s()),
    };
    // What it takes to let go, it may take to grip.
    let moved = targets(pace.gripper_lead_s + GRIPPER_S);
    // A gripper left closed by a cancelled goal lets go before the arm moves.
    let opening = if from.gripper == Gripper::Closed { moved } else { 0 };
    // Told early by the time it takes to let go, the gripper lets go when the dwell ends.
    let dwell = targets(blob.task.dwell_s);
    let lead = ((pace.gripper_lead_s / pace.period_s).round() as u32).min(dwell);
    let legs = [
        hold(Phase::Homing, Gripper::Open, opening),
        Leg {
            phase: Phase::Homing,
            gripper: Gripper::Open,
            motion: Motion::Joints(homing),
            targets: targets(homing.duration_s()),
        },
        straight(Phase::Approach, Gripper::Open, approach),
        hold(Phase::Grasp, Gripper::Closed, moved),
        straight(Phase::Drag, Gripper::Closed, drag),
        hold(Phase::Dwell, Gripper::Closed, dwell - lead),
        hold(Phase::Dwell, Gripper::Open, lead),
        hold(Phase::Release, Gripper::Open, targets(GRIPPER_S)),
        straight(Phase::Retreat, Gripper::Open, retreat),
    ];
    Ok(Plan {
        goal_id: goal.id,
        release_m,
        legs,
    })
}

/// The joint motion to the first pose, which may not lead below the table; an arm that stands lower may not go lower still.
fn homing(frame: &TaskFrame, from_rad: Joints, to_rad: Joints) -> Result<JointMove, Reason> {
    let homing = JointMove::new(from_rad, to_rad);
    let table_m = frame.flange_m([0.0, 0.0])[2];
    let lowest_m = table_m.min(arm::flange(&from_rad).position_m[2]) - HOMING_DIP_M;
    if homing.lowest_flange_m() < lowest_m {
        return Err(Reason::HomingTooLow);
    }
    Ok(homing)
}

fn refusal(error: LineError) -> Reason {
    match error {
        LineError::Pose(_) => Reason::Unreachable,
        LineError::TooFast => Reason::TooFast,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample;
    use shared::arm::LEVEL_POSTURE_RAD;

    #[test]
    fn likely_goals_are_planned_to_the_end() {
        let blob = sample::blob();
        let start = Start {
            q_rad: LEVEL_POSTURE_RAD,
            gripper: Gripper::Open,
        };
        let pace = Pace {
            period_s: 0.004,
            gripper_lead_s: 0.0,
        };
        for k in 0..40 {
            let goal = likely_goal(&blob, k);
            let planned = plan(&blob, None, &goal, &start, &pace);
            assert!(planned.is_ok(), "{goal:?}: {planned:?}");
        }
    }

    /// From here the straight joint path led the flange 67 mm below the table.
    #[test]
    fn no_joint_motion_leads_through_the_table() {
        let mut blob = sample::blob();
        blob.frame.origin_m = [0.35, 0.0, 0.12];
        let pace = Pace {
            period_s: 0.004,
            gripper_lead_s: 0.0,
        };
        let asked = |q_rad| {
            let gripper = Gripper::Open;
            plan(
                &blob,
                None,
                &likely_goal(&blob, 0),
                &Start { q_rad, gripper },
                &pace,
            )
        };
        let aside = [-0.898, 1.306, -0.378, 2.062, -2.36, 2.246, 0.0];
        assert_eq!(asked(aside), Err(Reason::HomingTooLow));
        assert!(asked(LEVEL_POSTURE_RAD).is_ok());
    }

    /// After 0.8 s, whatever its latency, the arm moved off with the rope still held.
    #[test]
    fn the_arm_waits_for_a_slow_gripper() {
        let blob = sample::blob();
        let pace = Pace {
            period_s: 0.004,
            gripper_lead_s: 2.0,
        };
        let start = Start {
            q_rad: LEVEL_POSTURE_RAD,
            gripper: Gripper::Closed,
        };
        let legs = plan(&blob, None, &likely_goal(&blob, 0), &start, &pace)
            .unwrap()
            .legs;
        let held_s = |leg: &Leg| f64::from(leg.targets) * pace.period_s;
        let (opens, grips) = (&legs[0], &legs[3]);
        assert_eq!([opens.gripper, grips.gripper], [Gripper::Open, Gripper::Closed]);
        assert!(opens.motion == Motion::Hold && held_s(opens) >= 2.8, "{opens:?}");
        assert!(grips.motion == Motion::Hold && held_s(grips) >= 2.8, "{grips:?}");
    }
}
