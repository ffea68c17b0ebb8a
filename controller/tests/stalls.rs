//! A program that is held up sends nothing meanwhile, so the arm comes to stand: what the controller does after that.

mod virtual_arm;

use shared::messages::{CommandKind, JointTarget, Phase, Reason};
use virtual_arm::{World, limits_hold};

/// Cycles that are held up: 300 ms.
const HELD_UP: u64 = 75;

/// The targets that serve a goal when the controller is held up for so many cycles, some time after a phase has begun.
fn served(phase: Phase, cycles: u64) -> Vec<JointTarget> {
    let mut world = World::idle();
    let goal_id = world.accept();
    world.run_to(phase);
    world.run(60);
    assert_eq!(world.controller.phase(), phase);
    world.stall(cycles);
    world.run(1);
    world.run_to(Phase::Idle);
    world.run(1);
    let finished = (world.status.finished_goal_id, world.status.finished_reason);
    assert_eq!(finished, (goal_id, Reason::Done.code()), "{phase:?}");
    world.targets
}

/// At full speed from a standstill a joint would be asked for 300 rad/s².
#[test]
fn after_a_stall_a_motion_goes_on_from_rest_and_ends_where_it_should() {
    for phase in [Phase::Homing, Phase::Approach, Phase::Drag, Phase::Retreat] {
        let [smooth, held_up] = [0, HELD_UP].map(|cycles| served(phase, cycles));
        assert_eq!(limits_hold(&held_up), Ok(()), "{phase:?}");
        for of in [Phase::Homing, Phase::Approach, Phase::Drag, Phase::Retreat] {
            let end = |targets: &[JointTarget]| targets.iter().rfind(|t| t.phase == of.code()).unwrap().q_rad;
            let (a, b) = (end(&smooth), end(&held_up));
            let apart = a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(apart < 1e-6, "{of:?} after a stall in {phase:?}: {apart}");
        }
        assert!(held_up.len() > smooth.len(), "it begins again slowly");
    }
}

/// While the rope comes to rest nothing moves, and the gripper opens as late as it was held up.
#[test]
fn a_stall_while_nothing_moves_changes_nothing() {
    let joints =
        |targets: Vec<JointTarget>| -> Vec<_> { targets.iter().map(|t| (t.q_rad, t.gripper)).collect() };
    let [smooth, held_up] = [0, HELD_UP].map(|cycles| joints(served(Phase::Dwell, cycles)));
    assert_eq!(smooth, held_up);
}

/// A few periods late, the arm still moves: what follows is sent as it was planned.
#[test]
fn a_short_delay_is_not_caught_up_and_changes_nothing() {
    let joints = |targets: Vec<JointTarget>| -> Vec<_> { targets.iter().map(|t| t.q_rad).collect() };
    let [smooth, late] = [0, 4].map(|cycles| joints(served(Phase::Drag, cycles)));
    assert_eq!(smooth, late);
}

#[test]
fn a_stop_that_is_held_up_is_over() {
    let mut world = World::idle();
    world.accept();
    world.run_to(Phase::Homing);
    world.run(60);
    assert_eq!(world.command(CommandKind::Cancel), Reason::Accepted);
    world.run(2);
    assert_eq!(world.controller.phase(), Phase::Stopping);
    world.stall(HELD_UP);
    let stands = world.targets.last().unwrap().q_rad;
    world.run(3);
    assert_eq!(world.controller.phase(), Phase::Idle);
    assert_eq!(world.targets.last().unwrap().q_rad, stands);
}
