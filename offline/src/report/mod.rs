//! One self-contained HTML page with everything that a run found: no script, no network.

mod answer;
mod force;
mod maps;
mod next;
mod overlay;
mod page;
mod policy;
mod ranking;
mod residuals;
mod tables;
mod view;

pub use tables::tables;
pub use view::{DemoView, views};

use crate::collect::DatasetSummary;
use crate::demo::Demo;
use crate::diagnose::{Advice, Outcome, ResidualForce};
use crate::evaluate::Evaluation;
use crate::fit::Profile;
use crate::inspect::BlobReport;
use crate::trained::TrainingRecord;
use maud::html as markup;

/// What a report shows.
pub struct ReportInput<'a> {
    /// Title of the page.
    pub title: &'a str,
    /// Demonstrations that were fitted.
    pub demos: &'a [&'a Demo],
    /// Demonstrations that were held out.
    pub held_out: &'a [&'a Demo],
    /// What the loop found.
    pub outcome: &'a Outcome,
    /// 95 % intervals of the final model's parameters by profile likelihood; empty where nobody asked for them.
    pub profiles: &'a [Profile],
    /// What is left, as a force; none where it is explained.
    pub residual_force: Option<&'a ResidualForce>,
    /// What to do next, and what matters for the swing.
    pub advice: &'a Advice,
    /// The base model on every demonstration, fitted ones first.
    pub before: &'a [DemoView],
    /// The final model on the same demonstrations in the same order.
    pub after: &'a [DemoView],
    /// The policy, where one was trained and evaluated.
    pub policy: Option<PolicySection<'a>>,
    /// Command, seed, version, wall time and the like, in the order in which they are shown.
    pub provenance: &'a [(String, String)],
}

/// What a report shows of a policy.
pub struct PolicySection<'a> {
    /// Swings of its answers.
    pub evaluation: &'a Evaluation,
    /// The same on a finer grid.
    pub finer: &'a Evaluation,
    /// How its training went.
    pub record: &'a TrainingRecord,
    /// What it was trained on.
    pub dataset: &'a DatasetSummary,
    /// The frozen file, where there is one.
    pub blob: Option<&'a BlobReport>,
}

/// The report as the text of an HTML file.
pub fn html(input: &ReportInput) -> String {
    let body = markup! {
        (answer::section(input))
        (overlay::section(input))
        (residuals::section(input))
        (ranking::section(&input.outcome.rounds))
        (force::section(input.residual_force))
        (next::section(input.advice))
        (policy::section(input.policy.as_ref()))
        (page::provenance(input))
    };
    page::page(input.title, &body)
}

#[cfg(test)]
mod tests;
