//! Reads a demonstration from its folder; what comes back is checked.

use super::check::Declared;
use super::table::{Table, line_of_row};
use super::{ClampSample, CloudFrame, Demo, DemoError, DemoSpec, MarkerSample, Observations};
use super::{check, make_continuous, points};
use crate::toml_lines::line_at;
use std::collections::HashMap;
use std::io::ErrorKind;
use std::path::{Component, Path, PathBuf};

const POSE: [&str; 4] = ["qx", "qy", "qz", "qw"];

impl Demo {
    /// Reads and checks the demonstration in the folder `dir`.
    pub fn load(dir: impl AsRef<Path>) -> Result<Self, DemoError> {
        let dir = dir.as_ref();
        let file = dir.join("demo.toml");
        let text = std::fs::read_to_string(&file).map_err(|e| not_a_demo(&file, &e))?;
        let spec = spec_of(&file, &text)?;
        let mut clamps = Vec::new();
        let mut commanded = Vec::new();
        for index in 0..spec.clamps.len() {
            clamps.push(read_clamp(&dir.join(format!("clamp_{index}.csv")))?);
            let file = dir.join(format!("clamp_{index}_commanded.csv"));
            commanded.push(if file.exists() {
                Some(read_clamp(&file)?)
            } else {
                None
            });
        }
        refuse_undeclared_clamps(dir, spec.clamps.len())?;
        let observations = read_observations(dir)?;
        let demo = Self {
            name: name_of(dir),
            spec,
            clamps,
            commanded,
            observations,
        };
        check::demo(dir, &demo, &text)?;
        Ok(demo)
    }
}

impl DemoSpec {
    /// Reads and checks a file `demo.toml`.
    ///
    /// # Errors
    /// The file is missing or malformed.
    pub fn load(file: &Path) -> Result<Self, DemoError> {
        let text = std::fs::read_to_string(file).map_err(|e| DemoError::io(file, "reading", &e))?;
        spec_of(file, &text)
    }
}

/// The last component of the folder's path, also for a path such as `.`.
pub(super) fn name_of(dir: &Path) -> String {
    let whole = dir.canonicalize();
    let named = whole.as_deref().unwrap_or(dir).file_name();
    named.map_or_else(|| "demo".to_owned(), |name| name.to_string_lossy().into_owned())
}

/// Without a readable `demo.toml`, what was named is most likely another folder than the one that was meant.
fn not_a_demo(file: &Path, error: &std::io::Error) -> DemoError {
    match error.kind() {
        ErrorKind::NotADirectory => DemoError::new(
            file.parent().unwrap_or(file),
            "is a file, and a demo is a folder",
            "give the folder that holds it",
        ),
        ErrorKind::NotFound => DemoError::new(
            file,
            "there is no such file",
            "give the path of an existing demo folder, or add the file",
        ),
        _ => DemoError::io(file, "reading", error),
    }
}

fn spec_of(file: &Path, text: &str) -> Result<DemoSpec, DemoError> {
    // First, because another version's keys would be called mistakes in this one.
    let table = toml::from_str::<toml::Table>(text).unwrap_or_default();
    if let Some(format) = table.get("format").and_then(toml::Value::as_str) {
        check::format(&Declared { file, text }, format)?;
    }
    let spec: DemoSpec = toml::from_str(text).map_err(|e| {
        let error = DemoError::new(file, e.message(), "write it as the format's description says");
        match e.span() {
            Some(span) => error.at(line_at(text, span.start)),
            None => error,
        }
    })?;
    check::spec(&Declared { file, text }, &spec)?;
    Ok(spec)
}

fn read_clamp(file: &Path) -> Result<Vec<ClampSample>, DemoError> {
    let table = Table::read(file, &["t_s", "x_m", "y_m", "z_m", "closed"], &POSE)?;
    let turns = table.has(POSE[0]);
    let mut path = Vec::with_capacity(table.len());
    for row in 0..table.len() {
        let mut quaternion_xyzw = [0.0, 0.0, 0.0, 1.0];
        if turns {
            for (value, column) in quaternion_xyzw.iter_mut().zip(POSE) {
                *value = table.number(row, column)?;
            }
        }
        path.push(ClampSample {
            t_s: table.number(row, "t_s")?,
            position_m: position(&table, row)?,
            quaternion_xyzw,
            closed: table.flag(row, "closed")?,
        });
    }
    make_continuous(&mut path);
    Ok(path)
}

fn position(table: &Table, row: usize) -> Result<[f64; 3], DemoError> {
    Ok([
        table.number(row, "x_m")?,
        table.number(row, "y_m")?,
        table.number(row, "z_m")?,
    ])
}

