//! What cameras like the ones that were there would see of a motion that was not made yet: the rows that
//! a model predicts, and their slopes.

use super::motions::Candidate;
use super::power::{Miss, Prospect};
use crate::demo::{Demo, Observations};
use crate::diagnose::Noise;
use crate::diagnose::score::whitened_vector;
use crate::fit::{Evaluation, FitError, Problem, Resolution};
use crate::model::Structure;
use crate::observe::{Row, normals, station_arcs_m};
use nalgebra::{DMatrix, DVector};
use std::collections::HashMap;

/// How the rope is seen: which stations, how well, and along which directions.
pub(super) struct Look {
    /// Whether points of the surface are seen, which say nothing along the rope.
    surface: bool,
    /// Whether nothing is seen along y.
    planar: bool,
    /// Standard error per station, m; infinite where it was never seen.
    sigma_m: Vec<f64>,
    /// Arc length of each station, m.
    pub arcs_m: Vec<f64>,
    /// Where each station was at first, m.
    pub first_m: Vec<[f64; 3]>,
}

impl Look {
    /// From what was seen of a demonstration: its rows in a fit.
    pub(super) fn of(demo: &Demo, rows: &[Row]) -> Self {
        let arcs_m = station_arcs_m(demo);
        let surface = matches!(demo.observations, Observations::Clouds(_));
        let directions = if surface || demo.spec.planar { 2.0 } else { 3.0 };
        let mut frames: Vec<usize> = rows.iter().map(|row| row.frame).collect();
        frames.dedup();
        let mut information = vec![0.0; arcs_m.len()];
        for row in rows {
            information[row.station] += row.sigma_m.powi(-2);
        }
        let first = frames.first().copied().unwrap_or(0);
        let at_first: Vec<&Row> = rows.iter().filter(|row| row.frame == first).collect();
        let nearest = |s_m: f64| {
            let off = |row: &&&Row| (row.arc_m - s_m).abs();
            at_first
                .iter()
                .min_by(|a, b| off(a).total_cmp(&off(b)))
                .map(|row| row.position_m)
        };
        Self {
            surface,
            planar: demo.spec.planar,
            sigma_m: information
                .into_iter()
                .map(|sum| (frames.len() as f64 * directions / sum).sqrt())
                .collect(),
            first_m: arcs_m.iter().map(|&s| nearest(s).unwrap_or([0.0; 3])).collect(),
            arcs_m,
        }
    }

