//! What a demonstration's values must obey, the same for one that is read and one to be written.

use super::table::line_of_row;
use super::{
    ClampSample, Demo, DemoError, DemoSpec, FORMAT, MarkerSample, Observations, RopeSpec, SceneKind,
    StartState,
};
use crate::toml_lines::line_of;
use std::ops::RangeInclusive;
use std::path::Path;

/// Farthest coordinate from the origin that a table-top experiment can have, m.
pub(super) const FARTHEST_M: f64 = 20.0;
/// How far the norm of a direction or a quaternion may be from 1.
const NORM_TOLERANCE: f64 = 1e-3;
/// What to do about a direction or a quaternion whose norm is another.
const NORMALISE: &str = "divide it by its norm";
/// Densities from foam (15 kg/m³) to steel wire (8000 kg/m³), with a margin, kg/m³.
const DENSITIES: RangeInclusive<f64> = 5.0..=20_000.0;
/// Lengths of ropes, m.
const LENGTHS_M: RangeInclusive<f64> = 0.01..=10.0;
/// Diameters of ropes, m; at most half the length too.
const DIAMETERS_M: RangeInclusive<f64> = 2e-4..=0.2;
/// Masses at a rope's end, kg.
const END_MASSES_KG: RangeInclusive<f64> = 0.0..=10.0;
/// Most that a rope can be rolled about its axis, rad.
const FULL_TURN_RAD: f64 = std::f64::consts::TAU;

/// The file `demo.toml`, as far as errors name it.
pub(super) struct Declared<'a> {
    /// The file.
    pub(super) file: &'a Path,
    /// What is in it; empty where it is still to be written.
    pub(super) text: &'a str,
}

impl Declared<'_> {
    /// An error at the line of a declared value, such as `rope.length_m`.
    fn error(&self, key: &str, problem: impl Into<String>, remedy: &str) -> DemoError {
        let error = DemoError::new(self.file, problem, remedy);
        match line_of(self.text, key) {
            Some(line) => error.at(line),
            None => error,
        }
    }
}

/// Checks everything but the clouds' points, as if it stood in the folder `dir` with `text` as its `demo.toml`.
pub(super) fn demo(dir: &Path, demo: &Demo, text: &str) -> Result<(), DemoError> {
    let file = dir.join("demo.toml");
    let declared = Declared { file: &file, text };
    spec(&declared, &demo.spec)?;
    let clamps = demo.spec.clamps.len();
    if demo.clamps.len() != clamps || demo.commanded.len() != clamps {
        let problem = format!("{clamps} clamps are declared, {} have a path", demo.clamps.len());
        return Err(DemoError::new(dir, problem, "give one path for each clamp"));
    }
    for (index, path) in demo.clamps.iter().enumerate() {
        let file = dir.join(format!("clamp_{index}.csv"));
        clamp_path(&file, path)?;
        if path.iter().all(|sample| !sample.closed) {
            return Err(DemoError::new(
                &file,
                "the gripper never holds the rope: closed is 0 in every row",
                "write 1 in every row while it is closed",
            ));
        }
    }
    for (index, path) in demo.commanded.iter().enumerate() {
        if let Some(path) = path {
            clamp_path(&dir.join(format!("clamp_{index}_commanded.csv")), path)?;
        }
    }
    start(&declared, demo)?;
    if demo.spec.is_static() {
        one_sample_per_frame(dir, demo)?;
    }
    match &demo.observations {
        Observations::Clouds(frames) => {
            let times: Vec<f64> = frames.iter().map(|frame| frame.t_s).collect();
            rising(&dir.join("clouds.csv"), &times)
        }
        Observations::Markers(samples) => markers(&dir.join("markers.csv"), samples, demo.spec.rope.length_m),
    }
}

/// Checks that the start can be made from what was measured.
fn start(declared: &Declared, demo: &Demo) -> Result<(), DemoError> {
    let spec = &demo.spec;
    let fail = |key: &str, problem: &str, remedy: &str| Err(declared.error(key, problem, remedy));
    let hangs = spec.start != StartState::Straight || spec.is_static();
    if hangs && spec.clamps.is_empty() {
        let key = if spec.is_static() { "scene" } else { "start" };
        return fail(key, "nothing holds the rope", "declare the clamp in [[clamps]]");
    }
    if spec.start == StartState::Moving && !matches!(demo.observations, Observations::Markers(_)) {
        return fail(
            "start",
            "start = \"moving\" without markers",
            "start at rest, or label points along the rope",
        );
    }
    if spec.start == StartState::Moving && demo.times_s().first().is_some_and(|first| first.abs() > 1e-6) {
        return fail(
            "start",
            "start = \"moving\", but the first frame is not at t_s = 0",
            "shift all times so that the first frame is at 0",
        );
    }
    if spec.is_static() && spec.start == StartState::Moving {
        return fail(
            "start",
            "a static scene that starts moving",
            "leave start out: every pose of it is at rest",
        );
    }
    Ok(())
}

