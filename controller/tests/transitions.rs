//! Every transition of the state machine, on a virtual clock.

mod virtual_arm;

use controller::constants::FOLLOWING_ERROR_MAX_RAD;
use controller::sample;
use controller::step::{Inputs, Setup};
use shared::arm::{self, LEVEL_POSTURE_RAD};
use shared::blob::Blob;
use shared::messages::{CommandKind, Gripper, Phase, Reason};
use shared::profile::MotionLimits;
use virtual_arm::{SILENT_CYCLES, World, arm_at, limits_hold};

#[test]
fn no_target_before_the_arm_is_measured_at_rest() {
    let mut world = World::new();
    let state = world.arm.take();
    world.run(100);
    assert_eq!(world.controller.phase(), Phase::Waiting);
    let goal = world.goal_at(0.33);
    assert_eq!(world.ask(goal), Reason::NotReady);
    world.arm = state.map(|mut state| {
        state.dq_rad_s[2] = 0.5;
        state
    });
    world.run(10);
    assert!(world.targets.is_empty(), "the arm moves");
    let refused = |world: &mut World| {
        let goal = world.goal_at(0.33);
        world.ask(goal)
    };
    assert_eq!(refused(&mut world), Reason::NotReady);
    let mut twisted = LEVEL_POSTURE_RAD;
    twisted[3] = -1.0;
    world.arm = Some(arm_at(twisted));
    world.run(10);
    assert_eq!(refused(&mut world), Reason::JointOutOfRange);
    assert!(world.targets.is_empty());
    let mut measured = LEVEL_POSTURE_RAD;
    measured[1] += 0.123;
    world.arm = Some(arm_at(measured));
    world.run(1);
    assert_eq!(world.controller.phase(), Phase::Idle);
    assert_eq!(
        world.targets[0].q_rad, measured,
        "the first target is the present pose"
    );
    assert_eq!(world.targets[0].stream, 1);
}

#[test]
fn a_stream_begins_where_the_arm_is_when_the_first_target_is_due() {
    let three_cycles_to_a_target = Setup {
        cycles_per_target: 3,
        ..virtual_arm::setup()
    };
    let mut world = World::with(three_cycles_to_a_target);
    world.run(1);
    assert_eq!(world.targets.len(), 1, "the first cycle is due");
    for moved_after in 0..3 {
        let state = world.arm.take();
        world.run((SILENT_CYCLES as usize).next_multiple_of(3));
        world.arm = state;
        world.run(moved_after);
        world.arm.as_mut().unwrap().q_rad[0] += 0.1 + FOLLOWING_ERROR_MAX_RAD;
        let measured = world.arm.map(|arm| arm.q_rad);
        let sent = world.targets.len();
        world.run(3 - moved_after);
        let first = world.targets.get(sent).map(|target| target.q_rad);
        assert_eq!(
            first, measured,
            "moved after it was heard for {moved_after} cycles"
        );
        assert_eq!(world.latch(), Reason::Accepted);
    }
}

#[test]
fn a_goal_runs_through_every_phase_and_opens_once() {
    let mut world = World::idle();
    let id = world.accept();
    assert_eq!(world.status.active_goal_id, id);
    world.run_to(Phase::Retreat);
    world.run_to(Phase::Idle);
    world.run(1);
    assert_eq!(
        (world.status.finished_goal_id, world.status.finished_reason),
        (id, Reason::Done.code())
    );
    let mut phases: Vec<u32> = world.targets.iter().map(|target| target.phase).collect();
    phases.dedup();
    assert_eq!(phases, [1, 2, 3, 4, 5, 6, 7, 8, 1]);
    let changes: Vec<(u32, u32)> = world
        .targets
        .windows(2)
        .filter(|pair| pair[0].gripper != pair[1].gripper)
        .map(|pair| (pair[1].phase, pair[1].gripper))
        .collect();
    assert_eq!(
        changes,
        [
            (Phase::Grasp.code(), Gripper::Closed.code()),
            (Phase::Release.code(), Gripper::Open.code())
        ]
    );
    limits_hold(&world.targets).unwrap();
}

#[test]
fn the_drag_ends_at_the_policys_release_point() {
    let mut world = World::idle();
    world.accept();
    world.run_to(Phase::Release);
    let blob = sample::blob();
    let release_m = blob
        .policy
        .release_point_m(0.33, blob.ropes[0].young_pa, blob.ropes[0].poisson);
    let wanted_m = blob.frame.flange_m(release_m);
    let last = world.targets.last().unwrap();
    let reached_m: [f64; 3] = arm::flange(&last.q_rad).position_m.into();
    for axis in 0..3 {
        assert!((reached_m[axis] - wanted_m[axis]).abs() < 1e-7);
    }
}

