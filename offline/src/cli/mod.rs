//! Command line of `offline`.

mod bench_diagnosis;
mod demos;
mod import;
mod numbers;
mod output;
mod place;
mod progress;
mod reproduce;
mod runs;
mod simulate;
mod told;
mod verify;

use clap::error::ErrorKind;
use clap::{Args, Parser, Subcommand};
use numbers::{count, seed, threads};
use offline::pipeline::{Preset, Stage};
use output::note;
use shared::one_line::OneLine;
use std::fmt::Display;
use std::path::PathBuf;
use std::process::ExitCode;

/// Wrong use that clap has no words for, such as an end before its beginning: exit code 2.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct WrongUse(String);

/// From one measured demonstration of a rope to a frozen policy.
#[derive(Parser)]
#[command(
    name = "offline",
    version,
    about,
    after_help = "Example: offline run --demo my-rope/lift-1 --held-out my-rope/lift-2 --out runs/my-rope"
)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
    /// Print the result as JSON on standard output.
    #[arg(long, global = true)]
    json: bool,
}

#[derive(Subcommand)]
enum Command {
    /// Everything, in order: fit, missing effects, rollouts, policy, blob, report.
    #[command(
        after_help = "Example: offline run --demo my-rope/lift-1 --held-out my-rope/lift-2 --out runs/my-rope"
    )]
    Run(RunArguments),
    /// Fit the rope's elasticity and nothing else: seconds, and no word on what its model lacks.
    #[command(after_help = "Example: offline fit --demo my-rope/lift-1 --out runs/my-rope")]
    Fit(RunArguments),
    /// Fit the rope and find what its model lacks; like `run`, but stops after the diagnosis.
    #[command(
        after_help = "Example: offline diagnose --demo my-rope/lift-1 --held-out my-rope/lift-2 --out runs/my-rope"
    )]
    Diagnose(RunArguments),
    /// Like `run`, but stops once the random rollouts are collected.
    #[command(
        after_help = "Example: offline collect --demo my-rope/lift-1 --held-out my-rope/lift-2 --out runs/my-rope"
    )]
    Collect(RunArguments),
    /// Like `run`, but stops once rollouts are collected and the policy is trained and evaluated.
    #[command(
        after_help = "Example: offline train --demo my-rope/lift-1 --held-out my-rope/lift-2 --out runs/my-rope"
    )]
    Train(RunArguments),
    /// Like `run`, but stops once the policy is evaluated.
    #[command(
        after_help = "Example: offline evaluate --demo my-rope/lift-1 --held-out my-rope/lift-2 --out runs/my-rope"
    )]
    Evaluate(RunArguments),
    /// Like `run`, but stops once the blob is written and read back.
    #[command(
        after_help = "Example: offline freeze --demo my-rope/lift-1 --held-out my-rope/lift-2 --out runs/my-rope"
    )]
    Freeze(RunArguments),
    /// Move a simulated rope as a measured one was moved, or let it swing, and say what it does.
    #[command(after_help = simulate::after_help())]
    Simulate(simulate::SimulateArguments),
    /// Verify the simulator against what is known exactly; exit code 1 when a case fails.
    #[command(after_help = "Example: offline verify --random 1000 --out runs/verify")]
    Verify(VerifyArguments),
    /// Diagnose ropes whose missing cause is known, and count how often the answer is right.
    #[command(
        after_help = "Example: offline bench-diagnosis --quick --seeds 2 --threads 1 --out runs/bench-diagnosis\n\n\
        The independent rod (G3) is no part of this program: cargo run --release -p tests --bin twin-truths -- \
        --quick --seeds 2 --out runs/bench-diagnosis writes what it does into the same folder first."
    )]
    BenchDiagnosis(BenchDiagnosisArguments),
    /// Work with demonstration folders.
    #[command(
        subcommand,
        after_help = "Example: offline demo check offline/demos/sample-rope/fit"
    )]
    Demo(DemoCommand),
    /// Make the paper's tables.
    #[command(
        subcommand,
        after_help = "Example: offline reproduce sim2sim --preset quick --out runs/sim2sim"
    )]
    Reproduce(reproduce::Reproduce),
    /// Show what is in a policy blob or a run.
    #[command(after_help = "Example: offline inspect runs/sample-rope/policy.blob")]
    Inspect {
        /// A policy blob, or the folder of a run.
        path: PathBuf,
    },
}

