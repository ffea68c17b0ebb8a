//! Sends one command to a running controller and prints how it was judged.
//!
//! `cargo run --release -p controller --example send_command -- stop`

use anyhow::{Result, bail};
use clap::{Parser, ValueEnum};
use controller::arguments;
use controller::client::Client;
use controller::program;
use controller::session::DEFAULT_INSTANCE;
use controller::words::Words;
use shared::messages::{CommandKind, Reason};
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// Sends one command and waits until it is judged.
#[derive(Parser)]
#[command(after_help = "Example: send_command reset --json")]
struct Args {
    /// What the controller shall do
    kind: Kind,
    /// Name of the controller
    #[arg(long, default_value = DEFAULT_INSTANCE, value_parser = arguments::instance)]
    instance: String,
    /// How the command was judged as one JSON object on standard output
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum Kind {
    /// Stop now and latch: only a reset goes on
    Stop,
    /// Go on after a stop or a fault; the arm must stand still and report no error
    Reset,
    /// Stop, drop the goal and be ready for another
    Cancel,
}

/// How a command was judged.
#[derive(serde::Serialize)]
struct Verdict {
    command_id: u64,
    /// Of the controller, then.
    state: Words,
    reason: Words,
}

fn main() -> ExitCode {
    program::finish("send_command", run(&program::arguments("send_command")))
}

fn run(args: &Args) -> Result<()> {
    let mut client = Client::connect(&args.instance, Duration::from_secs(2))?;
    let command_id = client.send_command(match args.kind {
        Kind::Stop => CommandKind::EmergencyStop,
        Kind::Reset => CommandKind::Reset,
        Kind::Cancel => CommandKind::Cancel,
    })?;
    let sent = Instant::now();
    while sent.elapsed() < Duration::from_secs(1) {
        let Some(status) = client.wait_status(Duration::from_millis(100))? else {
            continue;
        };
        if status.command_id != command_id {
            continue;
        }
        let verdict = Verdict {
            command_id,
            state: Words::of_state(status.state),
            reason: Words::of_reason(status.command_reason),
        };
        if verdict.reason.code != Reason::Accepted.code() {
            bail!("refused: {}", verdict.reason.advice());
        }
        return Ok(if args.json {
            program::write_json(&verdict)
        } else {
            program::write(|out| writeln!(out, "accepted; the controller: {}", verdict.state.text))
        }?);
    }
    bail!("no answer within a second: is the controller still running, or do others send commands?")
}
