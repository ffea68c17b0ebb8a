//! The command lines of the controller and of its clients: what is wrong is refused before anything is done,
//! every failure says what to do, and answers are there for machines too.

mod controller_world;

use controller_world::{PATIENCE, Process, World, await_status, idle, program, signal, terminate};
use serde_json::Value;
use shared::messages::Reason;
use std::fs::File;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::Instant;

const CONTROLLER: &str = "controller";
const SEND_GOAL: &str = "examples/send_goal";
const SIM_ROBOT: &str = "examples/sim_robot";
const WATCH_TARGETS: &str = "examples/watch_targets";

fn run(name: &str, arguments: &[&str]) -> Output {
    let output = Command::new(program(name)).args(arguments).output();
    output.expect("the program runs")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// The objects of a text with one per line.
fn objects(lines: &[u8]) -> Vec<Value> {
    let lines = text(lines);
    let parsed = lines.lines().map(serde_json::from_str);
    parsed.collect::<Result<_, _>>().expect("JSON lines")
}

/// Waits for the end of a process that should end by itself.
fn end_of(process: &mut Process) -> Option<i32> {
    let start = Instant::now();
    while process.0.try_wait().expect("asked").is_none() {
        assert!(start.elapsed() < PATIENCE, "it does not end");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    process.0.wait().expect("ended").code()
}

#[test]
fn wrong_use_is_told_with_code_2_and_what_would_be_right() {
    let name = "use 1 to 24 of the characters";
    for (program, arguments, right) in [
        (CONTROLLER, &["--policy", "x", "--instance", "A_"][..], name),
        (SEND_GOAL, &["--x", "0.3", "--instance", "A_"], name),
        (SIM_ROBOT, &["--instance", "A_"], name),
        (WATCH_TARGETS, &["--instance", "A_"], name),
        (SEND_GOAL, &["--x", "nan"], "from -10 to 10"),
        (SEND_GOAL, &["--x", "0.3", "--rope", "16"], "0..16"),
        (
            SEND_GOAL,
            &["--x", "0.3", "--keep-alive-ms", "60001"],
            "0..=60000",
        ),
        (SIM_ROBOT, &["--seconds", "inf"], "from 0 to 1000000"),
        (SIM_ROBOT, &["--seconds", "1e30"], "from 0 to 1000000"),
        (SIM_ROBOT, &["--lag-s", "nan"], "from 0 to 10"),
        (WATCH_TARGETS, &["--seconds", "nan"], "from 0 to 1000000"),
        (
            CONTROLLER,
            &["fk", "0", "0", "0", "0", "0", "0", "90"],
            "from -10 to 10",
        ),
        (CONTROLLER, &["ik", "0.1", "inf"], "from -10 to 10"),
    ] {
        let output = run(program, arguments);
        let words = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{program} {arguments:?}: {words}");
        assert!(words.contains(right), "{program} {arguments:?}: {words}");
    }
}

#[test]
fn every_failure_is_one_line_that_says_what_to_do() {
    let histograms = ["bench", "--seconds", "1", "--histograms", "/proc/x"];
    for (arguments, remedy) in [
        (&["replay", "nope"][..], "give a file that"),
        (&["ik", "5", "5"], "give a point nearer"),
        (&histograms, "give --histograms a folder"),
    ] {
        let output = run(CONTROLLER, arguments);
        let words = text(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{words}");
        assert!(words.contains(remedy) && words.lines().count() == 1, "{words}");
    }
}

#[test]
fn every_help_ends_with_an_example() {
    for name in [CONTROLLER, SEND_GOAL, SIM_ROBOT, WATCH_TARGETS] {
        let help = text(&run(name, &["--help"]).stdout);
        assert!(help.contains("Example") && help.contains("--json"), "{help}");
    }
}

#[test]
fn an_answer_that_cannot_be_written_is_a_failure_unless_the_reader_has_enough() {
    let answer_to = |out: Stdio| {
        let mut command = Command::new(program(CONTROLLER));
        let output = command.args(["ik", "0.1", "0.15"]).stdout(out).output();
        let output = output.expect("the controller runs");
        (output.status.code(), text(&output.stderr))
    };
    let (_, unread) = std::io::pipe().expect("a pipe");
    assert_eq!(answer_to(unread.into()), (Some(0), String::new()));
    let full = File::options().write(true).open("/dev/full");
    let (code, words) = answer_to(full.expect("Linux has it").into());
    assert!(
        code == Some(1) && words.contains("cannot write the answer") && words.lines().count() == 1,
        "{words}"
    );
}

#[test]
fn a_recording_is_never_overwritten() {
    let world = World::new();
    let kept = world.path("kept.rec");
    std::fs::write(&kept, "measured once").expect("written");
    for path in [&kept, Path::new("/proc/x")] {
        let (mut reader, writer) = std::io::pipe().expect("a pipe");
        let arguments = ["--record", path.to_str().expect("a plain path")];
        let mut controller = world.controller_that_tells(writer, &arguments);
        assert_eq!(end_of(&mut controller), Some(1));
        let words = std::io::read_to_string(&mut reader).expect("text");
        assert!(
            words.contains("give --record a new file") && words.lines().count() == 1,
            "{words}"
        );
    }
    assert_eq!(
        std::fs::read_to_string(&kept).expect("it is there"),
        "measured once"
    );
}

#[test]
fn machines_can_read_what_became_of_goals() {
    let world = World::new();
    let events = world.path("events");
    let child = Command::new(program(CONTROLLER))
        .arg("--policy")
        .arg(world.path("policy.blob"))
        .args([
            "--instance",
            &world.instance,
            "--robot-timeout-ms",
            "2000",
            "--json",
        ])
        .stdout(File::create(&events).expect("a file"))
        .stderr(world.log())
        .spawn();
    let mut controller = Process(child.expect("the controller starts"));
    let child = Command::new(program(SIM_ROBOT))
        .args(["--instance", &world.instance, "--step-max-rad", "10", "--json"])
        .stdout(Stdio::piped())
        .spawn();
    let mut robot = Process(child.expect("the simulated arm starts"));
    await_status(&mut world.client(), &mut Vec::new(), idle);

    let goal = |arguments: &[&str]| run(SEND_GOAL, &[arguments, &["--instance", &world.instance]].concat());
    let refused = goal(&["--x", "2", "--json"]);
    let [outcome] = &objects(&refused.stdout)[..] else {
        panic!("one object");
    };
    assert_eq!(refused.status.code(), Some(1));
    assert_eq!(outcome["outcome"], "refused");
    assert_eq!(outcome["state"]["name"], "Idle");
    assert_eq!(outcome["reason"]["code"], Reason::OutOfRange.code());
    assert_eq!(outcome["reason"]["name"], "OutOfRange");
    assert_eq!(outcome["reason"]["remedy"], Reason::OutOfRange.remedy());
    assert!(text(&goal(&["--x", "2"]).stderr).contains(Reason::OutOfRange.remedy()));

    let watched = run(
        WATCH_TARGETS,
        &["--instance", &world.instance, "--json", "--seconds", "1"],
    );
    let targets = objects(&watched.stdout);
    assert!(targets.len() > 10 && targets[0]["q_rad"].as_array().is_some_and(|q| q.len() == 7));

    // The goal is served although nobody reads about it.
    let (_, unread) = std::io::pipe().expect("a pipe");
    let served = Command::new(program(SEND_GOAL))
        .args(["--x", "0.33", "--instance", &world.instance])
        .stdout(unread)
        .status();
    assert!(served.expect("it runs").success());

    signal(&robot, "INT");
    assert_eq!(end_of(&mut robot), Some(0));
    let out = robot.0.stdout.take().expect("piped");
    let summary = std::io::read_to_string(out).expect("text");
    let summary = objects(summary.as_bytes());
    assert!(summary[0]["states_sent"].as_u64().expect("a count") > 1000);
    assert!(terminate(&mut controller));
    let events = objects(&std::fs::read(events).expect("events"));
    let happened = |name: &str| events.iter().filter(|event| event["event"] == name).count();
    assert_eq!(["ready", "rope", "summary"].map(happened), [1; 3]);
    assert_eq!([happened("goal_judged"), happened("goal_ended")], [3, 1]);
    assert!(happened("state") > 5);
}
