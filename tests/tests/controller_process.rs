//! The controller as its users meet it: real processes, a simulated arm, goals over iceoryx2.

mod controller_world;

use controller::client::Client;
use controller::sample;
use controller_world::limit_check::limits_hold_at;
use controller_world::{PATIENCE, Process, World, await_status, idle, in_phase, program, terminate};
use offline::demo::{Demo, SceneKind};
use shared::arm;
use shared::messages::{CommandKind, Gripper, JointTarget, Phase, Reason};
use std::io::Read;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

#[test]
fn a_goal_becomes_the_whole_motion() {
    let world = World::new();
    let recording = world.path("run.rec");
    let recording_name = recording.to_str().expect("a plain path");
    let mut controller = world.controller(&["--record", recording_name]);
    let _robot = world.robot();
    let mut client = world.client();
    let mut targets = Vec::new();
    await_status(&mut client, &mut targets, idle);
    targets.clear();
    let goal_x_m = 0.33;
    let id = client.send_goal(0, goal_x_m).expect("sent");
    let end = await_status(&mut client, &mut targets, |status| status.finished_goal_id == id);
    assert_eq!(end.finished_reason, Reason::Done.code());
    limits_hold_at(&targets, 0.004).expect("no limit is broken");

    let blob = sample::blob();
    let rope = &blob.ropes[0];
    let release_m = blob.policy.release_point_m(goal_x_m, rope.young_pa, rope.poisson);
    let wanted_m = blob.frame.flange_m(release_m);
    let last_dwell = targets
        .iter()
        .rfind(|target| target.phase == Phase::Dwell.code())
        .expect("the motion dwells");
    let reached_m: [f64; 3] = arm::flange(&last_dwell.q_rad).position_m.into();
    for axis in 0..3 {
        assert!(
            (reached_m[axis] - wanted_m[axis]).abs() < 1e-3,
            "{reached_m:?} {wanted_m:?}"
        );
    }
    let openings: Vec<&JointTarget> = targets
        .windows(2)
        .filter(|pair| pair[0].gripper == Gripper::Closed.code() && pair[1].gripper == Gripper::Open.code())
        .map(|pair| &pair[1])
        .collect();
    assert_eq!(openings.len(), 1, "the gripper opens exactly once");
    assert_eq!(openings[0].phase, Phase::Release.code());
    assert_eq!(openings[0].seq, last_dwell.seq + 1);

    assert!(
        terminate(&mut controller),
        "a signal ends the controller with code 0"
    );
    assert_replays(&recording);
    assert_becomes_a_demo(&recording, release_m);
}

/// The recording is a demonstration of what the arm did: a rope that is dragged to the release point and
/// let go there, in a folder that reads back.
fn assert_becomes_a_demo(recording: &Path, release_m: [f64; 2]) {
    let demos = offline::demo::recording(recording, None).expect("a demonstration");
    assert_eq!(demos.len(), 1);
    let folder = recording.with_file_name("demo");
    demos[0].save(&folder).expect("saved");
    let demo = Demo::load(&folder).expect("it reads back");
    assert_eq!(demo.spec.scene, SceneKind::Swing);
    let blob = sample::blob();
    let rope = &blob.ropes[0];
    assert_eq!(demo.spec.rope.length_m, rope.length_m);
    let hanging_m = blob.task.hanging_tip_m(rope.length_m);
    let commanded = demo.commanded[1].as_ref().expect("both paths are recorded");
    for path in [&demo.clamps[1], commanded] {
        let release = path
            .iter()
            .rposition(|sample| sample.closed)
            .expect("it was held");
        assert!(path.len() > release + 1, "it was let go");
        for (sample, wanted_m) in [(&path[0], hanging_m), (&path[release], release_m)] {
            let [x, y, z] = sample.position_m;
            // The simulated arm lags 20 ms behind at rest by nothing; the solver's tolerance is far below.
            assert!(
                (x - wanted_m[0]).hypot(z - wanted_m[1]) < 1e-3 && y.abs() < 1e-6,
                "{sample:?} {wanted_m:?}"
            );
        }
    }
    let seen = demo.times_s();
    assert!(seen.len() > 50, "the gripped end is seen: {}", seen.len());
    // Camera times on another clock are refused, not taken for something else.
    let error =
        offline::demo::recording(recording, Some(&folder)).expect_err("the demo's clock starts at zero");
    assert!(error.to_string().contains("CLOCK_MONOTONIC"), "{error}");
}

