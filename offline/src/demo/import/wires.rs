//! `wires`: hanging loops of three wires (adapteddlo_muj; Chen, Bretl and Pham, arXiv 2310.00911),
//! each photographed at rest between two level clamps.

use super::{RopeMeasure, Source, sample};
use crate::demo::table::Table;
use crate::demo::{ClampSpec, Demo, DemoError, MarkerSample, RopeEnd, RopeSpec, SceneKind, StartState};
use nalgebra::{UnitQuaternion, Vector3};
use std::path::Path;

/// The wires' thickness is not stated.
const ASSUMED_DIAMETER_M: f64 = 0.006;
/// Wire taken to be inside each clamp; it only holds the direction.
const GRIP_M: f64 = 0.02;
/// Standard deviation of a point that was clicked on a photograph: not stated, a guess.
const NOISE_M: f64 = 0.002;

/// One static demonstration per loop.
///
/// # Errors
/// A file is missing or malformed.
pub fn wires(dir: &Path) -> Result<Vec<Demo>, DemoError> {
    let columns = [
        "file",
        "wire",
        "trial",
        "mass_per_length_kg_m",
        "length_m",
        "clamp_gap_m",
        "critical_twist_deg",
    ];
    let manifest = Table::read(&dir.join("manifest.csv"), &columns, &[])?;
    (0..manifest.len()).map(|row| one(dir, &manifest, row)).collect()
}

fn one(dir: &Path, manifest: &Table, row: usize) -> Result<Demo, DemoError> {
    let points = Table::read(&dir.join(manifest.text(row, "file")), &["x_m", "y_m"], &[])?;
    let free_m = manifest.number(row, "length_m")?;
    let gap_m = manifest.number(row, "clamp_gap_m")?;
    let length_m = free_m + 2.0 * GRIP_M;
    let last = points.len() - 1;
    // The first and the last point are the clamps, which are given exactly.
    let mut markers = Vec::new();
    for k in 1..last {
        markers.push(MarkerSample {
            t_s: 0.0,
            marker: format!("p{k:02}"),
            s_m: GRIP_M + free_m * k as f64 / last as f64,
            // y points along gravity.
            position_m: [points.number(k, "x_m")?, 0.0, -points.number(k, "y_m")?],
        });
    }
    let along = Vector3::x();
    let still = UnitQuaternion::identity();
    let clamp = |end| ClampSpec {
        end,
        grip_m: GRIP_M,
        direction: Some(along.into()),
    };
    let name = format!("{}-{}", manifest.text(row, "wire"), manifest.text(row, "trial"));
    let source = Source {
        scene: SceneKind::Static,
        start: StartState::Straight,
        noise_m: NOISE_M,
        planar: true,
        notes: format!(
            "Wire {name}: a loop that hangs at rest between level clamps {gap_m} m apart, points clicked on a \
                 photograph (adapteddlo_muj, MIT). Mass per length weighed; diameter, noise_m and the 20 mm of \
                 wire inside each clamp are assumed. Critical twist {} degrees.",
            manifest.text(row, "critical_twist_deg")
        ),
        rope: RopeSpec {
            length_m,
            diameter_m: ASSUMED_DIAMETER_M,
            mass_kg: manifest.number(row, "mass_per_length_kg_m")? * length_m,
            direction: along.into(),
            end_mass_kg: 0.0,
            roll_rad: 0.0,
            assumed: vec![RopeMeasure::DiameterM],
        },
        clamps: vec![
            (
                clamp(RopeEnd::Start),
                vec![sample(0.0, Vector3::zeros(), GRIP_M, along, still)],
            ),
            (
                clamp(RopeEnd::End),
                vec![sample(0.0, Vector3::new(-gap_m, 0.0, 0.0), -GRIP_M, along, still)],
            ),
        ],
        markers,
        name,
    };
    Ok(source.demo())
}
