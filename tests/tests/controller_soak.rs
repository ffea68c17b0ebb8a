//! The controller under everything at once: goals good and bad, cancels, emergency stops and resets,
//! clients that join, leave and are killed, a recorder that cannot keep up, busy processors. Counted:
//! calls to the allocator in the loop, limits broken, wrong answers, targets lost.

mod controller_world;

use controller::client::Client;
use controller::{clock, rt};
use controller_world::limit_check::LimitCheck;
use controller_world::{PATIENCE, Process, World, idle, in_phase, program, terminate};
use shared::messages::{CommandKind, GOAL_MAGIC, Goal, Phase, Reason, Status};
use std::io::Read;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// One soak.
struct Plan {
    rate_hz: u32,
    duration: Duration,
    goals: u64,
    /// Keeps every processor but the loop's busy.
    busy: bool,
    /// Records into a pipe that is read in bursts, so that the recorder's queue overflows; into a file,
    /// replayed at the end, otherwise.
    recorder_stalls: bool,
}

/// What the threads of a soak share.
struct Shared<'a> {
    world: &'a World,
    watched: AtomicBool,
    done: AtomicBool,
    targets: AtomicU64,
    clients_killed: AtomicU64,
}

impl Shared<'_> {
    fn goes_on(&self) -> bool {
        !self.done.load(Ordering::Relaxed)
    }
}

/// Ends the other threads also when this one panics.
struct EndsOthers<'a>(&'a AtomicBool);

