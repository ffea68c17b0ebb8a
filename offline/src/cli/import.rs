//! `offline demo import …`: recordings of others into demonstration folders.

use clap::{Args, Subcommand};
use offline::demo::{Demo, import, warnings};
use std::path::PathBuf;

/// Where a recording comes from.
#[derive(Subcommand)]
pub enum ImportCommand {
    /// Cables held at one end: static poses, free and driven swings (PAC_model_matlab).
    #[command(after_help = "Example: offline demo import pac-cables data/pac_cables --out demos/pac")]
    PacCables(Folders),
    /// Ropes held at both ends, by motion capture (DEFORM).
    #[command(after_help = "Example: offline demo import deform data/deform --out demos/deform --rate-hz 25")]
    Deform(Thinned),
    /// A foam cylinder moved by an arm (PRB_Net).
    #[command(after_help = "Example: offline demo import noodle data/noodle --out demos/noodle --rate-hz 25")]
    Noodle(Thinned),
    /// Hanging loops of wire (adapteddlo_muj).
    #[command(after_help = "Example: offline demo import wires data/wires --out demos/wires")]
    Wires(Folders),
}

/// What to read and where to write.
#[derive(Args)]
pub struct Folders {
    /// Folder of the data set.
    dir: PathBuf,
    /// Folder under which one demonstration folder per recording is written.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// A data set with more frames than a fit needs.
#[derive(Args)]
pub struct Thinned {
    #[command(flatten)]
    folders: Folders,
    /// Observed frames per second to keep; clamp paths are kept whole.
    #[arg(long, default_value_t = 25.0, value_parser = rate)]
    rate_hz: f64,
}

fn rate(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(rate) if rate > 0.0 && rate.is_finite() => Ok(rate),
        _ => Err("give a rate above 0 in Hz".into()),
    }
}

/// Imports, writes the folders and says what is in them.
pub fn import(source: ImportCommand, json: bool) -> anyhow::Result<()> {
    let (demos, out) = match source {
        ImportCommand::PacCables(a) => (import::pac_cables(&a.dir)?, a.out),
        ImportCommand::Wires(a) => (import::wires(&a.dir)?, a.out),
        ImportCommand::Deform(a) => (import::deform(&a.folders.dir, a.rate_hz)?, a.folders.out),
        ImportCommand::Noodle(a) => (import::noodle(&a.folders.dir, a.rate_hz)?, a.folders.out),
    };
    for demo in &demos {
        write(demo, out.join(&demo.name), json)?;
    }
    Ok(())
}

fn write(demo: &Demo, folder: PathBuf, json: bool) -> anyhow::Result<()> {
    demo.save(&folder)?;
    let found = warnings(demo);
    if json {
        let line = serde_json::json!({
            "folder": folder, "frames": demo.times_s().len(), "warnings": found,
        });
        println!("{line}");
        return Ok(());
    }
    println!("wrote {}: {} frames", folder.display(), demo.times_s().len());
    for warning in found {
        println!("  warning: {warning}");
    }
    Ok(())
}
