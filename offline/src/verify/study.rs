//! Convergence studies: one quantity on several grid spacings and at several alignments to the grid.

use super::Extent;
use super::case::{Case, Of};
use crate::sim::SimError;
use crate::sim::scene::{MIN_CELLS_PER_DIAMETER, Scene};
use rayon::prelude::*;
use serde::Serialize;

/// Further shifts of the grid along (s, side, up), in cells: as the program lays it, half a cell along the rope,
/// half a cell across in the direction of bending, and a quarter along all axes.
pub const ALIGNMENTS: [[f64; 3]; 4] = [
    [0.0, 0.0, 0.0],
    [0.5, 0.0, 0.0],
    [0.0, 0.0, 0.5],
    [0.25, 0.25, 0.25],
];

/// Grid spacings of a full study, in cells across the rope.
pub const SPACINGS: [f64; 3] = [1.5, 2.1, 3.0];

/// One simulation of a study.
#[derive(Clone, Debug, Serialize)]
pub struct Point {
    /// Cells across the rope.
    pub cells: f64,
    /// Index into [`ALIGNMENTS`].
    pub alignment: usize,
    /// What came out.
    pub obtained: f64,
    /// obtained / expected − 1.
    pub error: f64,
}

/// A quantity over grid spacings and alignments.
#[derive(Clone, Debug, Serialize)]
pub struct Study {
    /// What was measured.
    pub name: String,
    /// Unit.
    pub unit: &'static str,
    /// Exact value.
    pub expected: f64,
    /// Simulations.
    pub points: Vec<Point>,
}

impl Study {
    /// Measures a quantity on the given spacings, at all alignments or only the program's own.
    ///
    /// # Errors
    /// A simulation stopped.
    pub fn run(
        name: &str,
        unit: &'static str,
        expected: f64,
        spacings: &[f64],
        alignments: usize,
        measure: impl Fn(f64, [f64; 3]) -> Result<f64, SimError> + Sync,
    ) -> Result<Self, SimError> {
        let plan: Vec<(f64, usize)> = spacings
            .iter()
            .flat_map(|&cells| (0..alignments).map(move |alignment| (cells, alignment)))
            .collect();
        let points = plan
            .into_par_iter()
            .map(|(cells, alignment)| {
                let obtained = measure(cells, ALIGNMENTS[alignment])?;
                Ok(Point {
                    cells,
                    alignment,
                    obtained,
                    error: obtained / expected - 1.0,
                })
            })
            .collect::<Result<Vec<_>, SimError>>()?;
        Ok(Self {
            name: name.into(),
            unit,
            expected,
            points,
        })
    }

    /// The spacings and the number of alignments that an extent asks for.
    pub fn plan(extent: Extent) -> (&'static [f64], usize) {
        match extent {
            Extent::Quick => (&[MIN_CELLS_PER_DIAMETER], ALIGNMENTS.len()),
            Extent::Full => (&SPACINGS, ALIGNMENTS.len()),
        }
    }

    /// Spacings in the order of their first points.
    pub fn spacings(&self) -> Vec<f64> {
        let mut list: Vec<f64> = Vec::new();
        for point in &self.points {
            if !list.contains(&point.cells) {
                list.push(point.cells);
            }
        }
        list
    }

    /// Errors at one spacing, in the order of the alignments.
    pub fn errors(&self, cells: f64) -> Vec<f64> {
        let here = self.points.iter().filter(|p| p.cells == cells);
        here.map(|p| p.error).collect()
    }

    /// Largest |error| over the alignments at one spacing.
    pub fn worst(&self, cells: f64) -> f64 {
        self.errors(cells).into_iter().map(f64::abs).fold(0.0, f64::max)
    }

    /// Observed order of convergence: slope of ln|error| over ln spacing by least squares, for the
    /// program's own alignment or for the worst of all.
    pub fn order(&self, worst: bool) -> Option<f64> {
        let spacings = self.spacings();
        if spacings.len() < 2 {
            return None;
        }
        let error = |cells: f64| {
            if worst {
                self.worst(cells)
            } else {
                self.errors(cells)[0].abs()
            }
        };
        let points: Vec<[f64; 2]> = spacings.iter().map(|&c| [-c.ln(), error(c).ln()]).collect();
        let n = points.len() as f64;
        let mean = |k: usize| points.iter().map(|p| p[k]).sum::<f64>() / n;
        let (x, y) = (mean(0), mean(1));
        let rise: f64 = points.iter().map(|p| (p[0] - x) * (p[1] - y)).sum();
        let run: f64 = points.iter().map(|p| (p[0] - x).powi(2)).sum();
        Some(rise / run)
    }

    /// One case per spacing at which the program may run (the worst alignment must be within
    /// `tolerance` of the exact value), and one for the order of convergence of the worst alignment.
    pub fn cases(&self, family: Of, tolerance: f64, least_order: f64) -> Vec<Case> {
        let mut cases: Vec<Case> = self
            .spacings()
            .into_iter()
            .map(|cells| {
                let far = |p: &&Point| p.cells == cells;
                let worst = self
                    .points
                    .iter()
                    .filter(far)
                    .max_by(|a, b| a.error.abs().total_cmp(&b.error.abs()))
                    .map_or(f64::NAN, |p| p.obtained);
                let name = format!("{}, {cells:.1} cells", self.name);
                family.relative(name, self.unit, [self.expected, worst], tolerance)
            })
            .collect();
        if let Some(order) = self.order(true) {
            let name = format!("{}, order of convergence", self.name);
            cases.push(family.at_least(name, "1", order, least_order));
        }
        cases
    }

    /// The study as text: errors in percent, one line per spacing.
    pub fn text(&self) -> String {
        let mut text = format!(
            "\n{} (exact {:.6} {}): error in % at the alignments {ALIGNMENTS:?}\n",
            self.name, self.expected, self.unit
        );
        for cells in self.spacings() {
            let errors = self
                .errors(cells)
                .into_iter()
                .map(|e| format!("{:8.2}", 100.0 * e));
            text += &format!("  {cells:.2} cells {}\n", errors.collect::<String>());
        }
        if let (Some(own), Some(worst)) = (self.order(false), self.order(true)) {
            text += &format!("  order {own:.2} at the program's own alignment, {worst:.2} at the worst\n");
        }
        text
    }
}

/// A scene on another grid; the study may go below the program's least thickness.
pub fn on_grid(mut scene: Scene, cells: f64, shift_cells: [f64; 3]) -> Scene {
    scene.lay_grid(cells);
    for (own, more) in scene.grid.shift_cells.iter_mut().zip(shift_cells) {
        *own += more;
    }
    scene
}
