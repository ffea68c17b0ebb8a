//! What stops, resets and other commands do to each other and to goals, in whatever order they arrive, on a virtual
//! clock.

mod virtual_arm;

use shared::messages::{CommandKind, Phase, Reason};
use virtual_arm::{World, limits_hold};

#[test]
fn a_reset_waits_for_the_stop_and_for_the_arm() {
    let mut world = World::idle();
    assert_eq!(world.command(CommandKind::Reset), Reason::NothingToReset);
    world.accept();
    world.run_to(Phase::Approach);
    world.run(60);
    world.command(CommandKind::EmergencyStop);
    assert_eq!(world.command(CommandKind::Reset), Reason::StillMoving);
    world.run_to(Phase::Fault);
    world.arm.as_mut().unwrap().error_code = 2;
    assert_eq!(world.command(CommandKind::Reset), Reason::RobotNotAtRest);
    world.arm.as_mut().unwrap().error_code = 0;
    assert_eq!(world.command(CommandKind::Reset), Reason::Accepted);
}

/// Queues deliver a stop before what was sent ahead of it.
#[test]
fn a_reset_sent_before_the_stop_does_not_undo_it() {
    let mut world = World::idle();
    world.command(CommandKind::EmergencyStop);
    world.run_to(Phase::Fault);
    let mut reset = world.order(CommandKind::Reset);
    world.run(1);
    world.command(CommandKind::EmergencyStop);
    world.next.command = Some(reset);
    world.run(1);
    assert_eq!(world.status.command_id, reset.id);
    assert_eq!(world.status.command_reason, Reason::OutOfOrder.code());
    assert_eq!(world.controller.phase(), Phase::Fault);
    reset.stamp_ns = world.now_ns;
    world.next.command = Some(reset);
    world.run(1);
    assert_eq!(world.latch(), Reason::Accepted);
}

#[test]
fn a_goal_sent_before_a_cancel_that_overtook_it_is_not_served() {
    for kind in [CommandKind::Cancel, CommandKind::EmergencyStop] {
        let mut world = World::idle();
        let goal = world.goal_at(0.33);
        world.run(1);
        world.command(kind);
        if kind == CommandKind::EmergencyStop {
            world.run_to(Phase::Fault);
            world.command(CommandKind::Reset);
            world.run_to(Phase::Idle);
        }
        assert_eq!(world.ask(goal), Reason::Cancelled, "{kind:?}");
        assert_eq!(world.controller.phase(), Phase::Idle);
        world.accept();
    }
}

/// A stamp of another clock, far ahead, must not forbid every later reset and goal.
#[test]
fn a_stop_with_a_stamp_from_the_future_can_be_reset() {
    let mut world = World::idle();
    let mut stop = world.order(CommandKind::EmergencyStop);
    stop.stamp_ns = u64::MAX;
    world.next.command = Some(stop);
    world.run_to(Phase::Fault);
    assert_eq!(world.command(CommandKind::Reset), Reason::Accepted);
    world.run_to(Phase::Idle);
    world.accept();
}

/// Where nobody knows when the stop was sent, a reset that waits beside it does not undo it.
#[test]
fn a_stop_without_a_stamp_is_as_new_as_its_arrival() {
    let mut world = World::idle();
    world.command(CommandKind::EmergencyStop);
    world.run_to(Phase::Fault);
    let reset = world.order(CommandKind::Reset);
    world.run(1);
    let mut stop = world.order(CommandKind::EmergencyStop);
    stop.stamp_ns = 0;
    world.next.command = Some(stop);
    world.run(1);
    world.next.command = Some(reset);
    world.run(1);
    assert_eq!(world.status.command_reason, Reason::OutOfOrder.code());
    assert_eq!(world.controller.phase(), Phase::Fault);
}

#[test]
fn what_is_no_command_is_ignored_and_a_malformed_one_is_answered() {
    let mut world = World::idle();
    world.next.command = Some(Default::default());
    // A status is due within 100 ms.
    world.run(30);
    assert_eq!((world.status.command_id, world.status.messages_ignored), (0, 1));
    let mut unknown = world.order(CommandKind::Reset);
    unknown.kind = 77;
    world.next.command = Some(unknown);
    world.run(1);
    assert_eq!(world.status.command_id, unknown.id);
    assert_eq!(world.status.command_reason, Reason::Malformed.code());
    assert_eq!(world.controller.phase(), Phase::Idle);
}

#[test]
fn an_emergency_stop_without_an_id_stops_all_the_same() {
    let mut world = World::idle();
    let mut stop = world.order(CommandKind::EmergencyStop);
    stop.id = 0;
    world.next.command = Some(stop);
    world.run_to(Phase::Fault);
    assert_eq!(world.latch(), Reason::EmergencyStop);
}

#[test]
fn an_emergency_stop_latches_while_waiting_too() {
    let mut world = World::new();
    let state = world.arm.take();
    world.run(5);
    assert_eq!(world.command(CommandKind::EmergencyStop), Reason::Accepted);
    assert_eq!(world.controller.phase(), Phase::Fault);
    assert_eq!(world.latch(), Reason::EmergencyStop);
    assert_eq!(
        world.command(CommandKind::Reset),
        Reason::RobotNotAtRest,
        "a silent arm is not known to rest"
    );
    world.arm = state;
    world.run(1);
    assert_eq!(world.command(CommandKind::Reset), Reason::Accepted);
    world.run_to(Phase::Idle);
}

/// A stop under way: what is asked for in the middle of it, and where it ends.
#[test]
fn a_stop_under_way_can_only_become_stricter() {
    use CommandKind::{Cancel, EmergencyStop};
    for (first, second, end) in [
        (Cancel, EmergencyStop, Phase::Fault),
        (EmergencyStop, Cancel, Phase::Fault),
        (EmergencyStop, EmergencyStop, Phase::Fault),
        (Cancel, Cancel, Phase::Idle),
    ] {
        let mut world = World::idle();
        world.accept();
        world.run_to(Phase::Homing);
        world.run(100);
        world.command(first);
        world.run(2);
        world.command(second);
        assert_eq!(world.controller.phase(), Phase::Stopping);
        world.run_to(end);
        world.run(20);
        assert_eq!(world.controller.phase(), end, "{first:?} {second:?}");
        let ended = Reason::from_code(world.status.finished_reason).unwrap();
        let expected = if first == Cancel {
            Reason::Cancelled
        } else {
            Reason::EmergencyStop
        };
        assert_eq!(ended, expected, "the goal ended for the first of the two");
        limits_hold(&world.targets).unwrap();
    }
}
