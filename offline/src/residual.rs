//! What a model does not explain, in millimetres over arc length and time, next to its noise, which
//! is measured without the model.

use crate::demo::Demo;
use crate::fit::{Correlation, Evaluation};
use crate::observe::{Row, noise_m, station_arcs_m};
use serde::{Deserialize, Serialize};

/// Residual of one demonstration on the grid of frames and stations.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ResidualMap {
    /// Name of the demonstration.
    pub demo: String,
    /// Time of each frame, s.
    pub times_s: Vec<f64>,
    /// Arc length of each station, m.
    pub arcs_m: Vec<f64>,
    /// Measured minus predicted per frame and station, mm along (x, y, z); none where nothing was seen.
    pub offsets_mm: Vec<Vec<Option<[f64; 3]>>>,
    /// Noise of an offset along one direction, root mean square over all of them, mm.
    #[serde(default)]
    pub noise_mm: f64,
}

/// Size of a residual next to its noise.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ResidualSummary {
    /// Root mean square of the measured offsets, mm.
    pub rms_mm: f64,
    /// Root mean square that noise alone would give, mm.
    pub floor_mm: f64,
    /// Their ratio.
    pub floors: f64,
    /// Number of offsets.
    pub rows: usize,
    /// Number of independent offsets that carry as much information.
    pub effective_rows: f64,
    /// Correlations and reduced chi-square.
    pub correlation: Correlation,
}

impl ResidualSummary {
    /// Of an evaluation.
    pub fn of(evaluation: &Evaluation) -> Self {
        let correlation = Correlation::of(evaluation);
        let (rms, floor) = (evaluation.rms_m(), evaluation.floor_m());
        Self {
            rms_mm: 1e3 * rms,
            floor_mm: 1e3 * floor,
            floors: rms / floor,
            rows: evaluation.len(),
            effective_rows: correlation.effective_rows(evaluation.len()),
            correlation,
        }
    }
}

impl ResidualMap {
    /// Of one demonstration's rows.
    pub fn of(demo: &Demo, times_s: &[f64], rows: &[Row]) -> Self {
        let arcs_m = station_arcs_m(demo);
        let mut offsets_mm = vec![vec![None; arcs_m.len()]; times_s.len()];
        for row in rows {
            let cell = offsets_mm[row.frame][row.station].get_or_insert([0.0; 3]);
            for k in 0..3 {
                cell[k] += 1e3 * row.offset_m * row.direction[k];
            }
        }
        Self {
            demo: demo.name.clone(),
            times_s: times_s.to_vec(),
            arcs_m,
            offsets_mm,
            noise_mm: 1e3 * noise_m(rows),
        }
    }
}

/// A fitted rope that misses what was seen by more than this share of its length has explained
/// nothing: no missing effect of the library moves a rope so far, but a wrong scale or axis does.
const MISFIT_SHARE: f64 = 0.1;

/// What a fit says of demonstrations that no rope can have made, one line each.
pub fn misfits(demos: &[&Demo], evaluation: &Evaluation) -> Vec<String> {
    let mut found = Vec::new();
    for (demo, rows) in demos.iter().zip(&evaluation.rows) {
        let square: f64 = rows.iter().map(|r| r.offset_m * r.offset_m).sum();
        let rms_m = (square / rows.len().max(1) as f64).sqrt();
        let share = rms_m / demo.spec.rope.length_m;
        if share > MISFIT_SHARE {
            found.push(format!(
                "{}: the fitted rope misses what was seen by {:.0} mm, {:.0} % of its length; do not believe its \
                 parameters, but look for swapped axes, a wrong scale, wrong clocks or a wrong clamp path",
                demo.name,
                1e3 * rms_m,
                100.0 * share
            ));
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;
    use std::path::Path;

    #[test]
    fn a_fit_that_misses_by_a_tenth_of_the_rope_is_named_and_a_good_one_is_not() {
        let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("demos/sample-rope/fit");
        let demo = Demo::load(dir).unwrap();
        let evaluation = |offset_m: f64| Evaluation {
            theta: vec![0.0, 0.3],
            rows: vec![vec![Row {
                frame: 0,
                station: 0,
                arc_m: 0.0,
                position_m: [0.0; 3],
                direction: [1.0, 0.0, 0.0],
                offset_m,
                sigma_m: 0.001,
            }]],
            most_rows: 1,
            huber: f64::INFINITY,
            jacobian: DMatrix::zeros(0, 0),
        };
        assert!(misfits(&[&demo], &evaluation(0.02)).is_empty());
        let found = misfits(&[&demo], &evaluation(0.05));
        assert!(found.len() == 1 && found[0].contains("swapped axes"), "{found:?}");
    }
}
