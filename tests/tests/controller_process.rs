//! The controller as its users meet it: real processes, a simulated arm, goals over iceoryx2, and
//! kill -9 at the worst moments.

use controller::client::Client;
use controller::session::Instance;
use controller::{policy_file, sample};
use shared::arm::{
    self, ACCELERATION_MAX_RAD_S2, FLANGE_SPEED_MAX_M_S, JERK_MAX_RAD_S3, JOINTS, SPEED_MAX_RAD_S,
};
use shared::messages::{CommandKind, Gripper, JointTarget, Phase, Reason, Status};
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Far beyond what anything here takes; only a hang reaches it.
const PATIENCE: Duration = Duration::from_secs(60);

/// A process that does not outlive its test.
struct Process(Child);

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The folder of built programs that this test itself lies in, and the flag that builds into it.
fn build_folder() -> (PathBuf, &'static [&'static str]) {
    let mut folder = std::env::current_exe().expect("a test has a path");
    folder.pop();
    if folder.ends_with("deps") {
        folder.pop();
    }
    let flags: &[&str] = if folder.ends_with("release") {
        &["--release"]
    } else {
        &[]
    };
    (folder, flags)
}

/// Path of a program of the controller crate, built first if it is missing.
fn program(relative: &str) -> PathBuf {
    let (folder, flags) = build_folder();
    let path = folder.join(relative);
    if !path.exists() {
        let status = Command::new(env!("CARGO"))
            .args(["build", "-p", "controller", "--bins", "--examples"])
            .args(flags)
            .current_dir(env!("CARGO_MANIFEST_DIR"))
            .status()
            .expect("cargo runs");
        assert!(status.success(), "cannot build {relative}");
    }
    path
}

/// An instance of the controller with a sample policy file of its own.
struct World {
    instance: String,
    folder: TempDir,
}

impl World {
    fn new() -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let count = COUNT.fetch_add(1, Ordering::Relaxed);
        let folder = tempfile::tempdir().expect("a temporary folder");
        policy_file::write(&folder.path().join("policy.blob"), &sample::blob()).expect("a policy file");
        Self {
            instance: format!("test-{}-{count}", std::process::id()),
            folder,
        }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Where the programs of this world write their messages.
    fn log(&self) -> Stdio {
        let file = File::options().create(true).append(true).open(self.path("log"));
        file.expect("a log file").into()
    }

    fn controller(&self, more: &[&str]) -> Process {
        let child = Command::new(program("controller"))
            .arg("--policy")
            .arg(self.path("policy.blob"))
            .args(["--instance", &self.instance, "--robot-timeout-ms", "2000"])
            .args(more)
            .stderr(self.log())
            .spawn()
            .expect("the controller starts");
        Process(child)
    }

    fn robot(&self) -> Process {
        let child = Command::new(program("examples/sim_robot"))
            .args(["--instance", &self.instance])
            .stderr(self.log())
            .spawn()
            .expect("the simulated arm starts");
        Process(child)
    }

    fn client(&self) -> Client {
        Client::connect(&self.instance, PATIENCE).expect("a connection")
    }
}

impl Drop for World {
    fn drop(&mut self) {
        if std::thread::panicking() {
            let log = std::fs::read_to_string(self.path("log")).unwrap_or_default();
            eprintln!("what the programs said:\n{log}");
        }
        // The programs of a test are declared after its world, so they have ended by now.
        let purged = Instance::new(&self.instance).and_then(|instance| instance.purge());
        if let Err(error) = purged {
            eprintln!("left behind: {error}");
        }
    }
}

/// Waits for a status that `wanted` accepts, collecting the targets that come meanwhile.
fn await_status(
    client: &mut Client,
    targets: &mut Vec<JointTarget>,
    wanted: impl Fn(&Status) -> bool,
) -> Status {
    let start = Instant::now();
    while start.elapsed() < PATIENCE {
        let status = client.wait_status(Duration::from_millis(20)).expect("a status");
        while let Some(target) = client.next_target().expect("a target") {
            targets.push(target);
        }
        if let Some(status) = status.filter(|status| wanted(status)) {
            return status;
        }
    }
    panic!("the status waited for did not come");
}

fn idle(status: &Status) -> bool {
    status.state == Phase::Idle.code()
}

