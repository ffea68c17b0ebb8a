//! `offline demo …` and `offline inspect`.

use super::numbers::finite;
use super::output::print;
use super::{WrongUse, note_line};
use anyhow::Context;
use clap::{Args, ValueEnum};
use offline::demo::{
    Demo, StartState, plot_svg, refuse_to_replace, refuse_to_replace_file, summary, warnings,
};
use offline::inspect::{inspect as inspect_blob, stale};
use offline::model_file::ModelFile;
use offline::run_files::{RunFolder, write_whole};
use std::path::{Path, PathBuf};

/// Checks folders and prints what is in them.
///
/// # Errors
/// One cannot be read or simulated; the others have been printed all the same.
pub fn check(folders: &[PathBuf], json: bool) -> anyhow::Result<()> {
    let failed = folders.iter().filter_map(|folder| check_one(folder, json).err());
    let mut failed: Vec<anyhow::Error> = failed.collect();
    let Some(last) = failed.pop() else {
        return Ok(());
    };
    for error in &failed {
        note_line(format_args!("{error:#}"));
    }
    Err(last)
}

fn check_one(folder: &Path, json: bool) -> anyhow::Result<()> {
    let demo = Demo::load(folder)?;
    if json {
        print(serde_json::json!({
            "folder": folder.display().to_string(), "scene": demo.spec.scene, "rope": demo.spec.rope,
            "frames": demo.times_s().len(), "warnings": warnings(&demo),
        }))?;
    } else {
        print(summary(&demo))?;
    }
    demo.for_a_simulation(folder)?;
    Ok(())
}

/// Which part of a recording.
#[derive(Args)]
pub struct CutArguments {
    /// Demonstration folder.
    folder: PathBuf,
    /// First instant, s; the beginning by default.
    #[arg(long, value_name = "S", value_parser = finite, allow_negative_numbers = true)]
    from: Option<f64>,
    /// Last instant, s; the end by default.
    #[arg(long, value_name = "S", value_parser = finite, allow_negative_numbers = true)]
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
    if from_s > to_s {
        return Err(WrongUse(format!(
            "--from {from_s} is after --to {to_s}: give the earlier instant first"
        ))
        .into());
    }
    refuse_to_replace(&arguments.out)?;
    let part = Demo::load(&arguments.folder)?.cut(from_s, to_s, start)?;
    write(&part, &arguments.out, json)
}

/// Writes a demonstration and says what is in it.
pub fn write(demo: &Demo, folder: &Path, json: bool) -> anyhow::Result<()> {
    refuse_to_replace(folder)?;
    demo.save(folder)?;
    let found = warnings(demo);
    if json {
        let line = serde_json::json!({
            "folder": folder.display().to_string(), "frames": demo.times_s().len(), "warnings": found,
        });
        return print(line);
    }
    print(format_args!(
        "wrote {}: {} frames",
        folder.display(),
        demo.times_s().len()
    ))?;
    for warning in found {
        print(format_args!("  warning: {warning}"))?;
    }
    Ok(())
}

/// Draws a demonstration.
pub fn show(folder: &Path, out: Option<PathBuf>, json: bool) -> anyhow::Result<()> {
    let demo = Demo::load(folder)?;
    let out = out.unwrap_or_else(|| PathBuf::from(format!("{}.svg", demo.name)));
    refuse_to_replace_file(&out, Some("svg"))?;
    write_whole(&out, plot_svg(&demo).as_bytes())?;
    if json {
        print(serde_json::json!({ "written": out.display().to_string() }))
    } else {
        print(format_args!("wrote {}", out.display()))
    }
}

/// Shows a blob, or the model and blob of a run.
pub fn inspect(path: &Path, json: bool) -> anyhow::Result<()> {
    anyhow::ensure!(
        path.exists(),
        "{} does not exist: name a policy blob or a run",
        path.display()
    );
    let run = path.is_dir().then(|| RunFolder::there(path));
    let blob_path = run.as_ref().map_or_else(|| path.to_path_buf(), RunFolder::blob);
    let model = run.as_ref().map(|r| ModelFile::load(&r.model())).transpose()?;
    let blob = (run.is_none() || blob_path.exists())
        .then(|| inspect_blob(&blob_path))
        .transpose()?;
    let warning = run.as_ref().and_then(stale);
    if json {
        let all = serde_json::json!({ "model": model, "blob": blob, "warning": warning });
        return print(serde_json::to_string_pretty(&all)?);
    }
    if let Some(model) = model {
        print(toml::to_string_pretty(&model).context("a model can be written")?)?;
    }
    match blob {
        Some(blob) => print(blob)?,
        None => print("no policy.blob yet: run `offline run` with the same --out")?,
    }
    warning.map_or(Ok(()), |warning| print(format_args!("warning: {warning}")))
}
