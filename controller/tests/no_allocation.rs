//! The loop's turn allocates nothing: counted over 120 000 turns with goals good and bad, stops,
//! resets, a full set of queues, a real blackboard, and clients that come and go.

use controller::allocations::{Counting, watched};
use controller::client::Client;
use controller::cycle::{Cycle, Queues};
use controller::services;
use controller::session::Instance;
use controller::step::{Controller, Setup};
use controller::{bridge::Bridge, clock, sample, voice};
use shared::arm::LEVEL_POSTURE_RAD;
use shared::messages::{
    COMMAND_MAGIC, Command, CommandKind, GOAL_MAGIC, Goal, JointTarget, ROBOT_MAGIC, RobotState,
};
use std::time::Duration;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// What calls to the allocator `part` makes on this thread.
fn allocations(part: impl FnOnce()) -> u64 {
    let ((), calls) = watched(part);
    calls.expect("the counting allocator is installed")
}

#[test]
fn the_counter_counts() {
    assert_eq!(allocations(|| drop(std::hint::black_box(Box::new(7)))), 2);
}

/// What arrives before turn `k`: a bit of everything, over and over.
fn disturb(queues: &Queues, k: u64, now_ns: u64, last: Option<&JointTarget>) {
    let robot = RobotState {
        magic: if k.is_multiple_of(997) { 0 } else { ROBOT_MAGIC },
        seq: k,
        stamp_ns: now_ns,
        q_rad: last.map_or(LEVEL_POSTURE_RAD, |target| target.q_rad),
        target_seq: last.map_or(0, |target| target.seq),
        error_code: u32::from(k.is_multiple_of(30_011)),
        ..RobotState::default()
    };
    // Every 10 007 turns the arm falls silent for 60 turns.
    if k % 10_007 >= 60 {
        queues.put(&queues.robots, robot);
    }
    if k.is_multiple_of(250) {
        let x_m = match k / 250 % 4 {
            0 => f64::NAN,
            1 => 2.0,
            _ => 0.33,
        };
        let goal = Goal {
            magic: GOAL_MAGIC,
            stamp_ns: now_ns,
            id: k + 1,
            x_m,
            rope: (k / 250 % 5 / 4) as u32,
            keep_alive_ms: 0,
        };
        queues.put(&queues.goals, goal);
    }
    let kind = match k % 4001 {
        3000 => CommandKind::EmergencyStop.code(),
        3400 => CommandKind::Reset.code(),
        3900 => 77,
        _ if k.is_multiple_of(7013) => CommandKind::Cancel.code(),
        _ => 0,
    };
    if kind != 0 || k.is_multiple_of(500) {
        let command = Command {
            magic: COMMAND_MAGIC,
            stamp_ns: now_ns,
            id: k + 1,
            kind: if kind == 0 {
                CommandKind::Reset.code()
            } else {
                kind
            },
            reserved: 0,
        };
        queues.put_command(command);
    }
}

#[test]
fn a_turn_allocates_nothing_whatever_happens() {
    const TURNS: u64 = 120_000;
    let instance = Instance::new(&format!("alloc-{}", std::process::id())).unwrap();
    let session = instance.start().unwrap();
    let (loop_node, node) = (
        services::node(session.config()).unwrap(),
        services::node(session.config()).unwrap(),
    );
    let writer = services::newest_writer(&loop_node).unwrap();
    let (_speaker, voice) = voice::start(false).unwrap();
    let mut bridge = Bridge::new(&node, voice).unwrap();
    session.announce().unwrap();
    let queues = Queues::new(true);
    let setup = Setup {
        blob: sample::blob(),
        cycle_ns: 4_000_000,
        cycles_per_target: 1,
        silent_cycles_max: 50,
        gripper_lead_ns: 100_000_000,
        degraded: 0,
    };
    let mut cycle = Cycle::new(Controller::new(setup), &queues, false);
    let (mut last, mut counted, mut targets, mut accepted, mut refused) = (None, 0, 0u64, 0, 0);
    let mut client = None;
    let start_ns = clock::now_ns();
    for k in 0..TURNS {
        let now_ns = start_ns + k * 4_000_000;
        disturb(&queues, k, now_ns, last.as_ref());
        counted += allocations(|| {
            let output = cycle.turn(now_ns, k / 1000, &mut |target| {
                writer.update_with_copy(*target);
                last = Some(*target).filter(|target| target.seq > 0);
                targets += u64::from(last.is_some());
            });
            if let Some(status) = output.status {
                (accepted, refused) = (status.goals_accepted, status.goals_refused);
            }
        });
        // The bridge rests for long stretches, so that the queues also overflow.
        if k % 4096 < 1024 {
            bridge.round(&queues, &mut |_| {});
        }
        if k % 20_000 == 5_000 {
            client = match client {
                None => Some(Client::connect(instance.name(), Duration::from_secs(10)).unwrap()),
                Some(_) => None,
            };
        }
    }
    drop(client);
    drop((bridge, writer, loop_node, node, session));
    instance.purge().unwrap();
    assert_eq!(counted, 0, "calls to the allocator in {TURNS} turns");
    // The turns were not idle ones.
    assert!(
        targets > TURNS / 4 && accepted > 10 && refused > 100,
        "{targets} {accepted} {refused}"
    );
    assert!(queues.lost() > 0, "the queues overflowed at times");
}
