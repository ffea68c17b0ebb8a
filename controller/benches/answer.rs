//! What an answer costs: the policy's forward pass, inverse kinematics, and the whole plan of a goal.

use controller::plan::{self, Pace, Start};
use controller::sample;
use controller::survey::Survey;
use criterion::{Criterion, criterion_group, criterion_main};
use shared::arm::{self, LEVEL_POSTURE_RAD};
use shared::ik;
use shared::messages::{GOAL_MAGIC, Goal, Gripper};
use std::hint::black_box;

/// Release points along a line, m.
fn points() -> impl Iterator<Item = [f64; 2]> {
    (0..100).map(|k| [0.05 + 0.001 * f64::from(k), 0.15])
}

fn answer(criterion: &mut Criterion) {
    let blob = sample::blob();
    let rope = &blob.ropes[0];
    let poses: Vec<_> = points().map(|point| arm::task_pose(&blob.frame, point)).collect();

    let mut share = (0..100).map(|k| f64::from(k) * 0.01).cycle();
    criterion.bench_function("policy", |bencher| {
        bencher.iter(|| {
            let goal_x_m = rope.reach_m.at(share.next().unwrap_or(0.0));
            blob.policy
                .release_point_m(black_box(goal_x_m), rope.young_pa, rope.poisson)
        });
    });

    let mut pose = poses.iter().cycle();
    criterion.bench_function("ik/from_middle_posture", |bencher| {
        bencher.iter(|| pose.next().map(|pose| ik::solve(black_box(pose))));
    });

    // There and back again, so that the neighbour is always 1 mm away.
    let mut pose = poses.iter().chain(poses[1..99].iter().rev()).cycle();
    let mut seed = ik::solve(&poses[0]).expect("the line can be reached");
    criterion.bench_function("ik/from_1_mm_away", |bencher| {
        bencher.iter(|| {
            if let Some(Ok(next)) = pose.next().map(|pose| ik::solve_near(black_box(pose), &seed)) {
                seed = next;
            }
            seed
        });
    });

    let goal = Goal {
        magic: GOAL_MAGIC,
        stamp_ns: 0,
        id: 1,
        x_m: rope.reach_m.at(0.5),
        rope: 0,
        keep_alive_ms: 0,
    };
    let start = Start {
        q_rad: LEVEL_POSTURE_RAD,
        gripper: Gripper::Open,
    };
    let survey = Survey::new(&blob);
    let pace = Pace {
        period_s: 0.004,
        gripper_lead_s: 0.0,
    };
    let plan = || plan::plan(&blob, survey.as_ref(), black_box(&goal), &start, &pace);
    plan().expect("the goal can be reached");
    criterion.bench_function("whole_plan", |bencher| bencher.iter(plan));
}

criterion_group!(benches, answer);
criterion_main!(benches);
