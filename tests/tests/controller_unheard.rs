//! The controller when nobody hears it: its terminal is closed, its reader is gone, the disk is full or the
//! screen is held. Its words may be lost; the arm's motion may not.

mod controller_world;

use controller_world::limit_check::limits_hold_at;
use controller_world::{Process, World, await_status, idle, in_phase, signal, terminate};
use shared::messages::{CommandKind, JointTarget, Phase, Reason};
use shared::recording::HEADER_BYTES;
use std::fs::File;
use std::io::{Read, Write};
use std::process::{Command, Stdio};

/// What a pipe of Linux holds before its writer has to wait.
const PIPE_BYTES: usize = 1 << 16;

/// A pipe whose reader is gone.
fn unread() -> Stdio {
    let (_, writer) = std::io::pipe().expect("a pipe");
    writer.into()
}

/// A disk that is full.
fn full() -> Stdio {
    let file = File::options().write(true).open("/dev/full");
    file.expect("Linux has it").into()
}

fn ends_well(process: &mut Process) -> bool {
    process.0.wait().expect("it ends").success()
}

#[test]
fn a_goal_is_served_to_its_end_while_nobody_hears() {
    for words in [unread(), full()] {
        let world = World::new();
        let mut controller = world.controller_that_tells(words, &[]);
        let _robot = world.robot();
        let (mut client, mut targets) = (world.client(), Vec::new());
        await_status(&mut client, &mut targets, idle);
        let id = client.send_goal(0, 0.33).expect("sent");
        let end = await_status(&mut client, &mut targets, |status| status.finished_goal_id == id);
        assert_eq!(end.finished_reason, Reason::Done.code());
        assert!(terminate(&mut controller), "and it ends with code 0");
    }
}

#[test]
fn a_terminal_that_is_closed_stops_the_arm_within_its_limits() {
    let world = World::new();
    let mut controller = world.controller_that_tells(unread(), &[]);
    let _robot = world.robot();
    let (mut client, mut targets) = (world.client(), Vec::new());
    await_status(&mut client, &mut targets, idle);
    client.send_goal(0, 0.33).expect("sent");
    await_status(&mut client, &mut targets, in_phase(Phase::Approach));
    signal(&controller, "HUP");
    await_status(&mut client, &mut targets, in_phase(Phase::Ended));
    assert!(ends_well(&mut controller), "with code 0");
    limits_hold_at(&targets, 0.004).expect("no limit is broken");
    let moves = |target: &JointTarget| target.dq_rad_s.iter().any(|speed| speed.abs() > 1e-6);
    assert!(targets.iter().any(moves) && !targets.last().is_some_and(moves));
}

/// Ctrl-S on the terminal, or a reader that hangs: whoever writes there waits.
#[test]
fn a_terminal_that_takes_nothing_holds_up_neither_a_goal_nor_an_emergency_stop() {
    let (_reader, mut writer) = std::io::pipe().expect("a pipe");
    writer.write_all(&[0; PIPE_BYTES]).expect("it fits");
    let world = World::new();
    let mut controller = world.controller_that_tells(writer, &[]);
    let _robot = world.robot();
    let (mut client, mut targets) = (world.client(), Vec::new());
    await_status(&mut client, &mut targets, idle);
    client.send_goal(0, 0.33).expect("sent");
    await_status(&mut client, &mut targets, in_phase(Phase::Homing));
    client.send_command(CommandKind::EmergencyStop).expect("sent");
    let status = await_status(&mut client, &mut targets, in_phase(Phase::Fault));
    assert_eq!(status.latch_reason, Reason::EmergencyStop.code());
    assert!(terminate(&mut controller), "and it ends with code 0");
}

/// As on a disk that is full: the motion goes on, and the end says that the recording is not whole.
#[test]
fn a_recording_that_is_cut_off_moves_nothing_and_ends_with_code_1() {
    let world = World::new();
    let pipe = world.path("pipe.rec");
    let made = Command::new("mkfifo").arg(&pipe).status();
    assert!(made.is_ok_and(|status| status.success()), "a pipe is made");
    let recording = ["--record", pipe.to_str().expect("a plain path")];
    let (mut words, writer) = std::io::pipe().expect("a pipe");
    let mut controller = world.controller_that_tells(writer, &recording);
    let mut reader = File::open(&pipe).expect("it opens");
    let policy = std::fs::metadata(world.path("policy.blob")).expect("a file");
    let mut head = vec![0; HEADER_BYTES + policy.len() as usize];
    reader.read_exact(&mut head).expect("the head is there");
    let _robot = world.robot();
    let (mut client, mut targets) = (world.client(), Vec::new());
    await_status(&mut client, &mut targets, idle);
    let id = client.send_goal(0, 0.33).expect("sent");
    drop(reader);
    let end = await_status(&mut client, &mut targets, |status| status.finished_goal_id == id);
    assert_eq!(end.finished_reason, Reason::Done.code());
    limits_hold_at(&targets, 0.004).expect("no limit is broken");
    signal(&controller, "TERM");
    assert_eq!(controller.0.wait().expect("it ends").code(), Some(1));
    let mut text = String::new();
    words.read_to_string(&mut text).expect("text");
    let last = text.lines().last().unwrap_or_default();
    assert!(
        text.contains("the recording ends here") && last.contains("the recording is cut off"),
        "{text}"
    );
}
