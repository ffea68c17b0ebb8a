//! The program `controller`: reads the command line and starts what it asks for.

use anyhow::{Context, Result, anyhow, bail};
use clap::{CommandFactory, Parser, Subcommand};
use controller::arguments;
use controller::bench::LoopReport;
use controller::constants::{GRIPPER_LATENCY_MAX_MS, ROBOT_TIMEOUT_DEFAULT_MS, ROBOT_TIMEOUT_RANGE_MS};
use controller::policy_file;
use controller::program;
use controller::recorder;
use controller::serve::{self, Options, Rate};
use controller::session::DEFAULT_INSTANCE;
use controller::step::{Controller, Setup};
use controller::timing::Percentiles;
use controller::{allocations, bench, rt, sample};
use serde_json::json;
use shared::arm::{self, DEFAULT_TASK_FRAME, Joints};
use shared::ik;
use std::fs::File;
use std::io::{self, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

#[global_allocator]
static ALLOCATOR: allocations::Counting = allocations::Counting;

const EXAMPLES: &str = "Examples:
  controller --policy runs/red/policy.blob                  stream targets to the arm's driver
  controller --policy runs/red/policy.blob --dry-run        the same without an arm
  controller fk 0 0.2 0 1 3.14159 1.3 0                     joints (rad) to flange (m)
  controller ik 0.1 0.15                                    release point (m) to joints (rad)";

const BENCH_HELP: &str = "What is printed:
  wake-up late      from the instant that the sleep was asked to end at, 150 us before a turn is due, until
                    the loop is awake: what cyclictest measures too
  plan ahead, cold  the first plan after a wake-up, made before the turn: what it saves a turn with a goal
  turn begins late  from the instant that a turn is due until it begins
  period jitter     how far the time between the starts of two turns is from the nominal one
  turn              from the start of a turn until its target, status and record are out. What the loop did
                    before, awake and ahead of time, is not in it
  with a goal       those turns that judged a goal
  goal to target    from a client's stamp on a goal, sent at instants spread evenly over the period, until
                    its first target is out, through iceoryx2 and the bridge
  parts             each part by itself, over and over, so with warm caches

Example: controller bench --rate-hz 1000 --seconds 10 --histograms bench/";

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
    /// Cycles per second, 100 to 1000; the arm gets at most 250 targets a second (exactly 250 at 250,
    /// 500, 750 and 1000)
    #[arg(long, value_name = "HZ", default_value = "250", allow_negative_numbers = true)]
    rate_hz: Rate,
    /// Send no targets; imagine an arm that follows at once
    #[arg(long)]
    dry_run: bool,
    /// Name that clients connect by
    #[arg(long, value_name = "NAME", default_value = DEFAULT_INSTANCE, value_parser = arguments::instance)]
    instance: String,
    /// Silence of the arm, ms, after which a motion is stopped (20 to 2000)
    #[arg(long, value_name = "MS", default_value_t = ROBOT_TIMEOUT_DEFAULT_MS, value_parser = timeout, allow_negative_numbers = true)]
    robot_timeout_ms: u64,
    /// Time the gripper takes to let go, ms (0 to 2000): it is told to open that much before the release.
    /// `offline diagnose` finds it as the effect "release delay"
    #[arg(long, value_name = "MS", default_value_t = 0, value_parser = clap::value_parser!(u64).range(..=GRIPPER_LATENCY_MAX_MS), allow_negative_numbers = true)]
    gripper_latency_ms: u64,
    /// Record every cycle to this new file, for `controller replay`
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// One JSON object on standard output for every event
    #[arg(long)]
    json: bool,
}