fn one_sample_per_frame(dir: &Path, demo: &Demo) -> Result<(), DemoError> {
    let frames = demo.times_s();
    for (index, path) in demo.clamps.iter().enumerate() {
        let times: Vec<f64> = path.iter().map(|sample| sample.t_s).collect();
        if times == frames {
            continue;
        }
        let row = times.iter().zip(&frames).take_while(|(a, b)| a == b).count();
        let problem = format!(
            "{} samples for {} poses, and the times differ from row {row} on",
            times.len(),
            frames.len()
        );
        return Err(DemoError::new(
            &dir.join(format!("clamp_{index}.csv")),
            problem,
            "a static scene has one clamp sample per frame, at the frame's time",
        ));
    }
    Ok(())
}

/// Checks that a demonstration is of this version of the format.
pub(super) fn format(declared: &Declared, format: &str) -> Result<(), DemoError> {
    if format == FORMAT {
        return Ok(());
    }
    Err(declared.error(
        "format",
        format!("format is '{format}'"),
        &format!("this program reads '{FORMAT}'; import other formats first"),
    ))
}

/// Largest noise of a measured point, as a share of the rope's length: what is more shows no rope.
const NOISE_SHARE_MAX: f64 = 0.1;

/// Checks the declared values.
pub(super) fn spec(declared: &Declared, spec: &DemoSpec) -> Result<(), DemoError> {
    let fail = |key: &str, problem: String, remedy: &str| Err(declared.error(key, problem, remedy));
    format(declared, &spec.format)?;
    rope(declared, spec)?;
    if !(spec.noise_m > 0.0 && spec.noise_m <= NOISE_SHARE_MAX * spec.rope.length_m) {
        return fail(
            "noise_m",
            format!(
                "noise_m = {} is no standard deviation of a point of a rope of {} m",
                spec.noise_m, spec.rope.length_m
            ),
            "give it in metres, above 0 and at most a tenth of length_m (a depth camera has about 0.001)",
        );
    }
    table(declared, spec)?;
    clamps(declared, spec)?;
    cameras(declared, spec)
}

fn table(declared: &Declared, spec: &DemoSpec) -> Result<(), DemoError> {
    let fail = |key: &str, problem: String, remedy: &str| Err(declared.error(key, problem, remedy));
    let Some(table) = &spec.table else {
        if matches!(spec.scene, SceneKind::Lift) {
            return fail(
                "scene",
                "there is no [table], but a lift starts on one".into(),
                "add [table] with height_m",
            );
        }
        return Ok(());
    };
    if table.height_m.is_nan() || table.height_m.abs() > FARTHEST_M {
        return fail(
            "table.height_m",
            format!("table.height_m = {} is no height of a table", table.height_m),
            "give it in metres",
        );
    }
    if !(0.0..=5.0).contains(&table.friction) {
        return fail(
            "table.friction",
            format!("table.friction = {} is no friction coefficient", table.friction),
            "give a value from 0 to 5",
        );
    }
    Ok(())
}

/// What no rope measures: which value of it, what is wrong and what to do.
pub(crate) fn no_rope(rope: &RopeSpec) -> Option<(&'static str, String, &'static str)> {
    let density = rope.density_kg_m3();
    if !LENGTHS_M.contains(&rope.length_m) {
        return Some((
            "length_m",
            format!("rope.length_m = {} is no length of a rope", rope.length_m),
            "give it in metres, from 0.01 to 10",
        ));
    }
    if !DIAMETERS_M.contains(&rope.diameter_m) || rope.diameter_m > 0.5 * rope.length_m {
        return Some((
            "diameter_m",
            format!("rope.diameter_m = {} is no diameter of a rope", rope.diameter_m),
            "give it in metres, from 0.0002 to 0.2 and at most half the length",
        ));
    }
    if !DENSITIES.contains(&density) {
        return Some((
            "mass_kg",
            format!(
                "rope.mass_kg = {} makes a density of {density:.3e} kg/m³",
                rope.mass_kg
            ),
            "give mass in kg, length and diameter in metres (5 to 20000 kg/m³)",
        ));
    }
    (!END_MASSES_KG.contains(&rope.end_mass_kg)).then(|| {
        (
            "end_mass_kg",
            format!(
                "rope.end_mass_kg = {} is no mass at a rope's end",
                rope.end_mass_kg
            ),
            "give it in kg, from 0 to 10",
        )
    })
}

