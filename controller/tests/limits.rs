//! Whatever arrives, in whatever order, no target ever breaks a limit, and the same inputs give the
//! same outputs bit for bit.

mod virtual_arm;

use controller::recorder;
use controller::step::{Controller, Inputs, Setup};
use proptest::prelude::*;
use shared::messages::{COMMAND_MAGIC, Command, Goal, Reason, RobotState};
use shared::recording::{FRAME_BYTES, Record};
use virtual_arm::{World, limits_hold_at, setup};

/// Something that happens, and how many cycles pass before the next thing does.
#[derive(Clone, Debug)]
enum Event {
    Goal {
        x_m: f64,
        rope: u32,
        age_ns: i64,
        magic: bool,
        keep_alive_ms: u32,
    },
    Command {
        kind: u32,
        stamped: bool,
    },
    Stall {
        cycles: u64,
    },
    Unread,
    Read,
    Silence,
    Voice,
    Stuck,
    Follow,
    Jump {
        joint: usize,
        by_rad: f64,
    },
    Error {
        code: u32,
    },
    Nonsense,
}

fn event() -> impl Strategy<Value = Event> {
    let x_m = prop_oneof![
        6 => 0.275f64..0.40,
        1 => prop::num::f64::ANY,
    ];
    prop_oneof![
        6 => (x_m, prop::bool::weighted(0.05), 0i64..600_000_000, prop::bool::weighted(0.95),
                prop_oneof![3 => Just(0), 1 => 1u32..8000])
            .prop_map(|(x_m, unknown, age_ns, magic, keep_alive_ms)| Event::Goal {
                x_m, rope: unknown.into(), age_ns: -age_ns, magic, keep_alive_ms,
            }),
        1 => Just(Event::Unread),
        2 => Just(Event::Read),
        3 => (0u32..6, prop::bool::weighted(0.9))
            .prop_map(|(kind, stamped)| Event::Command { kind, stamped }),
        1 => (1u64..100).prop_map(|cycles| Event::Stall { cycles }),
        1 => Just(Event::Silence),
        3 => Just(Event::Voice),
        1 => Just(Event::Stuck),
        3 => Just(Event::Follow),
        1 => (0usize..7, -1.0f64..1.0).prop_map(|(joint, by_rad)| Event::Jump { joint, by_rad }),
        2 => (0u32..2).prop_map(|code| Event::Error { code }),
        1 => Just(Event::Nonsense),
    ]
}

fn apply(world: &mut World, voice: &mut Option<RobotState>, event: &Event) {
    match *event {
        Event::Goal {
            x_m,
            rope,
            age_ns,
            magic,
            keep_alive_ms,
        } => {
            let goal = world.goal_at(x_m);
            world.next.goal = Some(Goal {
                rope,
                stamp_ns: goal.stamp_ns.saturating_add_signed(age_ns),
                magic: if magic { goal.magic } else { 0 },
                keep_alive_ms,
                ..goal
            });
        }
        Event::Command { kind, stamped } => {
            // A keep-alive names the goal that it is for.
            let id = world.controller.active_goal_id().max(1);
            world.next.command = Some(Command {
                magic: COMMAND_MAGIC,
                stamp_ns: if stamped { world.now_ns } else { 0 },
                id,
                kind,
                reserved: 0,
            });
        }
        Event::Stall { cycles } => world.stall(cycles),
        Event::Unread => world.reads = false,
        Event::Read => world.reads = true,
        Event::Silence => *voice = world.arm.take().or(*voice),
        Event::Voice => world.arm = world.arm.or(*voice),
        Event::Stuck => world.follows = false,
        Event::Follow => world.follows = true,
        Event::Jump { joint, by_rad } => {
            if let Some(arm) = &mut world.arm {
                arm.q_rad[joint] += by_rad;
            }
        }
        Event::Error { code } => {
            if let Some(arm) = &mut world.arm {
                arm.error_code = code;
            }
        }
        Event::Nonsense => {
            world.next.robot = Some(RobotState {
                q_rad: [f64::NAN; 7],
                ..RobotState::default()
            });
        }
    }
}

/// Time of a cycle, ns, and cycles to a target, as the rates from 100 to 1000 Hz have them.
fn pace() -> impl Strategy<Value = (u64, u32)> {
    prop_oneof![
        4 => Just((4_000_000, 1)),
        1 => Just((10_000_000, 1)),
        1 => Just((1_000_000, 4)),
        1 => Just((1_333_333, 3)),
    ]
}

