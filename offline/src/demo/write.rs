//! Writes a demonstration as a folder: whole or not at all.

use super::read::{clamp_of, name_of};
use super::{ClampSample, CloudFrame, Demo, DemoError, MarkerSample, Observations};
use super::{check, points};
use std::fmt::Write as _;
use std::io::ErrorKind;
use std::path::Path;

impl Demo {
    /// Writes the demonstration as the folder `dir`, replacing a demonstration that is there and refusing
    /// to replace anything else.
    ///
    /// The clouds' points are rounded to single precision. The files are written beside `dir` and
    /// moved there at the end, so a reader never meets half of a demonstration.
    ///
    /// # Errors
    /// A value is none of a demonstration, something else is there, or a file cannot be written.
    pub fn save(&self, dir: impl AsRef<Path>) -> Result<(), DemoError> {
        let dir = dir.as_ref();
        check::demo(dir, self, "")?;
        refuse_anything_else(dir)?;
        let parent = match dir.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        std::fs::create_dir_all(parent).map_err(|e| DemoError::unwritten(parent, "creating", &e))?;
        let beside = tempfile::Builder::new()
            .prefix(&format!(".{}-", name_of(dir)))
            .tempdir_in(parent)
            .map_err(|e| DemoError::unwritten(parent, "creating a folder in", &e))?;
        let fresh = beside.path().join("new");
        std::fs::create_dir(&fresh).map_err(|e| DemoError::unwritten(&fresh, "creating", &e))?;
        self.write_files(&fresh)?;
        let old = beside.path().join("old");
        let replaces = dir.exists();
        if replaces {
            std::fs::rename(dir, &old).map_err(|e| DemoError::unwritten(dir, "moving away", &e))?;
        }
        std::fs::rename(&fresh, dir).map_err(|e| {
            if replaces && std::fs::rename(&old, dir).is_err() {
                // It would go with the folder that holds it.
                let _ = beside.keep();
            }
            DemoError::unwritten(dir, "moving into place", &e)
        })
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

/// Refuses a folder that holds a demonstration: a mistyped path must not cost a user a measurement.
///
/// # Errors
/// One is there, or something else.
pub fn refuse_to_replace(dir: &Path) -> Result<(), DemoError> {
    refuse_anything_else(dir)?;
    if dir.join("demo.toml").exists() {
        return Err(DemoError::new(
            dir,
            "a demonstration is there, and it would be replaced",
            "choose another folder, or remove it first",
        ));
    }
    Ok(())
}

/// Refuses a file that is there, unless its name ends in `drawn`, an extension of what can be made again: a mistyped path
/// must not cost a user a measurement.
///
/// # Errors
/// It is there.
pub fn refuse_to_replace_file(file: &Path, drawn: Option<&str>) -> Result<(), DemoError> {
    let made_again = drawn.is_some_and(|drawn| file.extension().is_some_and(|own| own == drawn));
    if file.is_file() && !made_again {
        return Err(DemoError::new(
            file,
            "a file is there, and it would be replaced",
            "choose another name, or remove it first",
        ));
    }
    Ok(())
}

/// Refuses a folder that no demonstration may be written as: it is there, and neither empty nor a demonstration.
fn refuse_anything_else(dir: &Path) -> Result<(), DemoError> {
    match std::fs::metadata(dir) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(DemoError::unwritten(dir, "looking it up", &error)),
        Ok(found) if !found.is_dir() => {
            return Err(DemoError::new(
                dir,
                "this is no folder",
                "choose a folder that is not there yet, or that holds a demonstration",
            ));
        }
        Ok(_) => {}
    }
    let names = names_in(dir)?;
    if names.is_empty() {
        return Ok(());
    }
    if !names.iter().any(|name| name == "demo.toml") {
        return Err(DemoError::new(
            dir,
            "the folder holds something other than a demonstration",
            "choose another folder or empty this one",
        ));
    }
    for name in names {
        let file = dir.join(&name);
        if name == "clouds" && file.is_dir() {
            for cloud in names_in(&file)? {
                refuse_unless(is_cloud(&cloud), &file.join(cloud))?;
            }
        } else {
            refuse_unless(is_of_the_format(&name), &file)?;
        }
    }
    Ok(())
}

/// Names of what is in a folder, sorted, so that the same one is named every time.
fn names_in(dir: &Path) -> Result<Vec<String>, DemoError> {
    let fail = |e| DemoError::io(dir, "listing", &e);
    let mut names = Vec::new();
    for entry in std::fs::read_dir(dir).map_err(fail)? {
        names.push(entry.map_err(fail)?.file_name().to_string_lossy().into_owned());
    }
    names.sort();
    Ok(names)
}

/// Whether a demonstration's folder may hold a file of this name.
fn is_of_the_format(name: &str) -> bool {
    let clamp = clamp_of(name).is_some_and(|index| index.parse::<usize>().is_ok());
    clamp || ["demo.toml", "clouds.csv", "markers.csv"].contains(&name)
}

fn is_cloud(name: &str) -> bool {
    let ending = Path::new(name).extension();
    ending.is_some_and(|ending| ending.eq_ignore_ascii_case("ply") || ending.eq_ignore_ascii_case("pcd"))
}

/// Replacing the folder would delete `file`; a folder is no file of the format, whatever its name is.
fn refuse_unless(known: bool, file: &Path) -> Result<(), DemoError> {
    if known && !file.is_dir() {
        return Ok(());
    }
    Err(DemoError::new(
        file,
        "this is no part of the demonstration that would be replaced",
        "move it away, or choose another folder",
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
    std::fs::create_dir(&folder).map_err(|e| DemoError::unwritten(&folder, "creating", &e))?;
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
    std::fs::write(file, text).map_err(|e| DemoError::unwritten(file, "writing", &e))
}