#[test]
fn each_bad_goal_gets_its_reason_and_changes_nothing() {
    let mut world = World::idle();
    let good = world.goal_at(0.33);
    let bad = |change: &dyn Fn(&mut shared::messages::Goal)| {
        let mut goal = good;
        change(&mut goal);
        goal
    };
    let cases = [
        (bad(&|goal| goal.magic = 7), Reason::Malformed),
        (bad(&|goal| goal.id = 0), Reason::Malformed),
        (bad(&|goal| goal.x_m = f64::NAN), Reason::NonFinite),
        (bad(&|goal| goal.x_m = f64::INFINITY), Reason::NonFinite),
        (bad(&|goal| goal.x_m = 2.0), Reason::OutOfRange),
        (bad(&|goal| goal.x_m = -0.3), Reason::OutOfRange),
        (bad(&|goal| goal.rope = 1), Reason::UnknownRope),
        (bad(&|goal| goal.stamp_ns -= 600_000_000), Reason::Stale),
        (bad(&|goal| goal.stamp_ns += 600_000_000), Reason::FromFuture),
    ];
    for (goal, reason) in cases {
        assert_eq!(world.ask(goal), reason, "{goal:?}");
        assert_eq!(world.controller.phase(), Phase::Idle);
    }
    assert_eq!(world.status.goals_refused, 9);
    assert_eq!(world.ask(good), Reason::Accepted);
    let second = world.goal_at(0.34);
    assert_eq!(world.ask(second), Reason::Busy);
    world.run_to(Phase::Idle);
    let mut repeated = good;
    repeated.stamp_ns = world.now_ns;
    assert_eq!(world.ask(repeated), Reason::OutOfOrder);
}

/// A world whose policy file was changed.
fn changed(change: impl Fn(&mut Blob)) -> World {
    let mut setup = virtual_arm::setup();
    change(&mut setup.blob);
    let mut world = World::with(setup);
    world.run(2);
    world
}

#[test]
fn what_the_arm_or_the_rope_cannot_do_is_refused_before_it_moves() {
    type Change = fn(&mut Blob);
    let cases: [(Change, Reason); 4] = [
        (|blob| blob.frame.origin_m[0] = 0.9, Reason::Unreachable),
        (|blob| blob.frame.origin_m[0] = 0.05, Reason::Unreachable),
        (|blob| blob.ropes[0].length_m = 0.1, Reason::ReleaseOutOfRange),
        (
            |blob| {
                blob.motion = MotionLimits {
                    speed_m_s: 1.0,
                    acceleration_m_s2: 50.0,
                    jerk_m_s3: 1000.0,
                }
            },
            Reason::TooFast,
        ),
    ];
    for (change, reason) in cases {
        let mut world = changed(change);
        let goal = world.goal_at(0.33);
        assert_eq!(world.ask(goal), reason);
        assert_eq!(world.controller.phase(), Phase::Idle);
    }
}

#[test]
fn a_turned_and_shifted_task_is_served_within_the_limits() {
    for yaw_rad in [-0.6f64, 0.3, 1.2] {
        let mut world = changed(|blob| {
            let (sin, cos) = (yaw_rad + 0.15).sin_cos();
            blob.frame.yaw_rad = yaw_rad;
            blob.frame.origin_m = [0.35 * cos, 0.35 * sin, 0.12];
            blob.motion.speed_m_s = 0.25;
            blob.motion.jerk_m_s3 = 40.0;
        });
        world.accept();
        world.run_to(Phase::Retreat);
        world.run_to(Phase::Idle);
        assert_eq!(world.latch(), Reason::Accepted);
        limits_hold(&world.targets).unwrap();
    }
}