/// The program itself replays the recording bit for bit.
fn assert_replays(recording: &Path) {
    let output = Command::new(program("controller"))
        .arg("replay")
        .arg(recording)
        .arg("--json")
        .output()
        .expect("the controller runs");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{text}");
    let found: serde_json::Value = serde_json::from_str(&text).expect("one JSON object");
    assert!(found["targets"].as_u64().expect("a count") > 2000, "{found}");
    assert!(
        found["first_difference"].is_null() && found["truncated"] == false,
        "{found}"
    );
}

#[test]
fn bad_goals_get_a_reason_and_change_nothing() {
    let world = World::new();
    let _controller = world.controller(&[]);
    let _robot = world.robot();
    let mut client = world.client();
    let mut targets = Vec::new();
    await_status(&mut client, &mut targets, idle);
    for (rope, x_m, reason) in [
        (0, f64::NAN, Reason::NonFinite),
        (0, 2.0, Reason::OutOfRange),
        (7, 0.33, Reason::UnknownRope),
    ] {
        let id = client.send_goal(rope, x_m).expect("sent");
        let status = await_status(&mut client, &mut targets, |status| status.judged_goal_id == id);
        assert_eq!(status.judged_reason, reason.code());
        assert_eq!((status.active_goal_id, status.goals_accepted), (0, 0));
        assert!(idle(&status));
    }
    let first = targets[0].q_rad;
    assert!(targets.iter().all(|target| target.q_rad == first));
}

/// Resets until that is accepted: the simulated arm needs a moment to come to rest, and to clear an error.
fn reset(client: &mut Client, targets: &mut Vec<JointTarget>) {
    let start = Instant::now();
    loop {
        let id = client.send_command(CommandKind::Reset).expect("sent");
        let status = await_status(client, targets, |status| status.command_id == id);
        if status.command_reason == Reason::Accepted.code() {
            break;
        }
        assert!(start.elapsed() < PATIENCE, "{status:?}");
    }
    await_status(client, targets, idle);
}

#[test]
fn an_emergency_stop_latches_until_a_reset() {
    let world = World::new();
    let _controller = world.controller(&["--rate-hz", "1000"]);
    let _robot = world.robot();
    let mut client = world.client();
    let mut targets = Vec::new();
    await_status(&mut client, &mut targets, idle);
    let id = client.send_goal(0, 0.33).expect("sent");
    await_status(&mut client, &mut targets, in_phase(Phase::Approach));
    client.send_command(CommandKind::EmergencyStop).expect("sent");
    let status = await_status(&mut client, &mut targets, in_phase(Phase::Fault));
    assert_eq!(status.latch_reason, Reason::EmergencyStop.code());
    assert_eq!(
        (status.finished_goal_id, status.finished_reason),
        (id, Reason::EmergencyStop.code())
    );
    let refused = client.send_goal(0, 0.33).expect("sent");
    let status = await_status(&mut client, &mut targets, |status| {
        status.judged_goal_id == refused
    });
    assert_eq!(status.judged_reason, Reason::Latched.code());
    reset(&mut client, &mut targets);
    limits_hold_at(&targets, 0.004).expect("no limit is broken");
}

/// A driver that was held up leaves targets out and would send the arm through all of them in one step. Here every step is
/// too long.
#[test]
fn an_arm_that_would_jump_reports_an_error_and_goes_on_after_a_reset() {
    let world = World::new();
    let _controller = world.controller(&[]);
    let _robot = world.robot_that_steps("1e-9");
    let mut client = world.client();
    let mut targets = Vec::new();
    await_status(&mut client, &mut targets, idle);
    client.send_goal(0, 0.33).expect("sent");
    let fault = await_status(&mut client, &mut targets, in_phase(Phase::Fault));
    assert_eq!(fault.latch_reason, Reason::RobotFault.code());
    reset(&mut client, &mut targets);
}

