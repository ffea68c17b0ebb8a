//! What a model says about each demonstration: its centrelines and what it leaves unexplained.

use crate::fit::{FitError, Problem};
use crate::model::Structure;
use crate::observe::Row;
use crate::residual::ResidualMap;

/// A model next to one demonstration.
#[derive(Clone, Debug, PartialEq)]
pub struct DemoView {
    /// Name of the demonstration.
    pub name: String,
    /// Whether the fit did not see it.
    pub held_out: bool,
    /// Recorded times, s.
    pub times_s: Vec<f64>,
    /// Arc length of each slice, m.
    pub arcs_m: Vec<f64>,
    /// Predicted centreline per recorded time and slice, m.
    pub centrelines_m: Vec<Vec<[f64; 3]>>,
    /// Measured minus predicted.
    pub residual: ResidualMap,
    /// Root mean square of the offsets per recorded time, mm; none where nothing was seen.
    pub rms_mm: Vec<Option<f64>>,
    /// Root mean square that noise alone would give per recorded time, mm.
    pub floor_mm: Vec<Option<f64>>,
}

/// One view per demonstration of a problem, for the model with this structure at θ. The noise floor is
/// right where the problem's noise scale is that of the outcome.
///
/// # Errors
/// A simulation stopped, or too little was measured.
pub fn views(
    problem: &Problem,
    structure: &Structure,
    theta: &[f64],
    held_out: bool,
) -> Result<Vec<DemoView>, FitError> {
    let rollouts = problem.predict(structure, theta)?;
    let evaluation = problem.residuals_of(theta, &rollouts)?;
    let parts = problem.demos.iter().zip(&problem.scenes);
    let parts = parts.zip(rollouts.into_iter().zip(&evaluation.rows));
    Ok(parts
        .map(|((demo, scene), (rollout, rows))| {
            let times_s = scene.frame_times_s.clone();
            let points = |line: &Vec<[f32; 3]>| line.iter().map(|p| p.map(f64::from)).collect();
            DemoView {
                name: demo.name.clone(),
                held_out,
                arcs_m: rollout.arc_m,
                centrelines_m: rollout.frames.iter().map(points).collect(),
                residual: with_stations_of(rows, ResidualMap::of(demo, &times_s, rows)),
                rms_mm: per_frame(rows, times_s.len(), |row| row.offset_m),
                floor_mm: per_frame(rows, times_s.len(), |row| row.sigma_m),
                times_s,
            }
        })
        .collect())
}

/// Stations where they were measured: those of labelled markers are fewer and not evenly spaced.
fn with_stations_of(rows: &[Row], mut map: ResidualMap) -> ResidualMap {
    let known = map.arcs_m.len();
    for row in rows.iter().filter(|row| row.station < known) {
        map.arcs_m[row.station] = row.arc_m;
    }
    let increasing = 1 + map.arcs_m.windows(2).take_while(|pair| pair[0] < pair[1]).count();
    map.arcs_m.truncate(increasing);
    for frame in &mut map.offsets_mm {
        frame.truncate(increasing);
    }
    map
}

/// Root mean square of a length in m over the rows of each frame, mm.
fn per_frame(rows: &[Row], frames: usize, length_m: impl Fn(&Row) -> f64) -> Vec<Option<f64>> {
    let mut sums = vec![(0.0, 0usize); frames];
    for row in rows {
        let sum = &mut sums[row.frame];
        *sum = (sum.0 + length_m(row).powi(2), sum.1 + 1);
    }
    sums.iter()
        .map(|&(square, count)| (count > 0).then(|| 1e3 * (square / count as f64).sqrt()))
        .collect()
}
