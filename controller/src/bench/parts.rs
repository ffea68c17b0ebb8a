//! What the parts of an answer cost, in ns.

use crate::clock;
use crate::plan::{self, Pace, Start};
use crate::survey::Survey;
use crate::timing::{Percentiles, histogram};
use shared::arm::{self, LEVEL_POSTURE_RAD};
use shared::blob::Blob;
use shared::ik;
use shared::messages::{GOAL_MAGIC, Goal, Gripper};
use std::hint::black_box;

/// Times of one call each.
#[derive(Debug, serde::Serialize)]
pub struct Parts {
    /// One pass of the policy.
    pub policy: Percentiles,
    /// Inverse kinematics from the middle posture.
    pub ik_from_middle: Percentiles,
    /// Inverse kinematics from a neighbour 1 mm away, as along a line.
    pub ik_along_line: Percentiles,
    /// The whole plan of a goal, everything that can be refused included.
    pub plan: Percentiles,
    /// The same where the survey of the task vouches for no line, so that each is checked by itself.
    pub plan_unsurveyed: Percentiles,
}

/// Times every part.
pub fn time_all(blob: &Blob) -> Parts {
    let rope = &blob.ropes[0];
    let goal_m = |k: u32| rope.reach_m.at(f64::from(k % 100) * 0.01);
    let policy = time(20_000, |k| {
        black_box(
            blob.policy
                .release_point_m(goal_m(k), rope.young_pa, rope.poisson),
        );
    });
    let poses: Vec<_> = (0..100)
        .map(|k| arm::task_pose(&blob.frame, [0.05 + 0.001 * f64::from(k), 0.15]))
        .collect();
    let ik_from_middle = time(20_000, |k| {
        let _ = black_box(ik::solve(&poses[k as usize % 100]));
    });
    let mut seed = ik::solve(&poses[0]).unwrap_or_default();
    let ik_along_line = time(20_000, |k| {
        // There and back again, so that the neighbour is always 1 mm away.
        let step = k as usize % 198;
        let index = if step < 100 { step } else { 198 - step };
        if let Ok(next) = black_box(ik::solve_near(&poses[index], &seed)) {
            seed = next;
        }
    });
    let start = Start {
        q_rad: LEVEL_POSTURE_RAD,
        gripper: Gripper::Open,
    };
    let pace = Pace {
        period_s: 0.004,
        gripper_lead_s: 0.0,
    };
    let survey = Survey::new(blob);
    let plan = |survey: Option<&Survey>| {
        time(2_000, |k| {
            let goal = Goal {
                magic: GOAL_MAGIC,
                id: 1,
                x_m: goal_m(k),
                ..Goal::default()
            };
            let _ = black_box(plan::plan(blob, survey, &goal, &start, &pace));
        })
    };
    Parts {
        policy,
        ik_from_middle,
        ik_along_line,
        plan: plan(survey.as_ref()),
        plan_unsurveyed: plan(None),
    }
}

fn time(rounds: u32, mut part: impl FnMut(u32)) -> Percentiles {
    let mut times = histogram();
    for k in 0..rounds {
        let start = clock::now_ns();
        part(k);
        times.saturating_record(clock::now_ns() - start);
    }
    (&times).into()
}
