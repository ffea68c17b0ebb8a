//! `offline demo …` and `offline inspect`.

use anyhow::Context;
use clap::{Args, ValueEnum};
use offline::demo::{Demo, StartState, plot_svg, summary, warnings};
use offline::inspect::{inspect as inspect_blob, stale};
use offline::model_file::ModelFile;
use offline::run_files::{RunFolder, write_whole};
use std::path::{Path, PathBuf};

/// Checks folders and prints what is in them.
pub fn check(folders: &[PathBuf], json: bool) -> anyhow::Result<()> {
    for folder in folders {
        let demo = Demo::load(folder)?;
        if json {
            println!(
                "{}",
                serde_json::json!({
                    "folder": folder, "scene": demo.spec.scene, "rope": demo.spec.rope,
                    "frames": demo.times_s().len(), "warnings": warnings(&demo),
                })
            );
        } else {
            println!("{}", summary(&demo));
        }
    }
    Ok(())
}

/// Which part of a recording.
#[derive(Args)]
pub struct CutArguments {
    /// Demonstration folder.
    folder: PathBuf,
    /// First instant, s; the beginning by default.
    #[arg(long, value_name = "S")]
    from: Option<f64>,
    /// Last instant, s; the end by default.
    #[arg(long, value_name = "S")]
    to: Option<f64>,
    /// What the rope does at the first instant, where that is not the recording's.
    #[arg(long, value_enum, default_value = "moving")]
    start: PartStart,
    /// Demonstration folder to write.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// What the rope does where a part begins.
#[derive(Clone, Copy, ValueEnum)]
enum PartStart {
    /// It moves: shape and velocity are those of the first markers.
    Moving,
    /// It hangs still from its clamps.
    Rest,
}

/// Writes a part of a demonstration.
pub fn cut(arguments: &CutArguments, json: bool) -> anyhow::Result<()> {
    let start = match arguments.start {
        PartStart::Moving => StartState::Moving,
        PartStart::Rest => StartState::Rest,
    };
    let from_s = arguments.from.unwrap_or(f64::NEG_INFINITY);
    let to_s = arguments.to.unwrap_or(f64::INFINITY);
    let part = Demo::load(&arguments.folder)?.cut(from_s, to_s, start)?;
    write(&part, &arguments.out, json)
}

/// Writes a demonstration and says what is in it.
pub fn write(demo: &Demo, folder: &Path, json: bool) -> anyhow::Result<()> {
    demo.save(folder)?;
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

/// Draws a demonstration.
pub fn show(folder: &Path, out: Option<PathBuf>, json: bool) -> anyhow::Result<()> {
    let demo = Demo::load(folder)?;
    let out = out.unwrap_or_else(|| PathBuf::from(format!("{}.svg", demo.name)));
    write_whole(&out, plot_svg(&demo).as_bytes())?;
    if json {
        println!("{}", serde_json::json!({ "written": out }));
    } else {
        println!("wrote {}", out.display());
    }
    Ok(())
}

/// Shows a blob, or the model and blob of a run.
pub fn inspect(path: &Path, json: bool) -> anyhow::Result<()> {
    anyhow::ensure!(
        path.exists(),
        "{} does not exist: name a policy blob or a run",
        path.display()
    );
    let run = path.is_dir().then(|| RunFolder::open(path)).transpose()?;
    let blob_path = run.as_ref().map_or_else(|| path.to_path_buf(), RunFolder::blob);
    let model = run.as_ref().map(|r| ModelFile::load(&r.model())).transpose()?;
    let blob = (run.is_none() || blob_path.exists())
        .then(|| inspect_blob(&blob_path))
        .transpose()?;
    let warning = run.as_ref().and_then(stale);
    if json {
        println!(
            "{}",
            serde_json::to_string_pretty(
                &serde_json::json!({ "model": model, "blob": blob, "warning": warning })
            )?
        );
        return Ok(());
    }
    if let Some(model) = model {
        println!(
            "{}",
            toml::to_string_pretty(&model).context("a model can be written")?
        );
    }
    match blob {
        Some(blob) => println!("{blob}"),
        None => println!("no policy.blob yet: run `offline run` with the same --out"),
    }
    if let Some(warning) = warning {
        println!("warning: {warning}");
    }
    Ok(())
}