/// Asks a process to end as an operator does, and returns whether it ended well.
fn terminate(process: &mut Process) -> bool {
    let done = Command::new("kill")
        .args(["-TERM", &process.0.id().to_string()])
        .status()
        .is_ok_and(|status| status.success());
    assert!(done, "the signal was not sent");
    process.0.wait().is_ok_and(|status| status.success())
}

fn assert_limits(targets: &[JointTarget], period_s: f64) {
    let slack = 1.0 + 1e-6;
    for window in targets.windows(4) {
        let [a, b, c, d] = window else { unreachable!() };
        assert_eq!(d.seq, c.seq + 1, "no target was lost on the way");
        assert_eq!(d.stream, a.stream);
        assert_eq!(arm::joint_out_of_range(&d.q_rad), None);
        for i in 0..JOINTS {
            let speeds = [(a, b), (b, c), (c, d)].map(|(p, q)| (q.q_rad[i] - p.q_rad[i]) / period_s);
            let accelerations = [0, 1].map(|k| (speeds[k + 1] - speeds[k]) / period_s);
            let jerk = (accelerations[1] - accelerations[0]) / period_s;
            assert!(speeds[2].abs() <= SPEED_MAX_RAD_S * slack);
            assert!(accelerations[1].abs() <= ACCELERATION_MAX_RAD_S2 * slack);
            assert!(jerk.abs() <= JERK_MAX_RAD_S3 * slack);
        }
        let travel = arm::flange(&d.q_rad).position_m - arm::flange(&c.q_rad).position_m;
        assert!(travel.norm() / period_s <= FLANGE_SPEED_MAX_M_S * slack);
    }
}

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
    assert_limits(&targets, 0.004);

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
    assert_replays(&recording, &world.path("policy.blob"));
}

/// The program itself replays the recording bit for bit.
fn assert_replays(recording: &Path, policy: &Path) {
    let output = Command::new(program("controller"))
        .arg("replay")
        .arg(recording)
        .args(["--json", "--policy"])
        .arg(policy)
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

#[test]
fn an_emergency_stop_latches_until_a_reset() {
    let world = World::new();
    let _controller = world.controller(&["--rate-hz", "1000"]);
    let _robot = world.robot();
    let mut client = world.client();
    let mut targets = Vec::new();
    await_status(&mut client, &mut targets, idle);
    let id = client.send_goal(0, 0.33).expect("sent");
    await_status(&mut client, &mut targets, |status| {
        status.state == Phase::Approach.code()
    });
    client.send_command(CommandKind::EmergencyStop).expect("sent");
    let status = await_status(&mut client, &mut targets, |status| {
        status.state == Phase::Fault.code()
    });
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
    // The simulated arm needs a moment to come to rest.
    let start = Instant::now();
    loop {
        let reset = client.send_command(CommandKind::Reset).expect("sent");
        let status = await_status(&mut client, &mut targets, |status| status.command_id == reset);
        if status.command_reason == Reason::Accepted.code() {
            break;
        }
        assert!(start.elapsed() < PATIENCE, "{status:?}");
    }
    await_status(&mut client, &mut targets, idle);
    assert_limits(&targets, 0.004);
}

#[test]
fn a_killed_controller_starts_again_at_once() {
    let world = World::new();
    let _robot = world.robot();
    let mut slowest = Duration::ZERO;
    for round in 0u64..24 {
        let mut victim = world.controller(&[]);
        // Two of three rounds hit the first 30 ms, in which the services are being made.
        let spread_us = (round * 7919 + 137) % 30_000;
        let delay_us = if round % 3 == 2 {
            30_000 + 20 * spread_us
        } else {
            spread_us
        };
        std::thread::sleep(Duration::from_micros(delay_us));
        victim.0.kill().expect("killed");
        victim.0.wait().expect("reaped");
        let start = Instant::now();
        let _next = world.controller(&[]);
        let mut client = Client::connect(&world.instance, Duration::from_secs(2))
            .unwrap_or_else(|error| panic!("round {round}, killed after {delay_us} us: {error}"));
        let status = client.wait_status(PATIENCE).expect("a status");
        assert!(status.is_some(), "round {round}");
        slowest = slowest.max(start.elapsed());
    }
    println!("slowest restart {slowest:?}");
    let _controller = world.controller(&[]);
    let mut client = world.client();
    // The arm's driver has outlived 48 controllers and still finds the next one.
    await_status(&mut client, &mut Vec::new(), idle);
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