/// Every figure that the benchmark promises is there, whatever it is: how punctual a machine is, is no
/// question for a test.
#[test]
fn the_benchmark_reports_every_figure_and_writes_histograms() {
    let world = World::new();
    let folder = world.path("histograms");
    let output = Command::new(program("controller"))
        .args(["bench", "--seconds", "1", "--json", "--histograms"])
        .arg(&folder)
        .output()
        .expect("the controller runs");
    let words = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{words}");
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
    for figure in [
        "wake",
        "start",
        "jitter",
        "turn",
        "answer",
        "goal_to_first_target",
    ] {
        assert!(
            report["idle"][figure]["count"].as_u64().expect("a count") > 0,
            "{figure}"
        );
        let file = if figure == "answer" { "turn" } else { figure };
        let table = folder.join(format!("idle-{}.hgrm", file.replace('_', "-")));
        let text = std::fs::read_to_string(table).expect("a table");
        assert!(text.contains("1/(1-Percentile)"), "{text}");
    }
    assert_eq!(report["idle"]["cost"]["allocator_calls"], 0);
    let compared = report["idle"]["wake_p99_ratio"].is_number();
    let excused = report["cyclictest_missing"].is_string();
    assert!(compared != excused, "{report}");
    for part in ["policy", "ik_from_middle", "ik_along_line", "plan"] {
        assert!(report["parts"][part]["p50_ns"].is_number(), "{part}");
    }
}

/// What a client program says before it ends by itself, and its exit code.
fn last_line(program_name: &str, more: &[&str], instance: &str) -> (Option<i32>, String) {
    let child = Command::new(program(program_name))
        .args(more)
        .args(["--instance", instance])
        .stderr(Stdio::piped())
        .stdout(Stdio::null())
        .spawn()
        .expect("the client runs");
    let mut child = Process(child);
    let start = Instant::now();
    while child.0.try_wait().expect("asked").is_none() {
        assert!(start.elapsed() < PATIENCE, "{program_name} goes on in silence");
        std::thread::sleep(Duration::from_millis(10));
    }
    let mut text = String::new();
    let errors = child.0.stderr.as_mut().expect("piped");
    errors.read_to_string(&mut text).expect("text");
    (child.0.wait().expect("ended").code(), text)
}

#[test]
fn every_client_program_says_that_the_controller_is_of_another_version() {
    let world = World::new();
    let _controller = world.controller(&[]);
    drop(world.client());
    let uid = std::fs::metadata(world.path("policy.blob"))
        .expect("a file")
        .uid();
    let current = format!("/tmp/genorm-{uid}/{}/current", world.instance);
    std::fs::write(current, "session a-b\nprotocol 99\niceoryx2 0.10\n").expect("written");
    for (name, more) in [
        ("examples/sim_robot", &[][..]),
        ("examples/watch_targets", &[]),
        ("examples/send_goal", &["--x", "0.33"]),
    ] {
        let (code, text) = last_line(name, more, &world.instance);
        assert!(
            code == Some(1) && text.contains("speaks protocol 99"),
            "{name}: {text}"
        );
    }
}

#[test]
fn a_wrong_flag_is_told_apart_from_a_failure_by_its_code() {
    for arguments in [
        &["--policy", "x.blob", "--instance", "No_Name"][..],
        &["--policy", "x.blob", "--rate-hz", "99"],
        &["--policy", "x.blob", "--robot-timeout-ms", "0"],
        &["fk", "0", "0", "0", "0", "0", "0"],
        &["ik", "nan", "0.1"],
        &[],
    ] {
        let output = Command::new(program("controller")).args(arguments).output();
        let output = output.expect("the controller runs");
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
    }
}

#[test]
fn a_second_controller_and_a_bad_policy_file_are_refused_in_one_line() {
    let world = World::new();
    let _controller = world.controller(&[]);
    let _client = world.client();
    let refused = |policy: &Path, instance: &str| {
        let output = Command::new(program("controller"))
            .arg("--policy")
            .arg(policy)
            .args(["--instance", instance])
            .output()
            .expect("the controller runs");
        assert_eq!(output.status.code(), Some(1));
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(text.lines().count(), 1, "{text}");
        text
    };
    let policy = world.path("policy.blob");
    assert!(refused(&policy, &world.instance).contains("runs already"));
    let mut bytes = std::fs::read(&policy).expect("a file");
    bytes.truncate(1000);
    let short = world.path("short.blob");
    std::fs::write(&short, bytes).expect("written");
    let line = refused(&short, "unused");
    assert!(
        line.contains("short.blob") && line.contains("ends early"),
        "{line}"
    );
}
