//! `noodle`: a foam cylinder moved by an arm at one end (PRB_Net; Mamedov et al., arXiv 2407.03476).

use super::npy::Array;
use super::{MASS_AND_DIAMETER, Source, assumed_mass_kg, sample, stride};
use crate::demo::table::Table;
use crate::demo::{
    ClampSpec, Demo, DemoError, MarkerSample, RopeEnd, RopeSpec, SceneKind, StartState, make_continuous,
};
use nalgebra::{UnitQuaternion, Vector3};
use std::path::Path;

/// Pool noodles are sold with about this diameter; the source states none.
const ASSUMED_DIAMETER_M: f64 = 0.06;
/// Polyethylene foam; the source states no mass.
const ASSUMED_DENSITY_KG_M3: f64 = 30.0;
/// Foam taken to be inside the clamp; it only holds the direction.
const GRIP_M: f64 = 0.05;
/// Length from the base, m, and arc lengths of the two markers from the base, m (the source's calibration).
const FREE_M: f64 = 1.9;
const MARKERS: [(&str, f64, usize); 2] = [("middle", 0.915, 13), ("end", 1.895, 16)];
/// Standard deviation of a marker: motion capture and arm are calibrated to each other, a guess.
const NOISE_M: f64 = 0.002;
const RECORDED_HZ: f64 = 250.0;
const COLUMNS: usize = 19;

/// One demonstration per recording; observed frames are thinned to about `rate_hz`.
///
/// # Errors
/// A file is missing or malformed.
pub fn noodle(dir: &Path, rate_hz: f64) -> Result<Vec<Demo>, DemoError> {
    let columns = [
        "file",
        "samples",
        "duration_s",
        "t0_upstream_s",
        "base_still_tail_s",
        "max_base_speed_m_s",
        "upstream_path",
    ];
    let manifest = Table::read(&dir.join("manifest.csv"), &columns, &[])?;
    (0..manifest.len())
        .map(|row| one(dir, manifest.text(row, "file"), rate_hz))
        .collect()
}

fn one(dir: &Path, file: &str, rate_hz: f64) -> Result<Demo, DemoError> {
    let path = dir.join(file);
    let array = Array::read(&path, 2)?;
    if array.shape[1] != COLUMNS || array.shape[0] == 0 {
        let problem = format!("the shape is {:?}, not (T, {COLUMNS})", array.shape);
        return Err(DemoError::new(&path, problem, "see columns.csv of the source"));
    }
    let stride = stride(RECORDED_HZ, rate_hz);
    let (mut clamp, mut markers) = (Vec::new(), Vec::new());
    for frame in 0..array.shape[0] {
        let row = array.row(frame);
        let vector = |k: usize| Vector3::new(row[k], row[k + 1], row[k + 2]).cast::<f64>();
        let t_s = f64::from(row[0]);
        // Euler angles in the order z, y, x: R = Rz Ry Rx.
        let angles = vector(4);
        let turn = UnitQuaternion::from_euler_angles(angles[2], angles[1], angles[0]);
        clamp.push(sample(t_s, vector(1), GRIP_M, turn * Vector3::x(), turn));
        if frame % stride == 0 {
            markers.extend(MARKERS.map(|(label, s_m, column)| MarkerSample {
                t_s,
                marker: label.to_owned(),
                s_m: GRIP_M + s_m,
                position_m: vector(column).into(),
            }));
        }
    }
    make_continuous(&mut clamp);
    let length_m = GRIP_M + FREE_M;
    let direction = clamp[0].turn() * Vector3::x();
    let name = file.trim_end_matches(".npy").to_owned();
    let grip = ClampSpec {
        end: RopeEnd::Start,
        grip_m: GRIP_M,
        direction: None,
    };
    let source = Source {
        scene: SceneKind::Free,
        start: StartState::Rest,
        noise_m: NOISE_M,
        planar: false,
        notes: format!(
            "{name}: foam cylinder moved by an arm at its base (PRB_Net). Base from the arm's joints, markers \
                 from motion capture, low-pass filtered by the source; one frame in {stride} kept. Diameter, mass, \
                 noise_m and the 50 mm of foam inside the clamp are assumed; the markers' masses are unknown."
        ),
        rope: RopeSpec {
            length_m,
            diameter_m: ASSUMED_DIAMETER_M,
            mass_kg: assumed_mass_kg(length_m, ASSUMED_DIAMETER_M, ASSUMED_DENSITY_KG_M3),
            direction: direction.into(),
            end_mass_kg: 0.0,
            roll_rad: 0.0,
            assumed: MASS_AND_DIAMETER.to_vec(),
        },
        clamps: vec![(grip, clamp)],
        markers,
        name,
    };
    Ok(source.demo())
}