#[test]
fn an_emergency_stop_latches_from_every_phase() {
    for phase in [
        Phase::Idle,
        Phase::Homing,
        Phase::Approach,
        Phase::Grasp,
        Phase::Drag,
        Phase::Dwell,
        Phase::Release,
        Phase::Retreat,
    ] {
        let mut world = World::idle();
        if phase != Phase::Idle {
            world.accept();
            world.run_to(phase);
            world.run(40);
        }
        let gripper = world.status.gripper;
        assert_eq!(world.command(CommandKind::EmergencyStop), Reason::Accepted);
        world.run_to(Phase::Fault);
        assert_eq!(world.latch(), Reason::EmergencyStop);
        assert_eq!(world.status.gripper, gripper, "a stop does not drop the rope");
        let sent = world.targets.len();
        world.run(100);
        assert_eq!(world.targets.len(), sent, "a fault sends nothing");
        let goal = world.goal_at(0.33);
        assert_eq!(world.ask(goal), Reason::Latched);
        assert_eq!(world.command(CommandKind::Reset), Reason::Accepted);
        world.run_to(Phase::Idle);
        assert_eq!(world.latch(), Reason::Accepted);
        world.accept();
        world.run_to(Phase::Retreat);
        limits_hold(&world.targets).unwrap();
        assert_eq!(world.targets.last().unwrap().stream, 2, "a stream begins anew");
    }
}

#[test]
fn after_a_fault_the_stream_begins_where_the_arm_is_however_little_it_moved() {
    for moved_rad in [0.5, 0.019, 0.0] {
        let mut world = World::idle();
        world.command(CommandKind::EmergencyStop);
        world.run_to(Phase::Fault);
        let arm = world.arm.as_mut().unwrap();
        arm.q_rad[0] += moved_rad;
        let moved = arm.q_rad;
        world.command(CommandKind::Reset);
        world.run(2);
        let last = world.targets.last().unwrap();
        assert_eq!((last.stream, last.q_rad), (2, moved), "{moved_rad} rad");
    }
}

/// A controller that died while the gripper held the rope is started again.
#[test]
fn the_first_target_leaves_the_gripper_as_the_arm_reports_it() {
    for gripper in [Gripper::Closed, Gripper::Open] {
        let mut world = World::new();
        world.arm.as_mut().unwrap().gripper = gripper.code();
        world.run(20);
        assert!(!world.targets.is_empty());
        assert!(
            world
                .targets
                .iter()
                .all(|target| target.gripper == gripper.code())
        );
        world.accept();
        world.run_to(Phase::Homing);
        world.run(2);
        assert_eq!(world.targets.last().unwrap().gripper, Gripper::Open.code());
    }
}

/// Its driver had crashed, and a person opened the gripper to free the rope: it snapped shut with the first target.
#[test]
fn a_later_stream_leaves_the_gripper_as_the_arm_reports_it_too() {
    for gripper in [Gripper::Closed, Gripper::Open] {
        let mut world = World::idle();
        world.command(CommandKind::EmergencyStop);
        world.run_to(Phase::Fault);
        world.arm.as_mut().unwrap().gripper = gripper.code();
        world.command(CommandKind::Reset);
        world.run(2);
        let last = world.targets.last().unwrap();
        assert_eq!((last.stream, last.gripper), (2, gripper.code()));
    }
}

#[test]
fn an_error_of_the_arm_latches_while_waiting_too() {
    let mut world = World::new();
    world.arm.as_mut().unwrap().error_code = 2;
    world.run(3);
    assert_eq!(
        (world.controller.phase(), world.latch()),
        (Phase::Fault, Reason::RobotFault)
    );
    world.arm.as_mut().unwrap().error_code = 0;
    world.run(1);
    assert_eq!(world.command(CommandKind::Reset), Reason::Accepted);
    world.run_to(Phase::Idle);
}

#[test]
fn a_plan_made_ahead_is_not_used_when_the_motion_begins_elsewhere() {
    let mut world = World::idle();
    world.command(CommandKind::EmergencyStop);
    world.run_to(Phase::Fault);
    world.arm.as_mut().unwrap().q_rad[0] += 0.5;
    // In one cycle the reset begins a stream where the arm is now and the goal is judged.
    world.plans_ahead = true;
    let goal = world.goal_at(0.33);
    world.next.goal = Some(goal);
    assert_eq!(world.command(CommandKind::Reset), Reason::Accepted);
    world.run_to(Phase::Retreat);
    limits_hold(&world.targets).unwrap();
    assert_eq!(world.latched, [Reason::EmergencyStop]);
}

