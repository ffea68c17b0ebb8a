//! Plays the arm: follows every new target with a first-order lag and reports its joints 250 times a
//! second. The shape of a real driver: replace the lag by the arm's own interface.
//!
//! `cargo run --release -p controller --example sim_robot`

use anyhow::{Context, Result};
use clap::Parser;
use controller::arguments;
use controller::client::{ArmPort, Client};
use controller::clock;
use controller::program;
use controller::session::DEFAULT_INSTANCE;
use shared::arm::{JOINTS, Joints, LEVEL_POSTURE_RAD};
use shared::messages::{JointTarget, Phase, RobotState};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

const PERIOD_NS: u64 = 4_000_000;
/// A live controller sends a status every 100 ms.
const SILENCE: Duration = Duration::from_secs(1);
/// A target older than this is not sent: nobody streams any more, and the arm may have been moved since.
const TARGET_AGE_MAX_NS: u64 = 100_000_000;
/// Reported where targets were left out, as `controller/clients/README.md` asks of every driver.
const STREAM_TORN: u32 = 998;

/// A simulated xArm7. Ctrl-C ends it.
#[derive(Parser)]
#[command(after_help = "Example: sim_robot --lag-s 0.05 --seconds 60 --json")]
struct Args {
    /// Name of the controller
    #[arg(long, default_value = DEFAULT_INSTANCE, value_parser = arguments::instance)]
    instance: String,
    /// Time constant of the joints, s (0 to 10)
    #[arg(long, default_value_t = 0.02, value_parser = arguments::number(0.0, 10.0))]
    lag_s: f64,
    /// Longest step of a joint from one target to the next that is sent, rad (0 to 10): a longer one has left targets out,
    /// because something held up this program
    #[arg(long, default_value_t = 0.05, value_parser = arguments::number(0.0, 10.0))]
    step_max_rad: f64,
    /// End after this time, s (0 to 1000000); 0 is never
    #[arg(long, default_value_t = 0.0, value_parser = arguments::number(0.0, 1e6))]
    seconds: f64,
    /// The summary as one JSON object on standard output
    #[arg(long)]
    json: bool,
}

/// What was done until the end.
#[derive(Default, serde::Serialize)]
struct Summary {
    connections: u64,
    states_sent: u64,
}

struct Arm {
    q_rad: Joints,
    dq_rad_s: Joints,
    /// Where the arm was sent last: it goes there even when nothing else is sent.
    sent_rad: Joints,
    sent_seq: u64,
    sent_stream: u32,
    /// Whether something was sent since the arm last stood free of a stream.
    in_stream: bool,
    gripper: u32,
    error_code: u32,
    share_per_period: f64,
    step_max_rad: f64,
}

impl Arm {
    /// At the start of a connection: the target that is there already is never sent, for the arm may have been
    /// moved by hand since it was made.
    fn skip_newest(&mut self, port: &mut ArmPort) {
        self.sent_seq = port.newest_target().map_or(0, |target| target.seq);
        self.in_stream = false;
    }

    /// Number 0 is no target.
    fn is_new(&self, target: &JointTarget) -> bool {
        let age_ns = clock::now_ns().saturating_sub(target.stamp_ns);
        target.seq != 0 && target.seq != self.sent_seq && age_ns <= TARGET_AGE_MAX_NS
    }

    fn follow(&mut self, port: &mut ArmPort) {
        if let Some(target) = port.newest_target().filter(|target| self.is_new(target)) {
            self.sent_seq = target.seq;
            if self.error_code == 0 {
                self.send(&target);
            }
        }
        let period_s = PERIOD_NS as f64 * 1e-9;
        for i in 0..JOINTS {
            let step = (self.sent_rad[i] - self.q_rad[i]) * self.share_per_period;
            self.q_rad[i] += step;
            self.dq_rad_s[i] = step / period_s;
        }
    }

