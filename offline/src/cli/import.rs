//! `offline demo import …`: recordings into demonstration folders.

use clap::{Args, Subcommand};
use offline::demo::{self, Demo, warnings};
use std::path::PathBuf;

/// Where a recording comes from.
#[derive(Subcommand)]
pub enum ImportCommand {
    /// Swings that the controller recorded with `--record`.
    #[command(after_help = "Example: offline demo import recording run.rec --seen cameras/ --out demos/")]
    Recording(Recorded),
}

/// A recording of the controller.
#[derive(Args)]
pub struct Recorded {
    /// The recording.
    file: PathBuf,
    /// What cameras saw meanwhile: a folder with `clouds.csv` or `markers.csv`, in the frame of the task,
    /// times in s of this machine's CLOCK_MONOTONIC. Without it only the gripped end is seen.
    #[arg(long, value_name = "DIR")]
    seen: Option<PathBuf>,
    /// Folder under which one demonstration folder per swing is written.
    #[arg(long, value_name = "DIR", default_value = ".")]
    out: PathBuf,
}

/// Imports, writes the folders and says what is in them.
pub fn import(source: ImportCommand, json: bool) -> anyhow::Result<()> {
    let (demos, out) = match source {
        ImportCommand::Recording(a) => (demo::recording(&a.file, a.seen.as_deref())?, a.out),
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