#[test]
fn a_cancelled_goal_ends_idle_and_the_next_one_opens_first() {
    let mut world = World::idle();
    let id = world.accept();
    world.run_to(Phase::Drag);
    world.run(100);
    assert_eq!(world.command(CommandKind::Cancel), Reason::Accepted);
    world.run_to(Phase::Idle);
    assert_eq!(
        (world.status.finished_goal_id, world.status.finished_reason),
        (id, Reason::Cancelled.code())
    );
    assert_eq!(world.targets.last().unwrap().gripper, Gripper::Closed.code());
    let before = world.targets.len();
    world.accept();
    world.run(20);
    assert_eq!(world.targets[before + 1].gripper, Gripper::Open.code());
    assert_eq!(
        world.targets[before].q_rad,
        world.targets[before + 15].q_rad,
        "open before moving"
    );
    world.run_to(Phase::Retreat);
    limits_hold(&world.targets).unwrap();
    let stamps = world.targets.windows(2);
    let mut gaps_ns: Vec<u64> = stamps.map(|pair| pair[1].stamp_ns - pair[0].stamp_ns).collect();
    gaps_ns.dedup();
    assert_eq!(gaps_ns.len(), 1, "one target each period: {gaps_ns:?}");
}

#[test]
fn silence_of_the_arm_stops_a_motion_and_only_pauses_idleness() {
    let mut world = World::idle();
    let state = world.arm.take();
    world.run(SILENT_CYCLES as usize + 2);
    assert_eq!(world.controller.phase(), Phase::Waiting);
    world.arm = state;
    world.run_to(Phase::Idle);
    world.accept();
    world.run_to(Phase::Drag);
    world.run(50);
    world.arm = None;
    world.run_to(Phase::Fault);
    assert_eq!(world.latch(), Reason::RobotSilent);
    limits_hold(&world.targets).unwrap();
}

/// A driver that has lost its arm and sends the last measurement again and again was believed for twice as long.
#[test]
fn a_measurement_that_is_repeated_counts_as_silence() {
    let mut world = World::idle();
    let state = world.arm.take();
    for _ in 0..SILENT_CYCLES + 2 {
        world.next.robot = state;
        world.run(1);
    }
    assert_eq!(world.controller.phase(), Phase::Waiting);
}

#[test]
fn nonsense_from_the_arm_counts_as_silence() {
    let mut world = World::idle();
    world.accept();
    world.run_to(Phase::Approach);
    world.follows = false;
    world.arm.as_mut().unwrap().q_rad[3] = f64::NAN;
    world.run_to(Phase::Fault);
    assert_eq!(world.latch(), Reason::RobotSilent);
    assert!(world.status.messages_ignored >= SILENT_CYCLES);
}

#[test]
fn an_arm_that_does_not_follow_or_reports_an_error_is_a_fault() {
    let mut world = World::idle();
    world.accept();
    world.follows = false;
    world.run_to(Phase::Fault);
    assert_eq!(world.latch(), Reason::FollowingError);
    limits_hold(&world.targets).unwrap();
    let mut world = World::idle();
    world.accept();
    world.run(100);
    world.arm.as_mut().unwrap().error_code = 24;
    world.run_to(Phase::Fault);
    assert_eq!(world.latch(), Reason::RobotFault);
}

#[test]
fn a_goal_whose_client_falls_silent_is_stopped() {
    let mut world = World::idle();
    let mut goal = world.goal_at(0.33);
    goal.keep_alive_ms = 100;
    assert_eq!(world.ask(goal), Reason::Accepted);
    let answered = world.status.command_id;
    for _ in 0..20 {
        world.run(24);
        world.keep_alive(goal.id);
    }
    world.run(1);
    assert_eq!(world.latch(), Reason::Accepted);
    assert_eq!(world.status.command_id, answered, "a keep-alive gets no answer");
    world.keep_alive(goal.id + 1);
    world.run_to(Phase::Fault);
    assert_eq!(world.latch(), Reason::GoalSourceSilent);
    assert_eq!(world.status.finished_reason, Reason::GoalSourceSilent.code());
    limits_hold(&world.targets).unwrap();
}

#[test]
fn a_goal_without_a_promise_needs_no_keep_alive() {
    let mut world = World::idle();
    world.accept();
    world.run_to(Phase::Retreat);
    world.run_to(Phase::Idle);
    assert_eq!(world.latch(), Reason::Accepted);
}