#[derive(Subcommand)]
enum Command {
    /// Forward kinematics: seven joint angles (rad) to the flange's position (m) and rotation
    #[command(after_help = "Example: controller fk 0 0.2 0 1 3.14159 1.3 0 --json")]
    Fk {
        /// Joint angles, rad (-10 to 10: more are degrees by mistake)
        #[arg(value_name = "Q", num_args = 7, required = true, allow_negative_numbers = true, value_parser = arguments::number(-10.0, 10.0))]
        q_rad: Vec<f64>,
        /// One JSON object on standard output
        #[arg(long)]
        json: bool,
    },
    /// Inverse kinematics: a release point (m, task plane) to seven joint angles (rad)
    #[command(after_help = "Example: controller ik 0.1 0.15 --policy runs/red/policy.blob")]
    Ik {
        /// x in the task plane, m (-10 to 10)
        #[arg(allow_negative_numbers = true, value_parser = arguments::number(-10.0, 10.0))]
        x: f64,
        /// z in the task plane, m (-10 to 10)
        #[arg(allow_negative_numbers = true, value_parser = arguments::number(-10.0, 10.0))]
        z: f64,
        /// Take the task's place from this policy file; the default place otherwise
        #[arg(long, value_name = "FILE")]
        policy: Option<PathBuf>,
        /// One JSON object on standard output
        #[arg(long)]
        json: bool,
    },
    /// Measure the loop's punctuality on this machine and the cost of its parts
    #[command(after_help = BENCH_HELP)]
    Bench {
        /// Use this policy; an untrained one otherwise
        #[arg(long, value_name = "FILE")]
        policy: Option<PathBuf>,
        /// Cycles per second, as for the controller itself
        #[arg(long, value_name = "HZ", default_value = "250", allow_negative_numbers = true)]
        rate_hz: Rate,
        /// How long to run the loop under each load, and cyclictest (if installed) again, s (1 to 3600)
        #[arg(long, value_name = "S", default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=3600), allow_negative_numbers = true)]
        seconds: u64,
        /// Write HDR histograms (.hgrm) into this folder
        #[arg(long, value_name = "DIR")]
        histograms: Option<PathBuf>,
        /// One JSON object on standard output
        #[arg(long)]
        json: bool,
    },
    /// Feed a recording's inputs to the controller again and compare every output bit for bit
    #[command(after_help = "Example: controller replay run.rec")]
    Replay {
        /// The recording; it holds the policy file of its run
        file: PathBuf,
        /// One JSON object on standard output
        #[arg(long)]
        json: bool,
    },
}

fn timeout(text: &str) -> Result<u64, String> {
    match text.parse::<u64>() {
        Ok(value) if ROBOT_TIMEOUT_RANGE_MS.contains(&value) => Ok(value),
        _ => Err("use 20 to 2000".to_string()),
    }
}

fn main() -> ExitCode {
    let cli: Cli = program::arguments("controller");
    let outcome = match cli.command {
        None => run_controller(cli.serve),
        Some(Command::Fk { q_rad, json }) => fk(&q_rad, json),
        Some(Command::Ik { x, z, policy, json }) => inverse([x, z], policy.as_deref(), json),
        Some(Command::Bench {
            policy,
            rate_hz,
            seconds,
            histograms,
            json,
        }) => {
            let duration = Duration::from_secs(seconds);
            run_bench(policy.as_deref(), rate_hz, duration, histograms.as_deref(), json)
        }
        Some(Command::Replay { file, json }) => replay(&file, json),
    };
    program::finish("controller", outcome)
}

