//! The program `controller`: reads the command line and starts what it asks for.

use anyhow::{Context, Result, bail};
use clap::{CommandFactory, Parser, Subcommand};
use controller::constants::{ROBOT_TIMEOUT_DEFAULT_MS, ROBOT_TIMEOUT_RANGE_MS};
use controller::policy_file;
use controller::recorder::{self, Header};
use controller::serve::{self, Options, Rate};
use controller::session::DEFAULT_INSTANCE;
use controller::step::{Controller, Setup};
use controller::{bench, motion, rt, sample};
use serde_json::json;
use shared::arm::{self, DEFAULT_TASK_FRAME, Joints};
use shared::ik;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

const EXAMPLES: &str = "Examples:
  controller --policy runs/red/policy.blob                  stream targets to the arm's driver
  controller --policy runs/red/policy.blob --dry-run        the same without an arm
  controller fk 0 0.2 0 1 3.14159 1.3 0                     joints (rad) to flange (m)
  controller ik 0.1 0.15                                    release point (m) to joints (rad)";

/// Swings the tip of a rope to a commanded place with an xArm7, in real time.
#[derive(Parser)]
#[command(version, after_help = EXAMPLES, args_conflicts_with_subcommands = true)]
struct Cli {
    #[command(flatten)]
    serve: ServeArgs,
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(clap::Args)]
struct ServeArgs {
    /// The policy file that `offline freeze` wrote
    #[arg(long, value_name = "FILE")]
    policy: Option<PathBuf>,
    /// Cycles per second: 100 to 250, or 500, 750, 1000; targets leave at 250 or at this, if lower
    #[arg(long, value_name = "HZ", default_value = "250")]
    rate_hz: Rate,
    /// Send no targets; imagine an arm that follows at once
    #[arg(long)]
    dry_run: bool,
    /// Name that clients connect by
    #[arg(long, value_name = "NAME", default_value = DEFAULT_INSTANCE)]
    instance: String,
    /// Silence of the arm, ms, after which a motion is stopped (20 to 2000)
    #[arg(long, value_name = "MS", default_value_t = ROBOT_TIMEOUT_DEFAULT_MS, value_parser = timeout)]
    robot_timeout_ms: u64,
    /// Record every cycle to this file, for `controller replay`
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
}

#[derive(Subcommand)]
enum Command {
    /// Forward kinematics: seven joint angles (rad) to the flange's position (m) and rotation
    #[command(after_help = "Example: controller fk 0 0.2 0 1 3.14159 1.3 0 --json")]
    Fk {
        /// Joint angles, rad
        #[arg(value_name = "Q", num_args = 7, required = true, allow_negative_numbers = true, value_parser = finite)]
        q_rad: Vec<f64>,
        /// One JSON object on standard output
        #[arg(long)]
        json: bool,
    },
    /// Inverse kinematics: a release point (m, task plane) to seven joint angles (rad)
    #[command(after_help = "Example: controller ik 0.1 0.15 --policy runs/red/policy.blob")]
    Ik {
        /// x in the task plane, m
        #[arg(allow_negative_numbers = true, value_parser = finite)]
        x: f64,
        /// z in the task plane, m
        #[arg(allow_negative_numbers = true, value_parser = finite)]
        z: f64,
        /// Take the task's place from this policy file; the default place otherwise
        #[arg(long, value_name = "FILE")]
        policy: Option<PathBuf>,
        /// One JSON object on standard output
        #[arg(long)]
        json: bool,
    },
    /// Measure the loop's punctuality on this machine and the cost of its parts
    #[command(after_help = "Example: controller bench --rate-hz 1000 --seconds 10")]
    Bench {
        /// Use this policy; an untrained one otherwise
        #[arg(long, value_name = "FILE")]
        policy: Option<PathBuf>,
        /// Cycles per second, as for the controller itself
        #[arg(long, value_name = "HZ", default_value = "250")]
        rate_hz: Rate,
        /// How long to run the loop
        #[arg(long, value_name = "S", default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=3600))]
        seconds: u64,
        /// One JSON object on standard output
        #[arg(long)]
        json: bool,
    },
    /// Feed a recording's inputs to the controller again and compare every output bit for bit
    #[command(after_help = "Example: controller replay run.rec --policy runs/red/policy.blob")]
    Replay {
        /// The recording
        file: PathBuf,
        /// The policy file of that run
        #[arg(long, value_name = "FILE")]
        policy: PathBuf,
        /// One JSON object on standard output
        #[arg(long)]
        json: bool,
    },
}

fn finite(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ => Err("not a finite number".to_string()),
    }
}