fn paced((cycle_ns, cycles_per_target): (u64, u32)) -> Setup {
    Setup {
        cycle_ns,
        cycles_per_target,
        silent_cycles_max: 200_000_000 / cycle_ns,
        gripper_lead_ns: 150_000_000,
        ..setup()
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn no_sequence_of_inputs_breaks_a_limit(
        events in prop::collection::vec((event(), prop_oneof![0usize..20, 0usize..1500]), 1..40),
        pace in pace(),
    ) {
        let period_s = pace.0 as f64 * f64::from(pace.1) * 1e-9;
        let mut world = World::with(paced(pace));
        let mut voice = None;
        let mut newest_pose = Vec::new();
        for (event, cycles) in &events {
            apply(&mut world, &mut voice, event);
            for _ in 0..=*cycles {
                // The newest pose heard, which a silent arm has left behind.
                let measured = world.arm.or(voice).map(|arm| arm.q_rad);
                let sent = world.targets.len();
                world.cycle();
                let new_stream = world.targets.len() > sent
                    && (sent == 0 || world.targets[sent].stream != world.targets[sent - 1].stream);
                if new_stream {
                    newest_pose.push((world.targets[sent].q_rad, measured));
                }
            }
        }
        prop_assert_eq!(limits_hold_at(&world.targets, period_s), Ok(()));
        prop_assert!(!world.latched.contains(&Reason::GuardTripped), "what is planned passes the guard");
        for (first, measured) in newest_pose {
            prop_assert_eq!(Some(first), measured, "a stream begins at the measured pose");
        }
        for pair in world.targets.windows(2) {
            prop_assert_eq!(pair[1].seq, pair[0].seq + 1);
        }
    }

    #[test]
    fn a_recording_replays_bit_for_bit(
        events in prop::collection::vec((event(), 0usize..400), 1..12), damage in any::<bool>(),
    ) {
        // Recorded with plans made ahead, replayed without: they change nothing.
        let mut world = World::new();
        world.plans_ahead = true;
        let mut voice = None;
        let mut file = Vec::new();
        let policy = [7; 100];
        let header = recorder::header(&setup(), policy.len());
        file.extend(header.to_bytes());
        file.extend(policy);
        let mut cycles = 0;
        for (event, more) in &events {
            apply(&mut world, &mut voice, event);
            for _ in 0..=*more {
                let mut inputs = world.next;
                inputs.robot = world.arm.map(|arm| RobotState {
                    seq: arm.seq + 1,
                    stamp_ns: world.now_ns + virtual_arm::CYCLE_NS,
                    ..arm
                }).or(inputs.robot);
                let output = world.cycle();
                cycles += 1;
                file.extend(recorder::record(cycles, world.now_ns, &inputs, &output).to_frame());
            }
        }
        if damage {
            file.truncate(file.len() - 3);
        }
        let mut input = file.as_slice();
        let head = recorder::read_head(&mut input).unwrap().unwrap();
        prop_assert_eq!((head.header, head.policy), (header, policy.to_vec()));
        let found = recorder::replay(&mut input, Controller::new(setup())).unwrap();
        prop_assert_eq!(found.cycles, cycles - u64::from(damage));
        prop_assert_eq!(found.first_difference, None);
        prop_assert_eq!(found.truncated, damage);
    }
}

/// The replay of twenty cycles in which the arm is heard, recorded with `change` made to each record.
fn twenty(change: impl Fn(&mut Record)) -> recorder::Replay {
    replay(&file_of_twenty(change))
}

fn replay(mut file: &[u8]) -> recorder::Replay {
    recorder::replay(&mut file, Controller::new(setup())).unwrap()
}

fn file_of_twenty(change: impl Fn(&mut Record)) -> Vec<u8> {
    let mut world = World::new();
    let mut file = Vec::new();
    for cycle in 1..=20 {
        let arm = world.arm.map(|arm| RobotState {
            seq: arm.seq + 1,
            stamp_ns: world.now_ns + virtual_arm::CYCLE_NS,
            ..arm
        });
        let output = world.cycle();
        let inputs = Inputs {
            robot: arm,
            ..Inputs::default()
        };
        let mut record = recorder::record(cycle, world.now_ns, &inputs, &output);
        change(&mut record);
        file.extend(record.to_frame());
    }
    file
}

#[test]
fn a_changed_record_or_a_gap_is_noticed_by_the_replay() {
    assert_eq!(
        (twenty(|_| ()).cycles, twenty(|_| ()).first_difference),
        (20, None)
    );
    let changed = twenty(|record| {
        if record.cycle == 7 {
            record.target.q_rad[2] += 1e-15;
        }
    });
    assert_eq!(changed.first_difference, Some(7));
    let mut damaged = file_of_twenty(|_| ());
    damaged[12 * FRAME_BYTES + 70] ^= 1;
    let found = replay(&damaged);
    assert_eq!(
        (found.cycles, found.damaged_after, found.first_difference),
        (12, Some(12), None)
    );
    let gap = twenty(|record| record.cycle += if record.cycle > 12 { 3 } else { 0 });
    assert_eq!(
        (gap.cycles, gap.gap_after, gap.first_difference),
        (12, Some(12), None)
    );
}