fn refuse_undeclared_clamps(dir: &Path, declared: usize) -> Result<(), DemoError> {
    let entries = std::fs::read_dir(dir).map_err(|e| DemoError::io(dir, "listing", &e))?;
    for entry in entries {
        let entry = entry.map_err(|e| DemoError::io(dir, "listing", &e))?;
        let name = entry.file_name().to_string_lossy().into_owned();
        let Some(index) = clamp_of(&name) else {
            continue;
        };
        if !index.parse::<usize>().is_ok_and(|index| index < declared) {
            return Err(DemoError::new(
                &entry.path(),
                format!("demo.toml declares {declared} clamps, none with this file's index"),
                "declare it in [[clamps]] or remove the file",
            ));
        }
    }
    Ok(())
}

/// The files of a demonstration folder that has been read, relative to it, in the order of their names. What else lies
/// there is no part of it.
///
/// # Errors
/// The folder or `clouds.csv` has become unreadable.
pub fn files(dir: &Path) -> Result<Vec<PathBuf>, DemoError> {
    let failed = |e: std::io::Error| DemoError::io(dir, "listing", &e);
    let mut files = Vec::new();
    for entry in std::fs::read_dir(dir).map_err(failed)? {
        let name = entry.map_err(failed)?.file_name();
        let text = name.to_string_lossy();
        if ["demo.toml", "clouds.csv", "markers.csv"].contains(&&*text) || clamp_of(&text).is_some() {
            files.push(PathBuf::from(name));
        }
    }
    let clouds = dir.join("clouds.csv");
    if clouds.exists() {
        let table = Table::read(&clouds, &["t_s", "file"], &[])?;
        files.extend((0..table.len()).map(|row| PathBuf::from(table.text(row, "file"))));
    }
    files.sort();
    files.dedup();
    Ok(files)
}

/// The index in the name of a clamp's file: 0 of `clamp_0.csv` and of `clamp_0_commanded.csv`.
pub(super) fn clamp_of(name: &str) -> Option<&str> {
    let index = name.strip_prefix("clamp_")?.strip_suffix(".csv")?;
    Some(index.strip_suffix("_commanded").unwrap_or(index))
}

/// What was seen, from the one of `clouds.csv` and `markers.csv` that is in the folder.
pub(super) fn read_observations(dir: &Path) -> Result<Observations, DemoError> {
    let clouds = dir.join("clouds.csv");
    let markers = dir.join("markers.csv");
    match (clouds.exists(), markers.exists()) {
        (true, false) => Ok(Observations::Clouds(read_clouds(dir, &clouds)?)),
        (false, true) => Ok(Observations::Markers(read_markers(&markers)?)),
        (true, true) => Err(DemoError::new(
            dir,
            "there are both clouds.csv and markers.csv",
            "keep the one to fit to in this folder and the other in a second one",
        )),
        (false, false) => Err(DemoError::new(
            dir,
            "there is neither clouds.csv nor markers.csv",
            "add what the cameras saw",
        )),
    }
}

fn read_clouds(dir: &Path, file: &Path) -> Result<Vec<CloudFrame>, DemoError> {
    let table = Table::read(file, &["t_s", "file"], &[])?;
    let mut frames = Vec::with_capacity(table.len());
    let mut seen = HashMap::new();
    for row in 0..table.len() {
        let name = Path::new(table.text(row, "file"));
        let inside = name.components().all(|part| matches!(part, Component::Normal(_)));
        if name.as_os_str().is_empty() || !inside {
            let problem = format!("'{}' is no file inside the folder", name.display());
            return Err(table.error(row, problem, "write a path such as clouds/0000.ply"));
        }
        if let Some(before) = seen.insert(name.to_owned(), row) {
            let problem = format!("'{}' stands in line {} too", name.display(), line_of_row(before));
            return Err(table.error(
                row,
                problem,
                "name each cloud once, and delete the row where nothing new was seen",
            ));
        }
        let t_s = table.number(row, "t_s")?;
        let path = dir.join(name);
        if !path.exists() {
            let problem = format!("the file '{}' is not there", name.display());
            return Err(table.error(row, problem, "add the file or delete the row"));
        }
        // Who leaves out a frame that cannot be used needs its row.
        let in_row = |e: DemoError| DemoError {
            problem: format!("{} (clouds.csv:{})", e.problem, line_of_row(row)),
            ..e
        };
        frames.push(CloudFrame {
            t_s,
            points_m: points::read(&path).map_err(in_row)?,
        });
    }
    Ok(frames)
}

fn read_markers(file: &Path) -> Result<Vec<MarkerSample>, DemoError> {
    let table = Table::read(file, &["t_s", "marker", "s_m", "x_m", "y_m", "z_m"], &[])?;
    let mut samples = Vec::with_capacity(table.len());
    for row in 0..table.len() {
        samples.push(MarkerSample {
            t_s: table.number(row, "t_s")?,
            marker: table.text(row, "marker").to_owned(),
            s_m: table.number(row, "s_m")?,
            position_m: position(&table, row)?,
        });
    }
    Ok(samples)
}