#[test]
fn a_driver_that_does_not_read_the_targets_is_noticed() {
    let mut world = World::idle();
    world.accept();
    world.run_to(Phase::Grasp);
    world.reads = false;
    world.run_to(Phase::Fault);
    assert_eq!(world.latch(), Reason::TargetsUnread);
    limits_hold(&world.targets).unwrap();
    assert_eq!(world.command(CommandKind::Reset), Reason::Accepted);
    world.run_to(Phase::Idle);
    world.run(SILENT_CYCLES as usize);
    let goal = world.goal_at(0.33);
    assert_eq!(world.ask(goal), Reason::TargetsUnread, "nothing moves unread");
    assert_eq!(world.controller.phase(), Phase::Idle);
    world.reads = true;
    world.run(2);
    world.accept();
}

/// It knows of no target that was sent before it.
#[test]
fn a_driver_that_was_restarted_may_be_given_a_goal_at_once() {
    let mut world = World::idle();
    world.run(3 * SILENT_CYCLES as usize);
    let arm = world.arm.take();
    world.run_to(Phase::Waiting);
    world.arm = arm;
    world.arm.as_mut().unwrap().target_seq = 0;
    world.reads = false;
    world.run_to(Phase::Idle);
    let goal = world.goal_at(0.33);
    assert_eq!(world.ask(goal), Reason::Accepted);
}

#[test]
fn a_driver_that_claims_to_have_read_what_was_never_sent_has_not_read() {
    let mut world = World::idle();
    world.accept();
    world.run_to(Phase::Grasp);
    world.reads = false;
    world.arm.as_mut().unwrap().target_seq = u64::MAX;
    world.run_to(Phase::Fault);
    assert_eq!(world.latch(), Reason::TargetsUnread);
}

#[test]
fn the_gripper_is_told_to_open_its_latency_before_the_release() {
    for (lead_ms, early) in [(0, 0), (120, 30), (10, 3), (2000, 500)] {
        let mut world = World::with(Setup {
            gripper_lead_ns: lead_ms * 1_000_000,
            ..virtual_arm::setup()
        });
        world.run(2);
        world.accept();
        world.run_to(Phase::Release);
        let targets = &world.targets;
        let release = targets.len() - 1;
        assert_eq!(targets[release].phase, Phase::Release.code());
        let opens = 1 + targets
            .iter()
            .rposition(|target| target.gripper == Gripper::Closed.code())
            .expect("the gripper was closed");
        assert_eq!(release - opens, early, "{lead_ms} ms");
        let dwell = targets
            .iter()
            .filter(|target| target.phase == Phase::Dwell.code());
        assert_eq!(dwell.count(), 500, "the dwell is as long as ever");
    }
}

#[test]
fn shutting_down_ends_at_once_where_nothing_moves_and_after_every_stop() {
    type Prepare = fn(&mut World);
    let cases: [(&str, Prepare); 5] = [
        ("waiting", |world| world.arm = None),
        ("idle", |world| world.run_to(Phase::Idle)),
        ("fault", |world| {
            world.run_to(Phase::Idle);
            world.command(CommandKind::EmergencyStop);
            world.run_to(Phase::Fault);
        }),
        ("cancelling", |world| {
            world.run_to(Phase::Idle);
            world.accept();
            world.run(200);
            world.command(CommandKind::Cancel);
        }),
        ("stopping", |world| {
            world.run_to(Phase::Idle);
            world.accept();
            world.run(200);
            world.command(CommandKind::EmergencyStop);
        }),
    ];
    for (name, prepare) in cases {
        let mut world = World::new();
        prepare(&mut world);
        let moving = world.controller.phase() == Phase::Stopping;
        for _ in 0..200 {
            world.next.shutdown = true;
            world.run(1);
            if world.ended {
                break;
            }
            assert!(moving, "{name}: nothing moves");
        }
        assert_eq!(world.controller.phase(), Phase::Ended, "{name}");
        limits_hold(&world.targets).unwrap();
    }
}

#[test]
fn shutting_down_slows_down_first() {
    let mut world = World::idle();
    world.accept();
    world.run_to(Phase::Homing);
    world.run(100);
    for _ in 0..200 {
        world.next = Inputs {
            shutdown: true,
            ..Inputs::default()
        };
        world.run(1);
    }
    assert!(world.ended);
    assert_eq!(world.controller.phase(), Phase::Ended);
    assert_eq!(world.status.finished_reason, Reason::Shutdown.code());
    let [before, last] = world.targets.last_chunk::<2>().unwrap();
    assert!(
        (0..7).all(|i| (last.q_rad[i] - before.q_rad[i]).abs() < 1e-9),
        "at rest"
    );
    limits_hold(&world.targets).unwrap();
}