#[derive(Subcommand)]
enum DemoCommand {
    /// Check demonstration folders and say what is in them.
    #[command(after_help = "Example: offline demo check offline/demos/sample-rope/fit")]
    Check {
        /// Folders.
        #[arg(required = true)]
        folders: Vec<PathBuf>,
    },
    /// Draw a demonstration as an SVG file.
    #[command(after_help = "Example: offline demo show offline/demos/sample-rope/fit --out demo.svg")]
    Show {
        /// Folder.
        folder: PathBuf,
        /// File to write; the folder's name with `.svg` in the current folder by default.
        #[arg(long)]
        out: Option<PathBuf>,
    },
    /// Take a part of a recording in time.
    #[command(after_help = "Example: offline demo cut my-rope/long --to 6 --out my-rope/part")]
    Cut(demos::CutArguments),
    /// Turn recordings of other formats into demonstration folders.
    #[command(
        subcommand,
        after_help = "Example: offline demo import pac-cables data/pac_cables --out demos/pac"
    )]
    Import(import::ImportCommand),
    /// Write a demonstration in another format.
    #[command(
        subcommand,
        after_help = "Example: offline demo export mcap offline/demos/sample-rope/fit fit.mcap"
    )]
    Export(import::ExportCommand),
}

/// What a run works on.
#[derive(Args)]
struct RunArguments {
    /// Demonstrations to fit; the shipped sample rope by default.
    #[arg(long, num_args = 1.., value_name = "DIR")]
    demo: Vec<PathBuf>,
    /// Demonstrations of the same rope that only judge.
    #[arg(long, num_args = 1.., value_name = "DIR", requires = "demo")]
    held_out: Vec<PathBuf>,
    /// How much to do.
    #[arg(long, value_enum, default_value = "quick")]
    preset: Preset,
    /// Also find 95 % intervals by profile likelihood: up to sixteen fits for every parameter. A standard error is the
    /// same on both sides; a rope may answer less to more of something than to less of it. What a fit took to the end of
    /// its range gets one unasked.
    #[arg(long)]
    profile: bool,
    /// Folder of the run; `runs/<name>` by default.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Name of the rope; that of the first demonstration's parent folder by default.
    #[arg(long)]
    name: Option<String>,
    /// Seed of everything random.
    #[arg(long, default_value_t = 1, value_parser = seed(), allow_negative_numbers = true)]
    seed: u64,
    /// Threads; all cores by default.
    #[arg(long, value_parser = threads(), allow_negative_numbers = true)]
    threads: Option<usize>,
    /// Other identified ropes that the blob shall hold beside this one, as goals name them 1, 2 and so on: runs that have
    /// fitted them, or their model.toml. The policy learns this rope; how far it misses with the others is said.
    #[arg(long, num_args = 1.., value_name = "RUN")]
    also: Vec<PathBuf>,
    #[command(flatten)]
    place: place::Place,
}

