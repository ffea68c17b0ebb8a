//! Prints every joint target of a running controller as comma-separated values or JSON lines.
//!
//! `cargo run --release -p controller --example watch_targets -- --seconds 10 > targets.csv`

use anyhow::Result;
use clap::Parser;
use controller::arguments;
use controller::client::Client;
use controller::program;
use controller::session::DEFAULT_INSTANCE;
use serde_json::json;
use shared::messages::JointTarget;
use std::io::{self, Write};
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// Prints targets as they come.
#[derive(Parser)]
#[command(after_help = "Example: watch_targets --seconds 20 > targets.csv")]
struct Args {
    /// How long to watch, s (0 to 1000000)
    #[arg(long, default_value_t = 10.0, value_parser = arguments::number(0.0, 1e6))]
    seconds: f64,
    /// Name of the controller
    #[arg(long, default_value = DEFAULT_INSTANCE, value_parser = arguments::instance)]
    instance: String,
    /// One JSON object per line on standard output
    #[arg(long)]
    json: bool,
}

fn main() -> ExitCode {
    program::finish("watch_targets", run(&program::arguments("watch_targets")))
}

fn run(args: &Args) -> Result<()> {
    let mut client = Client::connect(&args.instance, Duration::from_secs(2))?;
    if !args.json {
        program::write(|out| {
            writeln!(
                out,
                "stream,seq,stamp_ns,goal_id,phase,gripper,q1_rad,q2_rad,q3_rad,q4_rad,q5_rad,q6_rad,q7_rad"
            )
        })?;
    }
    let start = Instant::now();
    while start.elapsed().as_secs_f64() < args.seconds {
        while let Some(target) = client.next_target()? {
            program::answer(args.json, &object(&target), |out| row(out, &target))?;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    Ok(())
}

fn object(target: &JointTarget) -> serde_json::Value {
    json!({
        "stream": target.stream,
        "seq": target.seq,
        "stamp_ns": target.stamp_ns,
        "goal_id": target.goal_id,
        "phase": target.phase,
        "gripper": target.gripper,
        "q_rad": target.q_rad,
    })
}

fn row(out: &mut dyn Write, target: &JointTarget) -> io::Result<()> {
    write!(
        out,
        "{},{},{},{},{},{}",
        target.stream, target.seq, target.stamp_ns, target.goal_id, target.phase, target.gripper
    )?;
    for angle in target.q_rad {
        write!(out, ",{angle:.9}")?;
    }
    writeln!(out)
}
