//! Sends one goal to a running controller and prints what becomes of it.
//!
//! `cargo run --release -p controller --example send_goal -- --x 0.40`

use anyhow::{Result, bail};
use clap::Parser;
use controller::arguments;
use controller::client::Client;
use controller::program;
use controller::session::DEFAULT_INSTANCE;
use controller::words::Words;
use shared::blob::MAX_ROPES;
use shared::messages::{Reason, Status};
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// Sends one goal and waits until it is done or refused.
#[derive(Parser)]
#[command(after_help = "Example: send_goal --x 0.40 --keep-alive-ms 100 --json")]
struct Args {
    /// Where the tip shall reach, x in the task frame, m (-10 to 10)
    #[arg(long, allow_negative_numbers = true, value_parser = arguments::number(-10.0, 10.0))]
    x: f64,
    /// Which rope of the policy file, from 0 (to 15)
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u32).range(..MAX_ROPES as i64))]
    rope: u32,
    /// Promise a sign of life this often, ms (0 to 60000): when this program dies, the arm stops; 0 promises
    /// nothing
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u32).range(..=60_000))]
    keep_alive_ms: u32,
    /// Name of the controller
    #[arg(long, default_value = DEFAULT_INSTANCE, value_parser = arguments::instance)]
    instance: String,
    /// What became of the goal as one JSON object on standard output
    #[arg(long)]
    json: bool,
}

/// How long a verdict and every status may be in coming.
const PATIENCE: Duration = Duration::from_secs(1);

/// What became of a goal.
#[derive(serde::Serialize)]
struct Outcome {
    goal_id: u64,
    /// "refused" or "ended".
    outcome: &'static str,
    /// Of the controller, then.
    state: Words,
    reason: Words,
}

fn main() -> ExitCode {
    program::finish("send_goal", run(&program::arguments("send_goal")))
}

fn run(args: &Args) -> Result<()> {
    let mut client = Client::connect(&args.instance, Duration::from_secs(2))?;
    let id = client.send_watched_goal(args.rope, args.x, args.keep_alive_ms)?;
    let mut state = None;
    // The goal is wanted whether or not somebody reads about it, so this is looked at last.
    let mut told = Ok(());
    let sent = Instant::now();
    let mut taken = false;
    // A live controller sends a status every 100 ms.
    let mut heard = sent;
    while heard.elapsed() < PATIENCE {
        if args.keep_alive_ms > 0 {
            client.keep_alive(id)?;
        }
        let pause = Duration::from_millis(u64::from(args.keep_alive_ms.clamp(3, 90)) / 3);
        let Some(status) = client.wait_status(pause)? else {
            continue;
        };
        heard = Instant::now();
        if let Some(outcome) = outcome(&status, id) {
            let done = outcome.reason.code == Reason::Done.code();
            let line = format!("goal {id} {}: {}", outcome.outcome, outcome.reason.advice());
            if args.json {
                told = told.and_then(|()| program::write_json(&outcome));
            } else if done {
                told = told.and_then(|()| program::write(|out| writeln!(out, "goal {id} ended: done")));
            }
            if !done {
                bail!(line);
            }
            return Ok(told?);
        }
        taken |= status.active_goal_id == id;
        if !taken && sent.elapsed() > PATIENCE {
            bail!(
                "no verdict on goal {id} within a second, so it is not served: others send goals too; send it anew"
            );
        }
        if !args.json && status.active_goal_id == id && state != Some(status.state) {
            state = Some(status.state);
            let text = Words::of_state(status.state).text;
            told = told.and_then(|()| program::write(|out| writeln!(out, "{text}")));
        }
    }
    bail!("the controller fell silent: is it still running?")
}

/// What became of the goal `id`, once this status says so.
fn outcome(status: &Status, id: u64) -> Option<Outcome> {
    let refused = status.judged_goal_id == id && status.judged_reason != Reason::Accepted.code();
    let (outcome, reason) = if status.finished_goal_id == id {
        ("ended", status.finished_reason)
    } else if refused {
        ("refused", status.judged_reason)
    } else {
        return None;
    };
    Some(Outcome {
        goal_id: id,
        outcome,
        state: Words::of_state(status.state),
        reason: Words::of_reason(reason),
    })
}