impl Drop for EndsOthers<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Checks every target against every limit as it comes.
fn watch(shared: &Shared, period_s: f64) {
    let _ends = EndsOthers(&shared.done);
    let mut client = shared.world.client();
    shared.watched.store(true, Ordering::Relaxed);
    let mut check = LimitCheck::new(period_s);
    while shared.goes_on() {
        while let Some(target) = client.next_target().expect("targets come") {
            check
                .push(&target)
                .expect("no limit is broken and no target is lost");
            shared.targets.fetch_add(1, Ordering::Relaxed);
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Clients that join, leave and are killed.
fn come_and_go(shared: &Shared) {
    let mut round = 0u64;
    while shared.goes_on() {
        let mut child = Command::new(program("examples/watch_targets"))
            .args(["--instance", &shared.world.instance])
            .stdout(Stdio::null())
            .stderr(shared.world.log())
            .spawn()
            .map(Process)
            .expect("a client starts");
        std::thread::sleep(Duration::from_millis(round * 37 % 400));
        child.0.kill().expect("killed");
        child.0.wait().expect("reaped");
        shared.clients_killed.fetch_add(1, Ordering::Relaxed);
        // One that joins and leaves in good order.
        let _ = Client::connect(&shared.world.instance, Duration::from_secs(1));
        std::thread::sleep(Duration::from_millis(600));
        round += 1;
    }
}

/// Ordinary work on one processor.
fn keep_busy(shared: &Shared, cpu: usize) {
    assert!(rt::bind_to(&[cpu]));
    let mut value = 1.0f64;
    while shared.goes_on() {
        for _ in 0..1000 {
            value = std::hint::black_box(value * 1.000_000_1).sqrt();
        }
    }
}

/// Reads a pipe for three seconds and lets it be for six, over and over.
fn read_in_bursts(shared: &Shared, pipe: &Path) {
    let mut file = std::fs::File::open(pipe).expect("the pipe opens");
    let mut buffer = vec![0; 1 << 16];
    while shared.goes_on() {
        let start = Instant::now();
        while shared.goes_on() && start.elapsed() < Duration::from_secs(3) {
            if file.read(&mut buffer).expect("the pipe is read") == 0 {
                return;
            }
        }
        let start = Instant::now();
        while shared.goes_on() && start.elapsed() < Duration::from_secs(6) {
            std::thread::sleep(Duration::from_millis(50));
        }
    }
    while file.read(&mut buffer).is_ok_and(|more| more > 0) {}
}

/// The goal number `k`: every third is bad, in one of six ways. Also the verdict on it when idle, and
/// whether that verdict comes in every state.
fn goal(k: u64) -> (Goal, Reason, bool) {
    let mut goal = Goal {
        magic: GOAL_MAGIC,
        stamp_ns: clock::now_ns(),
        id: k + 1,
        x_m: 0.28 + 0.0001 * (k * 61 % 1000) as f64,
        rope: 0,
        keep_alive_ms: 0,
    };
    let (reason, always) = match (k % 3, k / 3 % 6) {
        (0, 0) => {
            goal.x_m = f64::NAN;
            (Reason::NonFinite, true)
        }
        (0, 1) => {
            goal.stamp_ns -= 700_000_000;
            (Reason::Stale, true)
        }
        (0, 2) => {
            goal.stamp_ns += 3_000_000_000;
            (Reason::FromFuture, true)
        }
        (0, 3) => {
            goal.magic = 0;
            (Reason::Malformed, true)
        }
        (0, 4) => {
            goal.x_m = 1.5;
            (Reason::OutOfRange, false)
        }
        (0, _) => {
            goal.rope = 3;
            (Reason::UnknownRope, false)
        }
        _ => (Reason::Accepted, false),
    };
    (goal, reason, always)
}

/// Whether the verdict in `status` is the right one; the status says in which state it was made.
fn is_right(status: &Status, goal: &Goal, expected: Reason, always: bool) -> bool {
    let reason = Reason::from_code(status.judged_reason).expect("a known reason");
    let state = Phase::from_code(status.state).expect("a known state");
    match reason {
        _ if reason == expected && reason == Reason::Accepted => status.active_goal_id == goal.id,
        _ if reason == expected => true,
        _ if always => false,
        Reason::Busy => status.active_goal_id != 0 || state == Phase::Stopping,
        Reason::Latched => state == Phase::Fault,
        Reason::NotReady => state == Phase::Waiting,
        _ => false,
    }
}

/// Waits for a status; `None` after [`PATIENCE`].
fn status_where(client: &mut Client, wanted: impl Fn(&Status) -> bool) -> Option<Status> {
    let start = Instant::now();
    while start.elapsed() < PATIENCE {
        let status = client
            .wait_status(Duration::from_millis(100))
            .expect("statuses come");
        if let Some(status) = status.filter(|status| wanted(status)) {
            return Some(status);
        }
    }
    None
}

/// Stops what runs, by a cancel or by an emergency stop and as many resets as it takes.
fn stop(client: &mut Client, emergency: bool) {
    if !emergency {
        client.send_command(CommandKind::Cancel).expect("sent");
    } else {
        client.send_command(CommandKind::EmergencyStop).expect("sent");
        status_where(client, in_phase(Phase::Fault)).expect("a stop latches");
        loop {
            let id = client.send_command(CommandKind::Reset).expect("sent");
            let status = status_where(client, |status| status.command_id == id).expect("an answer");
            if status.command_reason == Reason::Accepted.code() {
                break;
            }
        }
    }
    status_where(client, idle).expect("idle again");
}

/// Sends the goals evenly over the time; returns how many were accepted, and the wrong answers.
fn send_goals(plan: &Plan, mut client: Client) -> (u64, Vec<String>) {
    let start = Instant::now();
    let (mut accepted, mut wrong, mut runs_on) = (0, Vec::new(), 0);
    for k in 0..plan.goals {
        let due = plan.duration.mul_f64(k as f64 / plan.goals as f64);
        std::thread::sleep(due.saturating_sub(start.elapsed()));
        let (goal, expected, always) = goal(k);
        client.send_raw_goal(goal).expect("sent");
        let status = status_where(&mut client, |status| status.judged_goal_id == goal.id).expect("a verdict");
        if !is_right(&status, &goal, expected, always) {
            wrong.push(format!("{goal:?} expected {expected:?}: {status:?}"));
        }
        if status.active_goal_id == goal.id {
            accepted += 1;
            // Every tenth accepted goal runs to its end, the others are stopped somewhere.
            runs_on = if accepted % 10 == 1 { goal.id } else { 0 };
        }
        if runs_on == 0 && status.active_goal_id != 0 {
            std::thread::sleep(Duration::from_millis(k * 29 % 300));
            stop(&mut client, accepted % 4 == 0);
        } else if status.finished_goal_id == runs_on {
            runs_on = 0;
        }
        if status.state == Phase::Fault.code() {
            stop(&mut client, true);
        }
    }
    std::thread::sleep(plan.duration.saturating_sub(start.elapsed()));
    (accepted, wrong)
}

fn pipe(world: &World) -> std::path::PathBuf {
    let path = world.path("pipe.rec");
    let made = Command::new("mkfifo").arg(&path).status();
    assert!(made.is_ok_and(|status| status.success()), "a pipe is made");
    path
}

/// The controller's summary: the last lines of what the programs said.
fn last_words(world: &World) -> String {
    let log = std::fs::read_to_string(world.path("log")).expect("a log");
    let last: Vec<&str> = log.lines().rev().take(7).collect();
    last.into_iter().rev().collect::<Vec<_>>().join("\n")
}

/// Runs a soak and returns the controller's last words.
fn soak(plan: &Plan) -> String {
    let world = World::new();
    let recording = if plan.recorder_stalls {
        pipe(&world)
    } else {
        world.path("soak.rec")
    };
    let shared = Shared {
        world: &world,
        watched: AtomicBool::new(false),
        done: AtomicBool::new(false),
        targets: AtomicU64::new(0),
        clients_killed: AtomicU64::new(0),
    };
    let rate = plan.rate_hz.to_string();
    let (accepted, wrong, last) = std::thread::scope(|scope| {
        if plan.recorder_stalls {
            scope.spawn(|| read_in_bursts(&shared, &recording));
        }
        let mut controller = world.controller(&[
            "--rate-hz",
            &rate,
            "--record",
            recording.to_str().expect("a plain path"),
        ]);
        let ends = EndsOthers(&shared.done);
        let mut client = world.client();
        scope.spawn(|| watch(&shared, 0.004));
        while shared.goes_on() && !shared.watched.load(Ordering::Relaxed) {
            std::thread::sleep(Duration::from_millis(1));
        }
        let _robot = world.robot();
        status_where(&mut client, idle).expect("idle");
        scope.spawn(|| come_and_go(&shared));
        if plan.busy {
            let processors = rt::processors();
            let (_, others) = processors.split_last().expect("a processor");
            for &cpu in others {
                let shared = &shared;
                scope.spawn(move || keep_busy(shared, cpu));
            }
        }
        let (accepted, wrong) = send_goals(plan, client);
        drop(ends);
        assert!(
            terminate(&mut controller),
            "a signal ends the controller with code 0"
        );
        (accepted, wrong, last_words(&world))
    });
    println!(
        "{} goals, {accepted} accepted, {} wrong answers; {} targets checked; {} clients killed\n{last}",
        plan.goals,
        wrong.len(),
        shared.targets.load(Ordering::Relaxed),
        shared.clients_killed.load(Ordering::Relaxed),
    );
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(accepted > plan.goals / 10, "{accepted} goals accepted");
    assert!(last.contains(" 0 calls to the allocator,"), "{last}");
    if !plan.recorder_stalls {
        replays(&recording);
    }
    last
}

fn replays(recording: &Path) {
    let output = Command::new(program("controller"))
        .arg("replay")
        .arg(recording)
        .output()
        .expect("the controller runs");
    let words = |bytes: &[u8]| String::from_utf8_lossy(bytes).trim().to_string();
    println!("replayed: {}", words(&output.stdout));
    assert!(output.status.success(), "{}", words(&output.stderr));
}

fn lost(last: &str) -> u64 {
    let words = last.split(" messages lost").next().unwrap_or_default();
    let count = words.rsplit(' ').next().unwrap_or_default();
    count.parse().expect("a count")
}

#[test]
fn everything_at_once_for_a_short_while() {
    let last = soak(&Plan {
        rate_hz: 1000,
        duration: Duration::from_secs(16),
        goals: 60,
        busy: false,
        recorder_stalls: true,
    });
    assert!(lost(&last) > 0, "the recorder's queue overflowed");
}

#[test]
#[ignore = "17 minutes: run it by hand with --nocapture"]
fn a_million_cycles() {
    let last = soak(&Plan {
        rate_hz: 1000,
        duration: Duration::from_secs(1010),
        goals: 2000,
        busy: false,
        recorder_stalls: true,
    });
    assert!(lost(&last) > 0, "the recorder's queue overflowed");
}

#[test]
#[ignore = "10 minutes: run it by hand with --nocapture"]
fn ten_minutes_with_every_other_processor_busy() {
    soak(&Plan {
        rate_hz: 250,
        duration: Duration::from_secs(600),
        goals: 1000,
        busy: true,
        recorder_stalls: false,
    });
}
