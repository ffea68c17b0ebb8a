//! The verification suite: the simulator against what is known exactly, one file per family of cases.
//!
//! Every tolerance is a constant that was fixed before the first result, from the order of the scheme or
//! from what the program promises, and stays where it is when a case misses it. `offline verify` prints the table, writes the plots and fails when a case does.

mod beams;
mod case;
mod clamps;
mod contact;
mod golden;
mod invariance;
mod motion;
mod plots;
pub mod random;
pub mod reference;
mod section;
pub mod setup;
mod stepper;
mod stops;
mod study;
mod vibration;

pub use case::{Case, Report, table};
pub use plots::panels;
pub use stepper::{Stepper, matrix, rows};
pub use study::{ALIGNMENTS, Point, Study};

use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// How much is verified.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extent {
    /// Every family on the coarsest grid, at four alignments: seconds.
    Quick,
    /// Three grid spacings and four alignments to the grid for everything elastic: minutes.
    Full,
}

/// What one family says.
#[derive(Default)]
pub struct Findings {
    /// Cases with a verdict.
    pub cases: Vec<Case>,
    /// Convergence studies.
    pub studies: Vec<Study>,
}

impl From<Vec<Case>> for Findings {
    fn from(cases: Vec<Case>) -> Self {
        Self {
            cases,
            studies: Vec::new(),
        }
    }
}

type Family = fn(Extent) -> Findings;

/// The families in the order of the table.
const FAMILIES: [Family; 8] = [
    motion::verify,
    beams::verify,
    vibration::verify,
    contact::verify,
    clamps::verify,
    invariance::verify,
    golden::verify,
    stops::verify,
];

/// Runs all families on all threads, and tells of each that is done.
pub fn verify(extent: Extent, progress: &(dyn Fn(&str) + Sync)) -> Report {
    let mut report = Report::default();
    let done = AtomicUsize::new(0);
    let run = |family: &Family| {
        let found = family(extent);
        let number = done.fetch_add(1, Ordering::Relaxed) + 1;
        let failed = found.cases.iter().filter(|case| !case.passed).count();
        progress(&format!(
            "{number} of {} families: {}, {} cases, {failed} failed",
            FAMILIES.len(),
            found.cases.first().map_or("nothing", |case| case.family),
            found.cases.len()
        ));
        found
    };
    let findings: Vec<Findings> = FAMILIES.par_iter().map(run).collect();
    for found in findings {
        report.cases.extend(found.cases);
        report.studies.extend(found.studies);
    }
    report
}