fn rope(declared: &Declared, spec: &DemoSpec) -> Result<(), DemoError> {
    let rope = &spec.rope;
    let fail = |key: &str, problem: String, remedy: &str| Err(declared.error(key, problem, remedy));
    if let Some((value, problem, remedy)) = no_rope(rope) {
        return fail(&format!("rope.{value}"), problem, remedy);
    }
    // NaN is in no range.
    if !(-FULL_TURN_RAD..=FULL_TURN_RAD).contains(&rope.roll_rad) {
        return fail(
            "rope.roll_rad",
            format!(
                "rope.roll_rad = {} is no angle by which a rope is rolled",
                rope.roll_rad
            ),
            "give it in radians, at most one turn",
        );
    }
    unit(declared, "rope.direction", "rope.direction", &rope.direction)
}

fn clamps(declared: &Declared, spec: &DemoSpec) -> Result<(), DemoError> {
    let fail = |key: &str, problem: String, remedy: &str| Err(declared.error(key, problem, remedy));
    let needed = match spec.scene {
        SceneKind::Lift => Some(1),
        SceneKind::Swing => Some(2),
        SceneKind::Free | SceneKind::Static => None,
    };
    if let Some(needed) = needed.filter(|needed| *needed != spec.clamps.len()) {
        return fail(
            "scene",
            format!("{} clamps, but this scene has {needed}", spec.clamps.len()),
            "add or remove [[clamps]], or write scene = \"free\"",
        );
    }
    let mut gripped = 0.0;
    for (index, clamp) in spec.clamps.iter().enumerate() {
        if !(clamp.grip_m > 0.0 && clamp.grip_m < spec.rope.length_m) {
            return fail(
                &format!("clamps.{index}.grip_m"),
                format!(
                    "clamp {index} grips {} m of a rope of {} m",
                    clamp.grip_m, spec.rope.length_m
                ),
                "give the length of rope inside the gripper in metres, above 0 and below the rope's length",
            );
        }
        if let Some(direction) = &clamp.direction {
            let key = format!("clamps.{index}.direction");
            unit(
                declared,
                &key,
                &format!("the direction of clamp {index}"),
                direction,
            )?;
        }
        gripped += clamp.grip_m;
        if spec.clamps[..index].iter().any(|other| other.end == clamp.end) {
            return fail(
                &format!("clamps.{index}.end"),
                format!("clamp {index} grips an end that another clamp grips"),
                "give each clamp its own end",
            );
        }
    }
    if gripped >= spec.rope.length_m {
        return fail(
            "clamps",
            format!(
                "the clamps grip {gripped} m of a rope of {} m",
                spec.rope.length_m
            ),
            "leave some rope free between them",
        );
    }
    Ok(())
}

fn cameras(declared: &Declared, spec: &DemoSpec) -> Result<(), DemoError> {
    for (index, camera) in spec.cameras.iter().enumerate() {
        let name = &camera.name;
        unit(
            declared,
            &format!("cameras.{index}.quaternion_xyzw"),
            &format!("quaternion of camera '{name}'"),
            &camera.quaternion_xyzw,
        )?;
        if spec.cameras[..index].iter().any(|other| other.name == *name) {
            return Err(declared.error(
                &format!("cameras.{index}.name"),
                format!("two cameras are called '{name}'"),
                "give each its own name, which messages say",
            ));
        }
        let near = camera.position_m.iter().all(|x| x.abs() <= FARTHEST_M);
        let optics = camera.focal_px.iter().all(|f| *f > 0.0 && f.is_finite())
            && camera.centre_px.iter().all(|c| c.is_finite())
            && camera.width_px > 0
            && camera.height_px > 0;
        if !near || !optics {
            return Err(declared.error(
                &format!("cameras.{index}"),
                format!("camera '{name}' has an impossible pose or optics"),
                "give metres and pixels; focal lengths and sizes are above 0",
            ));
        }
    }
    Ok(())
}

