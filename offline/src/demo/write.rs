//! Writes a demonstration as a folder: whole or not at all.

use super::read::name_of;
use super::{ClampSample, CloudFrame, Demo, DemoError, MarkerSample, Observations};
use super::{check, points};
use std::fmt::Write as _;
use std::path::Path;

impl Demo {
    /// Writes the demonstration as the folder `dir`, replacing a demonstration that is there.
    ///
    /// The clouds' points are rounded to single precision. The files are written beside `dir` and
    /// moved there at the end, so a reader never meets half of a demonstration.
    pub fn save(&self, dir: impl AsRef<Path>) -> Result<(), DemoError> {
        let dir = dir.as_ref();
        check::demo(dir, self, "")?;
        refuse_other_folders(dir)?;
        let parent = match dir.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        std::fs::create_dir_all(parent).map_err(|e| DemoError::io(parent, "creating", &e))?;
        let beside = tempfile::Builder::new()
            .prefix(&format!(".{}-", name_of(dir)))
            .tempdir_in(parent)
            .map_err(|e| DemoError::io(parent, "creating a folder in", &e))?;
        let fresh = beside.path().join("new");
        std::fs::create_dir(&fresh).map_err(|e| DemoError::io(&fresh, "creating", &e))?;
        self.write_files(&fresh)?;
        if dir.exists() {
            let old = beside.path().join("old");
            std::fs::rename(dir, old).map_err(|e| DemoError::io(dir, "moving away", &e))?;
        }
        std::fs::rename(&fresh, dir).map_err(|e| DemoError::io(dir, "moving into place", &e))
    }

    fn write_files(&self, dir: &Path) -> Result<(), DemoError> {
        let file = dir.join("demo.toml");
        let text = toml::to_string(&self.spec)
            .map_err(|e| DemoError::new(&file, e.to_string(), "check the declared values"))?;
        write_text(&file, &text)?;
        for (index, path) in self.clamps.iter().enumerate() {
            write_text(&dir.join(format!("clamp_{index}.csv")), &clamp_table(path))?;
        }
        for (index, path) in self.commanded.iter().enumerate() {
            if let Some(path) = path {
                write_text(
                    &dir.join(format!("clamp_{index}_commanded.csv")),
                    &clamp_table(path),
                )?;
            }
        }
        match &self.observations {
            Observations::Clouds(frames) => write_clouds(dir, frames),
            Observations::Markers(samples) => write_text(&dir.join("markers.csv"), &marker_table(samples)),
        }
    }
}

/// A mistyped path must not cost a user a folder of something else.
fn refuse_other_folders(dir: &Path) -> Result<(), DemoError> {
    let Ok(mut entries) = std::fs::read_dir(dir) else {
        return Ok(());
    };
    if entries.next().is_none() || dir.join("demo.toml").exists() {
        return Ok(());
    }
    Err(DemoError::new(
        dir,
        "the folder holds something other than a demonstration",
        "choose another folder or empty this one",
    ))
}

fn clamp_table(path: &[ClampSample]) -> String {
    let turns = path
        .iter()
        .any(|sample| sample.quaternion_xyzw != [0.0, 0.0, 0.0, 1.0]);
    let mut text = String::from("t_s,x_m,y_m,z_m,");
    text.push_str(if turns { "qx,qy,qz,qw,closed\n" } else { "closed\n" });
    for sample in path {
        let [x, y, z] = sample.position_m;
        let _ = write!(text, "{},{x},{y},{z},", sample.t_s);
        if turns {
            let [qx, qy, qz, qw] = sample.quaternion_xyzw;
            let _ = write!(text, "{qx},{qy},{qz},{qw},");
        }
        let _ = writeln!(text, "{}", u8::from(sample.closed));
    }
    text
}

fn marker_table(samples: &[MarkerSample]) -> String {
    let mut text = String::from("t_s,marker,s_m,x_m,y_m,z_m\n");
    for sample in samples {
        let [x, y, z] = sample.position_m;
        let _ = writeln!(
            text,
            "{},{},{},{x},{y},{z}",
            sample.t_s, sample.marker, sample.s_m
        );
    }
    text
}

fn write_clouds(dir: &Path, frames: &[CloudFrame]) -> Result<(), DemoError> {
    let folder = dir.join("clouds");
    std::fs::create_dir(&folder).map_err(|e| DemoError::io(&folder, "creating", &e))?;
    let mut table = String::from("t_s,file\n");
    for (index, frame) in frames.iter().enumerate() {
        let name = format!("clouds/{index:04}.ply");
        let file = dir.join(&name);
        points::check(&file, &frame.points_m)?;
        points::write(&file, &frame.points_m)?;
        let _ = writeln!(table, "{},{name}", frame.t_s);
    }
    write_text(&dir.join("clouds.csv"), &table)
}

fn write_text(file: &Path, text: &str) -> Result<(), DemoError> {
    std::fs::write(file, text).map_err(|e| DemoError::io(file, "writing", &e))
}
