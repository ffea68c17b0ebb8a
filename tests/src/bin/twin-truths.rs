//! Plays the benchmark of the diagnosis on the independent rod, for `offline bench-diagnosis` to read.

use clap::Parser;
use offline::bench_diagnosis::cells::Extent;
use offline::bench_diagnosis::play;
use std::path::PathBuf;
use tests::reality::Rod;

/// Plays the benchmark of the diagnosis on the independent rod (G3).
///
/// Example: cargo run --release -p tests --bin twin-truths -- --quick --seeds 2 --out runs/bench-diagnosis
#[derive(Parser)]
struct Arguments {
    /// Part of the matrix.
    #[arg(long)]
    quick: bool,
    /// Seeds per cell.
    #[arg(long, default_value_t = 1)]
    seeds: u64,
    /// First seed.
    #[arg(long, default_value_t = 1)]
    first_seed: u64,
    /// Play what is asked where the rope is seen as clouds of points.
    #[arg(long)]
    clouds: bool,
    /// Only what cells need whose name contains one of these; a whole name is that cell alone.
    #[arg(long, num_args = 1.., value_name = "TEXT")]
    only: Vec<String>,
    /// Folder of the benchmark.
    #[arg(long, default_value = "runs/bench-diagnosis")]
    out: PathBuf,
}

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    let extent = Extent {
        quick: arguments.quick,
        seeds: arguments.seeds,
        first_seed: arguments.first_seed,
        // The truth is the same.
        alone: false,
        clouds: arguments.clouds,
    };
    play(&Rod, &extent, &arguments.only, &arguments.out, &|line| {
        println!("{line}")
    })
}
