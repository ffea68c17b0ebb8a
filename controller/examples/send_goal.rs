//! Sends one goal to a running controller and prints what becomes of it.
//!
//! `cargo run --release -p controller --example send_goal -- --x 0.40`

use anyhow::{Result, bail};
use clap::Parser;
use controller::client::Client;
use controller::program;
use shared::messages::{Phase, Reason};
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// Sends one goal and waits until it is done or refused.
#[derive(Parser)]
struct Args {
    /// Where the tip shall reach, x in the task frame, m
    #[arg(long, allow_negative_numbers = true)]
    x: f64,
    /// Which rope of the policy file, from 0
    #[arg(long, default_value_t = 0)]
    rope: u32,
    /// Promise a sign of life this often, ms: when this program dies, the arm stops; 0 promises nothing
    #[arg(long, default_value_t = 0)]
    keep_alive_ms: u32,
    /// Name of the controller
    #[arg(long, default_value = "genorm")]
    instance: String,
}

fn main() -> ExitCode {
    program::finish("send_goal", run(&Args::parse()))
}

fn run(args: &Args) -> Result<()> {
    let mut client = Client::connect(&args.instance, Duration::from_secs(2))?;
    let id = client.send_watched_goal(args.rope, args.x, args.keep_alive_ms)?;
    let text = |code| Reason::from_code(code).map_or("a reason this client does not know", Reason::text);
    let mut state = None;
    // A live controller sends a status every 100 ms.
    let mut heard = Instant::now();
    while heard.elapsed() < Duration::from_secs(1) {
        if args.keep_alive_ms > 0 {
            client.keep_alive(id)?;
        }
        let pause = Duration::from_millis(u64::from(args.keep_alive_ms.clamp(3, 90)) / 3);
        let Some(status) = client.wait_status(pause)? else {
            continue;
        };
        heard = Instant::now();
        if status.finished_goal_id == id {
            println!("goal {id} ended: {}", text(status.finished_reason));
            if status.finished_reason != Reason::Done.code() {
                bail!("reason {}", status.finished_reason);
            }
            return Ok(());
        }
        if status.judged_goal_id == id && status.judged_reason != Reason::Accepted.code() {
            bail!(
                "goal {id} refused: {} (reason {})",
                text(status.judged_reason),
                status.judged_reason
            );
        }
        if status.active_goal_id == id && state != Some(status.state) {
            state = Some(status.state);
            println!(
                "{}",
                Phase::from_code(status.state).map_or("unknown state", Phase::text)
            );
        }
    }
    bail!("the controller fell silent: is it still running?")
}