fn run_controller(args: ServeArgs) -> Result<()> {
    let Some(policy) = args.policy else {
        let kind = clap::error::ErrorKind::MissingRequiredArgument;
        let error = Cli::command().error(kind, "give --policy FILE, or a subcommand; see --help");
        program::refuse("controller", &error);
    };
    serve::serve(&Options {
        policy,
        rate: args.rate_hz,
        dry_run: args.dry_run,
        instance: args.instance,
        robot_timeout_ms: args.robot_timeout_ms,
        gripper_latency_ms: args.gripper_latency_ms,
        record: args.record,
        json: args.json,
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
    let answer = json!({ "position_m": position, "rotation": rows, "joint_out_of_range": outside });
    program::answer(as_json, &answer, |out| {
        let [x, y, z] = position;
        writeln!(out, "flange (m)  {x:.6} {y:.6} {z:.6}")?;
        for row in rows {
            writeln!(out, "rotation    {:9.6} {:9.6} {:9.6}", row[0], row[1], row[2])?;
        }
        if let Some(joint) = outside {
            writeln!(out, "note        joint {joint} is outside its range")?;
        }
        Ok(())
    })?;
    Ok(())
}

fn inverse(point_m: [f64; 2], policy: Option<&Path>, as_json: bool) -> Result<()> {
    let frame = match policy {
        Some(path) => policy_file::read(path)?.blob.frame,
        None => DEFAULT_TASK_FRAME,
    };
    let pose = arm::task_pose(&frame, point_m);
    let position: [f64; 3] = pose.position_m.into();
    let q = ik::solve(&pose).map_err(|error| {
        let [x, z] = point_m;
        anyhow!(
            "release point ({x}, {z}) m, flange at {position:?} m: {error}; give a point nearer to the middle of the arm's reach"
        )
    })?;
    let margin_rad = arm::margin_rad(&q);
    let answer = json!({ "q_rad": q, "flange_m": position, "margin_rad": margin_rad });
    program::answer(as_json, &answer, |out| {
        let joints: Vec<String> = q.iter().map(|angle| format!("{angle:.6}")).collect();
        let [x, y, z] = position;
        writeln!(out, "joints (rad)  {}", joints.join(" "))?;
        writeln!(out, "flange (m)    {x:.6} {y:.6} {z:.6}")?;
        writeln!(out, "margin (rad)  {margin_rad:.3} to the nearest joint limit")
    })?;
    Ok(())
}

fn run_bench(
    policy: Option<&Path>,
    rate: Rate,
    duration: Duration,
    histograms: Option<&Path>,
    as_json: bool,
) -> Result<()> {
    let blob = match policy {
        Some(path) => policy_file::read(path)?.blob,
        None => sample::blob(),
    };
    let report = bench::run(&bench::Settings {
        blob: &blob,
        rate,
        duration,
        histograms,
        progress: &program::tell,
    })?;
    program::answer(as_json, &report, |out| print_report(out, &report))?;
    Ok(())
}

fn print_report(out: &mut dyn Write, report: &bench::Report) -> io::Result<()> {
    writeln!(out, "machine         {}", report.degraded)?;
    writeln!(out, "period          {} us", report.period_ns / 1000)?;
    if let Some(reason) = &report.cyclictest_missing {
        writeln!(out, "comparison      {reason}")?;
    }
    print_loop(out, "nothing else runs", &report.idle)?;
    match &report.saturated {
        Some(saturated) => print_loop(out, "every other processor busy", saturated),
        None => writeln!(out, "every other processor busy: there is no other processor"),
    }?;
    writeln!(out, "parts of an answer")?;
    let parts = &report.parts;
    print_times(out, "policy", &parts.policy)?;
    print_times(out, "ik, middle", &parts.ik_from_middle)?;
    print_times(out, "ik, on a line", &parts.ik_along_line)?;
    print_times(out, "whole plan", &parts.plan)?;
    print_times(out, ".. unsurveyed", &parts.plan_unsurveyed)
}

fn print_loop(out: &mut dyn Write, load: &str, report: &LoopReport) -> io::Result<()> {
    writeln!(
        out,
        "{load}: {} cycles, {} missed, {}",
        report.turn.count, report.missed, report.cost
    )?;
    print_times(out, "wake-up late", &report.wake)?;
    if let (Some(other), Some(ratio)) = (&report.cyclictest, report.wake_p99_ratio) {
        print_times(out, "cyclictest", other)?;
        writeln!(out, "  {:<17}{ratio:.2} times cyclictest's p99", "ratio")?;
    }
    print_times(out, "plan ahead, cold", &report.plan_ahead)?;
    print_times(out, "turn begins late", &report.start)?;
    print_times(out, "period jitter", &report.jitter)?;
    print_times(out, "turn", &report.turn)?;
    print_times(out, "with a goal", &report.answer)?;
    print_times(out, "goal to target", &report.goal_to_first_target)?;
    writeln!(
        out,
        "  {:<17}{} goals, {} of them waited longer than a period",
        "", report.goal_to_first_target.count, report.goals_beyond_period
    )
}

fn print_times(out: &mut dyn Write, name: &str, times: &Percentiles) -> io::Result<()> {
    writeln!(out, "  {name:<17}{times}")
}

fn replay(file: &Path, as_json: bool) -> Result<()> {
    let name = file.display();
    let opened = File::open(file).map_err(|error| {
        anyhow!("cannot open {name}: {error}; give a file that `controller --record` wrote")
    });
    let mut input = BufReader::new(opened?);
    let head = recorder::read_head(&mut input)
        .map_err(|error| {
            let problem = match error.kind() {
                io::ErrorKind::UnexpectedEof => "it ends before its first cycle".into(),
                _ => error.to_string(),
            };
            anyhow!("cannot read {name}: {problem}; give a file that `controller --record` wrote")
        })?
        .with_context(|| {
            format!("{name} is not a recording: give a file that --record of this version wrote")
        })?;
    let policy = policy_file::checked(file, head.policy)?;
    rt::flush_denormals();
    let header = head.header;
    let controller = Controller::new(Setup {
        blob: policy.blob,
        cycle_ns: header.cycle_ns,
        cycles_per_target: header.cycles_per_target,
        silent_cycles_max: header.silent_cycles_max,
        gripper_lead_ns: header.gripper_lead_ns,
        degraded: header.degraded,
    });
    let found = recorder::replay(&mut input, controller).with_context(|| format!("cannot read {name}"))?;
    program::answer(as_json, &found, |out| {
        let end = if found.truncated {
            ", the file ends within a record"
        } else {
            ""
        };
        writeln!(out, "{} cycles, {} targets{end}", found.cycles, found.targets)
    })?;
    if let Some(cycle) = found.first_difference {
        bail!("cycle {cycle} differs from the recording");
    }
    if let Some(cycle) = found.damaged_after {
        bail!("{name} is damaged after cycle {cycle}: give a whole copy of it; all before agrees");
    }
    if let Some(cycle) = found.gap_after {
        bail!(
            "the disk was too slow for the recorder: what follows cycle {cycle} cannot be replayed, all before agrees"
        );
    }
    Ok(())
}