/// What is verified.
#[derive(Args)]
struct VerifyArguments {
    /// One grid only: seconds instead of minutes.
    #[arg(long)]
    quick: bool,
    /// Run this number of random scenes as well.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = count::<usize>(0..=1_000_000), allow_negative_numbers = true)]
    random: usize,
    /// Seed of the random scenes.
    #[arg(long, default_value_t = 1, value_parser = seed(), allow_negative_numbers = true)]
    seed: u64,
    /// Folder for verify.json, verify.txt and the plots.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

/// Which diagnoses are made and counted.
#[derive(Args)]
struct BenchDiagnosisArguments {
    /// Part of the matrix: one noise, two strengths; a diagnosis takes about half a minute on one core.
    #[arg(long)]
    quick: bool,
    /// Seeds per cell.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = count::<u64>(1..=1000),
        allow_negative_numbers = true)]
    seeds: u64,
    /// First seed. Quoted figures come from seeds 1 and up; 1001 and up are for work on the diagnosis.
    #[arg(long, value_name = "SEED", default_value_t = 1,
        value_parser = count::<u64>(0..=1_000_000_000), allow_negative_numbers = true)]
    first_seed: u64,
    /// Give every diagnosis one recording and nothing else, as by default: parts of it that are not fitted judge, not another.
    #[arg(long)]
    alone: bool,
    /// Have the rope seen as clouds of points by two depth cameras, not as labelled points along it.
    #[arg(long)]
    clouds: bool,
    /// Only cells whose name contains one of these; a whole name is that cell alone.
    #[arg(long, num_args = 1.., value_name = "TEXT")]
    only: Vec<String>,
    /// Print the cells' names and stop.
    #[arg(long)]
    list: bool,
    /// Count the answers that are there; diagnose nothing.
    #[arg(long)]
    count: bool,
    /// Folder of truths, answers and tables; a stopped run goes on there.
    #[arg(long, value_name = "DIR", default_value = "runs/bench-diagnosis")]
    out: PathBuf,
    /// Threads; all cores by default. With one, the time of a cell is that of one core.
    #[arg(long, value_parser = threads(), allow_negative_numbers = true)]
    threads: Option<usize>,
}

/// Exit code of wrong use, as clap has it.
const WRONG_USE: u8 = 2;

/// Exit code after Ctrl-C, as shells count it.
const STOPPED: u8 = 130;

/// The command line, or what wrong use of it ends with: one line and an exit code. A question for help is answered here.
pub fn arguments() -> Result<Arguments, ExitCode> {
    Arguments::try_parse().map_err(|error| {
        if !error.use_stderr() || error.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand {
            error.exit();
        }
        let words = error.to_string();
        note_line(words.strip_prefix("error: ").unwrap_or(&words));
        ExitCode::from(WRONG_USE)
    })
}

/// Runs a command and turns its result into an exit code: 0 done, 1 failed, 2 wrong use, which mostly
/// clap itself answers, 130 stopped.
pub fn run(arguments: Arguments) -> ExitCode {
    let json = arguments.json;
    let result = match arguments.command {
        Command::Run(a) => runs::run(&a, Stage::Report, json),
        Command::Fit(a) => runs::run(&a, Stage::Fit, json),
        Command::Diagnose(a) => runs::run(&a, Stage::Diagnose, json),
        Command::Collect(a) => runs::run(&a, Stage::Collect, json),
        Command::Train(a) => runs::run(&a, Stage::Train, json),
        Command::Evaluate(a) => runs::run(&a, Stage::Evaluate, json),
        Command::Freeze(a) => runs::run(&a, Stage::Freeze, json),
        Command::Simulate(a) => simulate::run(&a, json),
        Command::Verify(a) => verify::run(&a, json),
        Command::BenchDiagnosis(a) => bench_diagnosis::run(&a, json),
        Command::Demo(DemoCommand::Check { folders }) => demos::check(&folders, json),
        Command::Demo(DemoCommand::Show { folder, out }) => demos::show(&folder, out, json),
        Command::Demo(DemoCommand::Cut(a)) => demos::cut(&a, json),
        Command::Demo(DemoCommand::Export(target)) => import::export(target, json),
        Command::Demo(DemoCommand::Import(source)) => import::import(source, json),
        Command::Reproduce(table) => reproduce::run(&table, json),
        Command::Inspect { path } => demos::inspect(&path, json),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if is_stop(&error) => {
            note_line(error);
            ExitCode::from(STOPPED)
        }
        Err(error) if error.is::<WrongUse>() => {
            note_line(error);
            ExitCode::from(WRONG_USE)
        }
        Err(error) => {
            note_line(format_args!("{error:#}"));
            ExitCode::FAILURE
        }
    }
}

/// One line that says what went wrong.
fn note_line(words: impl Display) {
    note(format_args!("offline: {}", OneLine(words)));
}

fn is_stop(error: &anyhow::Error) -> bool {
    let training = error.downcast_ref::<offline::train::TrainError>();
    matches!(training, Some(offline::train::TrainError::Stopped))
        || error
            .chain()
            .any(|cause| cause.to_string() == offline::collect::Stopped.to_string())
}