    /// Unit vectors along which a station is measured where the rope runs along `along`.
    fn directions(&self, along: [f64; 3]) -> Vec<[f64; 3]> {
        if self.surface {
            return normals(along).to_vec();
        }
        let mut axes = vec![[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        if self.planar {
            axes.remove(1);
        }
        axes
    }
}

/// A model's prediction of a motion at the stations.
pub(super) struct Predicted {
    /// Points, m, frame by frame and station by station.
    points_m: Vec<[f64; 3]>,
    /// Their slopes with every entry of θ, three rows per point.
    slopes: DMatrix<f64>,
    stations: usize,
}

impl Predicted {
    /// Simulates a motion with a model.
    pub(super) fn new(
        candidate: &Candidate,
        structure: &Structure,
        theta: &[f64],
        resolution: Resolution,
    ) -> Result<Self, FitError> {
        let problem = Problem::new(&[&candidate.demo], resolution)?;
        let evaluation = problem.evaluate(structure, theta)?;
        // Markers were put at every station, so there are three rows per frame and station in this order.
        let points = evaluation.rows[0].chunks_exact(3);
        Ok(Self {
            points_m: points.map(|rows| rows[0].position_m).collect(),
            slopes: evaluation.jacobian,
            stations: station_arcs_m(&candidate.demo).len(),
        })
    }

    /// Direction of the rope at a point, from its neighbours.
    fn along(&self, index: usize) -> [f64; 3] {
        let station = index % self.stations;
        let before = if station > 0 { index - 1 } else { index };
        let after = if station + 1 < self.stations {
            index + 1
        } else {
            index
        };
        let d: [f64; 3] = std::array::from_fn(|k| self.points_m[after][k] - self.points_m[before][k]);
        let length = d.iter().map(|c| c * c).sum::<f64>().sqrt();
        if length > 0.0 {
            d.map(|c| c / length)
        } else {
            [1.0, 0.0, 0.0]
        }
    }

    /// What would be measured, in standard errors, correlation of the noise taken out where it is given: slopes
    /// of this model, and for each of the `truths` what it predicts minus what this model does.
    pub(super) fn seen(
        &self,
        look: &Look,
        noise: Option<&Noise>,
        truths: &[&Self],
    ) -> (DMatrix<f64>, Vec<DVector<f64>>) {
        let (mut rows, mut slopes) = (Vec::new(), Vec::new());
        let mut misses: Vec<Vec<f64>> = vec![Vec::new(); truths.len()];
        for (index, point) in self.points_m.iter().enumerate() {
            let (frame, station) = (index / self.stations, index % self.stations);
            let sigma_m = look.sigma_m[station];
            if !sigma_m.is_finite() {
                continue;
            }
            for direction in look.directions(self.along(index)) {
                let part = |v: [f64; 3]| (0..3).map(|k| direction[k] * v[k]).sum::<f64>() / sigma_m;
                for (miss, truth) in misses.iter_mut().zip(truths) {
                    miss.push(part(std::array::from_fn(|k| truth.points_m[index][k] - point[k])));
                }
                let slope =
                    |column: usize| part(std::array::from_fn(|k| self.slopes[(3 * index + k, column)]));
                slopes.push((0..self.slopes.ncols()).map(slope).collect::<Vec<f64>>());
                rows.push(Row {
                    frame,
                    station,
                    arc_m: look.arcs_m[station],
                    position_m: *point,
                    direction,
                    offset_m: 0.0,
                    sigma_m,
                });
            }
        }
        let columns = self.slopes.ncols();
        let mut all = DMatrix::zeros(rows.len(), columns + truths.len());
        for (i, row) in slopes.iter().enumerate() {
            for (k, slope) in row.iter().enumerate() {
                all[(i, k)] = *slope;
            }
            for (k, miss) in misses.iter().enumerate() {
                all[(i, columns + k)] = miss[i];
            }
        }
        let evaluation = Evaluation {
            theta: Vec::new(),
            most_rows: rows.len(),
            huber: f64::INFINITY,
            rows: vec![rows],
            jacobian: DMatrix::zeros(0, 0),
        };
        let white = match noise {
            Some(noise) => noise.whitener(&evaluation).apply(&all),
            None => all,
        };
        let misses = (columns..columns + truths.len()).map(|k| white.column(k).into_owned());
        (white.columns(0, columns).into_owned(), misses.collect())
    }
}

/// Where a model predicts each frame and station that was seen.
fn predicted(rows: &[Row]) -> HashMap<(usize, usize), [f64; 3]> {
    rows.iter()
        .map(|row| ((row.frame, row.station), row.position_m))
        .collect()
}

/// What the data so far say about a model's parameters.
pub(super) struct Known {
    /// Information, priors included.
    pub information: DMatrix<f64>,
    /// Mean square of the whitened residual, at least one.
    pub misfit: f64,
    /// The model on the demonstrations that were made.
    pub evaluation: Evaluation,
    /// Standard deviations of the priors.
    pub prior_sd: Vec<f64>,
}

impl Known {
    /// From the slopes of a model on the demonstrations that were made; `prior_sd` of every parameter.
    pub(super) fn new(evaluation: Evaluation, noise: &Noise, prior_sd: Vec<f64>) -> Self {
        let whitener = noise.whitener(&evaluation);
        let slopes = whitener.apply(&evaluation.whitened_jacobian());
        let residual = whitened_vector(&whitener, evaluation.whitened());
        let misfit = (residual.norm_squared() / residual.len() as f64).max(1.0);
        let mut information = slopes.tr_mul(&slopes) / misfit;
        for (k, sd) in prior_sd.iter().enumerate() {
            information[(k, k)] += 1.0 / (sd * sd);
        }
        Self {
            information,
            misfit,
            evaluation,
            prior_sd,
        }
    }

    /// This model beside one that is true on the demonstrations that were made.
    pub(super) fn miss(&self, truth: &Self) -> Miss {
        let mut miss = Vec::with_capacity(self.evaluation.len());
        for (rows, others) in self.evaluation.rows.iter().zip(&truth.evaluation.rows) {
            let (mine, theirs) = (predicted(rows), predicted(others));
            miss.extend(rows.iter().map(|row| {
                let place = (row.frame, row.station);
                let apart: [f64; 3] = theirs.get(&place).map_or([0.0; 3], |there| {
                    let here = mine[&place];
                    std::array::from_fn(|k| there[k] - here[k])
                });
                (0..3).map(|k| row.direction[k] * apart[k]).sum::<f64>() / row.sigma_m
            }));
        }
        Miss {
            miss: DVector::from_vec(miss),
            slopes: self.evaluation.whitened_jacobian(),
        }
    }

    /// Together with what a new demonstration would show.
    pub(super) fn with(&self, slopes: DMatrix<f64>) -> Prospect {
        Prospect {
            slopes,
            information: self.information.clone(),
            misfit: self.misfit,
        }
    }
}