    fn send(&mut self, target: &JointTarget) {
        if target.stream != self.sent_stream {
            // A new stream begins where the arm was measured, to where a person may have guided it.
            (self.sent_stream, self.in_stream) = (target.stream, false);
        }
        let from_rad = if self.in_stream { self.sent_rad } else { self.q_rad };
        let steps_rad = (0..JOINTS).map(|i| (target.q_rad[i] - from_rad[i]).abs());
        if steps_rad.fold(0.0, f64::max) > self.step_max_rad {
            program::tell(
                "sim_robot: targets were left out, and the arm would jump: something holds up this program",
            );
            self.error_code = STREAM_TORN;
            return;
        }
        self.sent_rad = target.q_rad;
        self.gripper = target.gripper;
        self.in_stream = true;
    }

    /// An error is reported until the controller has latched it; nothing moves until a person resets the controller.
    fn clear(&mut self, port: &mut ArmPort) {
        self.error_code = 0;
        self.skip_newest(port);
        program::tell("sim_robot: clear again; reset the controller to go on");
    }

    fn state(&self) -> RobotState {
        RobotState {
            error_code: self.error_code,
            q_rad: self.q_rad,
            dq_rad_s: self.dq_rad_s,
            gripper: self.gripper,
            ..RobotState::default()
        }
    }
}

fn main() -> ExitCode {
    program::finish("sim_robot", run(&program::arguments("sim_robot")))
}

fn run(args: &Args) -> Result<()> {
    let end = (args.seconds > 0.0).then(|| Instant::now() + Duration::from_secs_f64(args.seconds));
    let told_to_end = Arc::new(AtomicBool::new(false));
    let told = Arc::clone(&told_to_end);
    ctrlc::set_handler(move || told.store(true, Ordering::Relaxed)).context("cannot watch for signals")?;
    let ended = || told_to_end.load(Ordering::Relaxed) || end.is_some_and(|end| Instant::now() > end);
    let mut summary = Summary::default();
    let mut arm = Arm {
        q_rad: LEVEL_POSTURE_RAD,
        dq_rad_s: [0.0; JOINTS],
        sent_rad: LEVEL_POSTURE_RAD,
        sent_seq: 0,
        sent_stream: 0,
        in_stream: false,
        gripper: 0,
        error_code: 0,
        step_max_rad: args.step_max_rad,
        share_per_period: 1.0 - (-(PERIOD_NS as f64) * 1e-9 / args.lag_s).exp(),
    };
    while !ended() {
        // A controller that is not there yet, or was restarted, is waited for; one of another version is not.
        match Client::connect(&args.instance, SILENCE) {
            Ok(mut client) => {
                summary.connections += 1;
                if let Err(error) = play(&mut arm, &mut client, &mut summary.states_sent, &ended) {
                    program::tell(&format!("sim_robot: {error:#}; connecting again"));
                }
            }
            Err(error) if error.may_pass() => {}
            Err(error) => return Err(error.into()),
        }
    }
    program::answer(args.json, &summary, |out| {
        writeln!(
            out,
            "{} connections, {} states sent",
            summary.connections, summary.states_sent
        )
    })?;
    Ok(())
}

/// Until the end, or until the controller falls silent.
fn play(arm: &mut Arm, client: &mut Client, states_sent: &mut u64, ended: &dyn Fn() -> bool) -> Result<()> {
    let mut port = client.arm()?;
    arm.skip_newest(&mut port);
    let mut heard = Instant::now();
    let mut next_ns = clock::now_ns();
    while !ended() && heard.elapsed() < SILENCE {
        while let Some(status) = client.next_status()? {
            heard = Instant::now();
            if arm.error_code != 0 && status.state == Phase::Fault.code() {
                arm.clear(&mut port);
            }
        }
        arm.follow(&mut port);
        port.send_state(arm.state())?;
        *states_sent += 1;
        next_ns = (next_ns + PERIOD_NS).max(clock::now_ns());
        clock::sleep_until(next_ns);
    }
    Ok(())
}
