//! `offline demo …` and `offline inspect`.

use anyhow::Context;
use offline::demo::{Demo, plot_svg, summary, warnings};
use offline::inspect::inspect as inspect_blob;
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
    if json {
        println!(
            "{}",
            serde_json::to_string_pretty(&serde_json::json!({ "model": model, "blob": blob }))?
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
    Ok(())
}
