//! Whatever arrives, in whatever order, no target ever breaks a limit, and the same inputs give the
//! same outputs bit for bit.

mod virtual_arm;

use controller::recorder::{self, Header, Record};
use controller::step::{Controller, Inputs};
use proptest::prelude::*;
use shared::messages::{COMMAND_MAGIC, Command, Goal, RobotState};
use virtual_arm::{World, limits_hold, setup};

/// Something that happens, and how many cycles pass before the next thing does.
#[derive(Clone, Debug)]
enum Event {
    Goal {
        x_m: f64,
        rope: u32,
        age_ns: i64,
        magic: bool,
    },
    Command {
        kind: u32,
    },
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
        6 => (x_m, prop::bool::weighted(0.05), 0i64..600_000_000, prop::bool::weighted(0.95))
            .prop_map(|(x_m, unknown, age_ns, magic)| Event::Goal { x_m, rope: unknown.into(), age_ns: -age_ns, magic }),
        3 => (0u32..6).prop_map(|kind| Event::Command { kind }),
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
        } => {
            let goal = world.goal_at(x_m);
            world.next.goal = Some(Goal {
                rope,
                stamp_ns: goal.stamp_ns.saturating_add_signed(age_ns),
                magic: if magic { goal.magic } else { 0 },
                ..goal
            });
        }
        Event::Command { kind } => {
            world.next.command = Some(Command {
                magic: COMMAND_MAGIC,
                stamp_ns: 0,
                id: 1,
                kind,
                reserved: 0,
            });
        }
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

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn no_sequence_of_inputs_breaks_a_limit(
        events in prop::collection::vec((event(), prop_oneof![0usize..20, 0usize..1500]), 1..40),
    ) {
        let mut world = World::new();
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
        prop_assert_eq!(limits_hold(&world.targets), Ok(()));
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
        let mut world = World::new();
        let mut voice = None;
        let mut file = Vec::new();
        let header = Header::new(&setup(), 7);
        header.write(&mut file).unwrap();
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
                recorder::append(&mut file, &Record::new(world.now_ns, &inputs, &output)).unwrap();
                cycles += 1;
            }
        }
        if damage {
            file.truncate(file.len() - 3);
        }
        let mut input = file.as_slice();
        prop_assert_eq!(Header::read(&mut input).unwrap(), Some(header));
        let found = recorder::replay(&mut input, Controller::new(setup())).unwrap();
        prop_assert_eq!(found.cycles, cycles - u64::from(damage));
        prop_assert_eq!(found.first_difference, None);
        prop_assert_eq!(found.truncated, damage);
    }
}

#[test]
fn a_changed_input_is_noticed_by_the_replay() {
    let mut world = World::new();
    let mut file = Vec::new();
    for _ in 0..20 {
        let output = world.cycle();
        let inputs = Inputs {
            robot: world.arm,
            missed_deadlines: 1,
            ..Inputs::default()
        };
        recorder::append(&mut file, &Record::new(world.now_ns, &inputs, &output)).unwrap();
    }
    let found = recorder::replay(&mut file.as_slice(), Controller::new(setup())).unwrap();
    assert_eq!(found.first_difference, Some(0));
}