/// Checks the norm of a declared direction or quaternion.
fn unit(declared: &Declared, key: &str, what: &str, vector: &[f64]) -> Result<(), DemoError> {
    let problem = not_unit(what, vector);
    problem.map_or(Ok(()), |problem| Err(declared.error(key, problem, NORMALISE)))
}

/// What is wrong with a vector whose norm has to be 1, where it is not.
fn not_unit(what: &str, vector: &[f64]) -> Option<String> {
    let norm = vector.iter().map(|x| x * x).sum::<f64>().sqrt();
    // Written so that NaN fails.
    let holds = (norm - 1.0).abs() <= NORM_TOLERANCE;
    (!holds).then(|| format!("{what} has norm {norm:.4}"))
}

fn clamp_path(file: &Path, path: &[ClampSample]) -> Result<(), DemoError> {
    if path.is_empty() {
        return Err(DemoError::new(
            file,
            "there are no samples",
            "record at least one",
        ));
    }
    let times: Vec<f64> = path.iter().map(|sample| sample.t_s).collect();
    rising(file, &times)?;
    for (row, sample) in path.iter().enumerate() {
        position(file, row, &sample.position_m)?;
        if let Some(problem) = not_unit("the quaternion qx,qy,qz,qw", &sample.quaternion_xyzw) {
            return Err(DemoError::new(file, problem, NORMALISE).at(line_of_row(row)));
        }
    }
    Ok(())
}

fn markers(file: &Path, samples: &[MarkerSample], length_m: f64) -> Result<(), DemoError> {
    if samples.is_empty() {
        return Err(DemoError::new(
            file,
            "there are no samples",
            "record at least one",
        ));
    }
    let mut seen = std::collections::BTreeMap::<&str, (f64, f64)>::new();
    let mut newest = f64::NEG_INFINITY;
    for (row, sample) in samples.iter().enumerate() {
        let fail =
            |problem: String, remedy: &str| Err(DemoError::new(file, problem, remedy).at(line_of_row(row)));
        if !sample.t_s.is_finite() || sample.t_s < newest {
            return fail(
                format!("t_s goes back from {newest} to {}", sample.t_s),
                "sort the rows by time",
            );
        }
        newest = sample.t_s;
        let label = &sample.marker;
        if label.is_empty() || label.contains([',', '\n', '\r']) || label.trim() != label {
            return fail(format!("marker '{label}' is no label"), "use letters and digits");
        }
        if !(0.0..=length_m).contains(&sample.s_m) {
            return fail(
                format!("s_m = {} lies outside the rope's {length_m} m", sample.s_m),
                "give the arc length from the rope's start in metres",
            );
        }
        position(file, row, &sample.position_m)?;
        if let Some((t, s)) = seen.insert(label, (sample.t_s, sample.s_m)) {
            if t == sample.t_s {
                return fail(
                    format!("marker '{label}' stands twice at t_s = {t}"),
                    "delete one of the rows",
                );
            }
            if s != sample.s_m {
                return fail(
                    format!("marker '{label}' moves along the rope from {s} to {}", sample.s_m),
                    "a marker keeps its arc length",
                );
            }
        }
    }
    Ok(())
}

/// Checks that times are finite and strictly rising.
fn rising(file: &Path, times: &[f64]) -> Result<(), DemoError> {
    if times.is_empty() {
        return Err(DemoError::new(
            file,
            "there are no rows",
            "record at least one row",
        ));
    }
    for (row, t) in times.iter().enumerate() {
        let before = if row == 0 {
            f64::NEG_INFINITY
        } else {
            times[row - 1]
        };
        if !t.is_finite() || *t <= before {
            let problem = format!("t_s goes from {before} to {t}");
            return Err(
                DemoError::new(file, problem, "sort the rows by time, one row for each instant")
                    .at(line_of_row(row)),
            );
        }
    }
    Ok(())
}

fn position(file: &Path, row: usize, position_m: &[f64; 3]) -> Result<(), DemoError> {
    if position_m.iter().all(|x| x.abs() <= FARTHEST_M) {
        return Ok(());
    }
    let problem = format!("the position {position_m:?} m lies too far away");
    Err(DemoError::new(file, problem, "write metres, not millimetres").at(line_of_row(row)))
}
