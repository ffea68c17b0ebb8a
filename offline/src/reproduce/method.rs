//! The estimators of the tables under one roof: a case in, estimates out.

use super::adam::{Parameters, Rates};
use super::data::{STARTS, draw};
use super::gradient::{Descent, Steps};
use super::ours::{Fitted, Predicted, fit_clouds};
use crate::demo::{Demo, Observations};
use crate::observe::Section;
use crate::sim::Scene;
use anyhow::Context;
use serde::{Deserialize, Serialize};

/// Something to estimate from.
pub struct Case {
    /// Name for messages.
    pub name: String,
    /// The scene as the fitter simulates it.
    pub scene: Scene,
    /// What was seen.
    pub demo: Demo,
    /// Which points of the rope the clouds hold.
    pub section: Section,
    /// The truth, where it is known.
    pub truth: Option<Parameters>,
    /// The last state that an estimate's is compared with, m.
    pub last_m: Vec<[f64; 3]>,
}

impl Case {
    /// Clouds of the demonstration, m; labelled points count as clouds.
    pub fn clouds_m(&self) -> Vec<Vec<[f64; 3]>> {
        match &self.demo.observations {
            Observations::Clouds(frames) => frames.iter().map(|f| f.points_m.clone()).collect(),
            Observations::Markers(samples) => {
                let at = |t_s: f64| samples.iter().filter(move |m| m.t_s == t_s);
                let times = self.demo.times_s();
                times
                    .iter()
                    .map(|&t_s| at(t_s).map(|m| m.position_m).collect())
                    .collect()
            }
        }
    }
}

/// Whose step sizes Adam takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StepSizes {
    /// The paper's text.
    Paper,
    /// The released code.
    Released,
}

/// A row of the tables, or two where a method reports two iterates.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// Gradient descent on grid densities.
    Gradient {
        /// States that the loss compares.
        steps: Steps,
        /// Step sizes.
        sizes: StepSizes,
    },
    /// Our fit.
    Ours,
}

/// The methods that need no training, in the order of the tables.
pub const METHODS: [Method; 5] = [
    gradient(Steps::All, StepSizes::Released),
    gradient(Steps::Last, StepSizes::Released),
    gradient(Steps::All, StepSizes::Paper),
    gradient(Steps::Last, StepSizes::Paper),
    Method::Ours,
];

const fn gradient(steps: Steps, sizes: StepSizes) -> Method {
    Method::Gradient { steps, sizes }
}

/// How much a method does.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Effort {
    /// Adam's steps.
    pub iterations: usize,
    /// Starts of our fit.
    pub starts: u64,
    /// Seed of the starts.
    pub seed: u64,
    /// Whether ν moves as slowly as the released code lets it in real2sim.
    pub real: bool,
}

/// One estimate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Estimated {
    /// The row that it belongs to.
    pub row: String,
    /// E in paper units and ν.
    pub parameters: Parameters,
    /// What our fit says besides.
    pub fit: Option<Fitted>,
}

impl Method {
    /// A short name for files.
    pub fn slug(self) -> &'static str {
        match self {
            Self::Gradient { steps, sizes } => match (steps, sizes) {
                (Steps::All, StepSizes::Released) => "gradient-all-released",
                (Steps::Last, StepSizes::Released) => "gradient-last-released",
                (Steps::All, StepSizes::Paper) => "gradient-all-paper",
                (Steps::Last, StepSizes::Paper) => "gradient-last-paper",
            },
            Self::Ours => "ours",
        }
    }

    /// Name of the row, without the iterate.
    fn title(self) -> &'static str {
        match self {
            Self::Gradient { steps, sizes } => match (steps, sizes) {
                (Steps::All, StepSizes::Released) => "gradient, all steps, E step 100 (code)",
                (Steps::Last, StepSizes::Released) => "gradient, last step, E step 100 (code)",
                (Steps::All, StepSizes::Paper) => "gradient, all steps, E step 10 (paper)",
                (Steps::Last, StepSizes::Paper) => "gradient, last step, E step 10 (paper)",
            },
            Self::Ours => "ours",
        }
    }

    /// Names of the rows that [`Method::estimate`] fills.
    pub fn rows(self) -> Vec<String> {
        match self {
            Self::Gradient { .. } => ["last iterate", "best iterate"]
                .map(|iterate| format!("{}, {iterate}", self.title()))
                .to_vec(),
            Self::Ours => vec![self.title().into()],
        }
    }

    /// Estimates the parameters of the rope of a case. `index` numbers the random start.
    ///
    /// # Errors
    /// A simulation stopped, or too little was seen.
    pub fn estimate(self, case: &Case, effort: &Effort, index: u64) -> anyhow::Result<Vec<Estimated>> {
        let rows = self.rows();
        let plain = |row: &String, parameters| Estimated {
            row: row.clone(),
            parameters,
            fit: None,
        };
        match self {
            Self::Gradient { steps, sizes } => {
                let friction = case.demo.spec.friction();
                let descent = Descent::new(&case.scene, friction, &case.clouds_m(), steps);
                let start = draw(STARTS, effort.seed, index);
                let found = descent
                    .run(start, rates(sizes, effort.real), effort.iterations)
                    .with_context(|| format!("{}: {}", case.name, self.title()))?;
                Ok(vec![plain(&rows[0], found.last), plain(&rows[1], found.best)])
            }
            Self::Ours => {
                let starts = (effort.seed.wrapping_add(index), effort.starts);
                let fit = fit_clouds(&case.demo, &case.scene, case.section, starts, Predicted::OwnGrid)?;
                Ok(vec![Estimated {
                    row: rows[0].clone(),
                    parameters: fit.parameters,
                    fit: Some(fit),
                }])
            }
        }
    }
}

fn rates(sizes: StepSizes, real: bool) -> Rates {
    match (sizes, real) {
        (StepSizes::Paper, false) => Rates::PAPER,
        (StepSizes::Paper, true) => Rates::PAPER_REAL,
        (StepSizes::Released, false) => Rates::RELEASED,
        (StepSizes::Released, true) => Rates::RELEASED_REAL,
    }
}
