//! Prints every joint target of a running controller as comma-separated values.
//!
//! `cargo run --release -p controller --example watch_targets -- --seconds 10 > targets.csv`

use anyhow::Result;
use clap::Parser;
use controller::client::Client;
use controller::program;
use std::io::{BufWriter, ErrorKind, Write};
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// Prints targets as they come.
#[derive(Parser)]
struct Args {
    /// How long to watch, s
    #[arg(long, default_value_t = 10.0)]
    seconds: f64,
    /// Name of the controller
    #[arg(long, default_value = "genorm")]
    instance: String,
}

fn main() -> ExitCode {
    program::finish("watch_targets", run(&Args::parse()))
}

fn run(args: &Args) -> Result<()> {
    let mut client = Client::connect(&args.instance, Duration::from_secs(2))?;
    match watch(&mut client, args.seconds) {
        // The reader of the pipe has seen enough.
        Err(error) if is_broken_pipe(&error) => Ok(()),
        outcome => outcome,
    }
}

fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error
        .downcast_ref::<std::io::Error>()
        .is_some_and(|error| error.kind() == ErrorKind::BrokenPipe)
}

fn watch(client: &mut Client, seconds: f64) -> Result<()> {
    let mut out = BufWriter::new(std::io::stdout().lock());
    writeln!(
        out,
        "stream,seq,stamp_ns,goal_id,phase,gripper,q1_rad,q2_rad,q3_rad,q4_rad,q5_rad,q6_rad,q7_rad"
    )?;
    let start = Instant::now();
    while start.elapsed().as_secs_f64() < seconds {
        while let Some(target) = client.next_target()? {
            write!(
                out,
                "{},{},{},{},{},{}",
                target.stream, target.seq, target.stamp_ns, target.goal_id, target.phase, target.gripper
            )?;
            for angle in target.q_rad {
                write!(out, ",{angle:.9}")?;
            }
            writeln!(out)?;
        }
        out.flush()?;
        std::thread::sleep(Duration::from_millis(10));
    }
    Ok(())
}