fn timeout(text: &str) -> Result<u64, String> {
    match text.parse::<u64>() {
        Ok(value) if ROBOT_TIMEOUT_RANGE_MS.contains(&value) => Ok(value),
        _ => Err("use 20 to 2000".to_string()),
    }
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    let outcome = match cli.command {
        None => run_controller(cli.serve),
        Some(Command::Fk { q_rad, json }) => fk(&q_rad, json),
        Some(Command::Ik { x, z, policy, json }) => inverse([x, z], policy.as_deref(), json),
        Some(Command::Bench {
            policy,
            rate_hz,
            seconds,
            json,
        }) => run_bench(policy.as_deref(), rate_hz, seconds, json),
        Some(Command::Replay { file, policy, json }) => replay(&file, &policy, json),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("controller: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run_controller(args: ServeArgs) -> Result<()> {
    let Some(policy) = args.policy else {
        let kind = clap::error::ErrorKind::MissingRequiredArgument;
        Cli::command()
            .error(kind, "give --policy FILE, or a subcommand; see --help")
            .exit();
    };
    serve::serve(&Options {
        policy,
        rate: args.rate_hz,
        dry_run: args.dry_run,
        instance: args.instance,
        robot_timeout_ms: args.robot_timeout_ms,
        record: args.record,
    })
}

fn fk(q_rad: &[f64], as_json: bool) -> Result<()> {
    let q: Joints = q_rad.try_into().context("seven joint angles are needed")?;
    let pose = arm::flange(&q);
    let position: [f64; 3] = pose.position_m.into();
    let rows: Vec<Vec<f64>> = pose
        .rotation
        .row_iter()
        .map(|row| row.iter().copied().collect())
        .collect();
    let outside = arm::joint_out_of_range(&q).map(|joint| joint + 1);
    if as_json {
        let answer = json!({ "position_m": position, "rotation": rows, "joint_out_of_range": outside });
        println!("{answer}");
        return Ok(());
    }
    println!(
        "flange (m)  {:.6} {:.6} {:.6}",
        position[0], position[1], position[2]
    );
    for row in rows {
        println!("rotation    {:9.6} {:9.6} {:9.6}", row[0], row[1], row[2]);
    }
    if let Some(joint) = outside {
        println!("note        joint {joint} is outside its range");
    }
    Ok(())
}

fn inverse(point_m: [f64; 2], policy: Option<&Path>, as_json: bool) -> Result<()> {
    let frame = match policy {
        Some(path) => policy_file::read(path)?.blob.frame,
        None => DEFAULT_TASK_FRAME,
    };
    let pose = motion::task_pose(&frame, point_m);
    let position: [f64; 3] = pose.position_m.into();
    let q = ik::solve(&pose).with_context(|| {
        format!(
            "release point ({}, {}) m, flange at {position:?} m",
            point_m[0], point_m[1]
        )
    })?;
    let margin_rad = arm::margin_rad(&q);
    if as_json {
        println!(
            "{}",
            json!({ "q_rad": q, "flange_m": position, "margin_rad": margin_rad })
        );
        return Ok(());
    }
    let joints: Vec<String> = q.iter().map(|angle| format!("{angle:.6}")).collect();
    println!("joints (rad)  {}", joints.join(" "));
    println!(
        "flange (m)    {:.6} {:.6} {:.6}",
        position[0], position[1], position[2]
    );
    println!("margin (rad)  {margin_rad:.3} to the nearest joint limit");
    Ok(())
}

fn run_bench(policy: Option<&Path>, rate: Rate, seconds: u64, as_json: bool) -> Result<()> {
    let blob = match policy {
        Some(path) => policy_file::read(path)?.blob,
        None => sample::blob(),
    };
    let report = bench::run(&blob, rate, Duration::from_secs(seconds));
    if as_json {
        println!("{}", serde_json::to_string(&report)?);
        return Ok(());
    }
    println!("machine        {}", report.degraded);
    println!(
        "period         {} us, {} cycles missed",
        report.period_ns / 1000,
        report.missed
    );
    println!("wake-up late   {}", report.wake);
    println!("between turns  {}", report.between_turns);
    println!("turn           {}", report.turn);
    println!("policy         {}", report.policy);
    println!("ik, middle     {}", report.ik_from_middle);
    println!("ik, on a line  {}", report.ik_along_line);
    Ok(())
}

fn replay(file: &Path, policy: &Path, as_json: bool) -> Result<()> {
    let policy = policy_file::read(policy)?;
    let name = file.display();
    let mut input = BufReader::new(File::open(file).with_context(|| format!("cannot open {name}"))?);
    let header = Header::read(&mut input)
        .with_context(|| format!("cannot read {name}"))?
        .with_context(|| format!("{name} is not a recording: give a file that --record wrote"))?;
    if header.policy_crc != u64::from(policy.crc) {
        bail!("{name} was recorded with another policy file: give the one of that run");
    }
    if header.cycle_ns == 0 || header.cycles_per_target == 0 {
        bail!("{name} is damaged: its header names no period");
    }
    rt::flush_denormals();
    let controller = Controller::new(Setup {
        blob: policy.blob,
        cycle_ns: header.cycle_ns,
        cycles_per_target: header.cycles_per_target,
        silent_cycles_max: header.silent_cycles_max,
        degraded: header.degraded,
    });
    let found = recorder::replay(&mut input, controller).with_context(|| format!("cannot read {name}"))?;
    if as_json {
        println!(
            "{}",
            json!({ "cycles": found.cycles, "targets": found.targets, "truncated": found.truncated,
                    "first_difference": found.first_difference })
        );
    } else {
        let end = if found.truncated {
            ", the file ends within a record"
        } else {
            ""
        };
        println!("{} cycles, {} targets{end}", found.cycles, found.targets);
    }
    match found.first_difference {
        None => Ok(()),
        Some(cycle) => bail!("cycle {cycle} differs from the recording"),
    }
}
