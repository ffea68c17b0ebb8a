//! Sends one goal to a running controller and prints what becomes of it.
//!
//! `cargo run --release -p controller --example send_goal -- --x 0.40`

use anyhow::{Result, bail};
use clap::Parser;
use controller::client::Client;
use controller::program;
use shared::messages::{Phase, Reason};
use std::process::ExitCode;
use std::time::Duration;

/// Sends one goal and waits until it is done or refused.
#[derive(Parser)]
struct Args {
    /// Where the tip shall reach, x in the task frame, m
    #[arg(long, allow_negative_numbers = true)]
    x: f64,
    /// Which rope of the policy file, from 0
    #[arg(long, default_value_t = 0)]
    rope: u32,
    /// Name of the controller
    #[arg(long, default_value = "genorm")]
    instance: String,
}

fn main() -> ExitCode {
    program::finish("send_goal", run(&Args::parse()))
}

fn run(args: &Args) -> Result<()> {
    let mut client = Client::connect(&args.instance, Duration::from_secs(2))?;
    let id = client.send_goal(args.rope, args.x)?;
    let text = |code| Reason::from_code(code).map_or("a reason this client does not know", Reason::text);
    let mut state = None;
    while let Some(status) = client.wait_status(Duration::from_secs(1))? {
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
