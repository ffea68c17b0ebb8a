//! `tables.md`: the figures of a run as tables of plain text.

use super::answer::{in_paper_units, interval};
use super::page::{effect_title, parameter_title};
use super::policy::GRIDS;
use super::ranking::{outcome, refit};
use crate::demo::Demo;
use crate::diagnose::{Outcome, Round};
use crate::evaluate::Evaluation;
use crate::fit::{Profile, estimates};
use crate::model::{Estimate, Structure};
use crate::residual::ResidualSummary;
use crate::words::{unit, with_error};
use std::fmt::Write as _;

/// The tables of a run; those of the policy where one was evaluated, on its own grid and on a finer one.
pub fn tables(
    title: &str,
    demos: &[&Demo],
    (outcome, profiles): (&Outcome, &[Profile]),
    policy: Option<[&Evaluation; 2]>,
) -> String {
    let density = demos.first().map(|demo| demo.spec.rope.density_kg_m3());
    let mut text = format!("# {title}\n\n{}\n\n", outcome.verdict);
    text += &parameters((outcome, profiles), density);
    text += &errors(outcome);
    text += &effects(&outcome.rounds);
    if let Some(evaluations) = policy {
        text += &miss(evaluations);
    }
    text
}

/// A heading, a head of a table and its rows.
fn table(heading: &str, head: &[&str], rows: &[Vec<String>]) -> String {
    let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
    let head: Vec<String> = head.iter().map(ToString::to_string).collect();
    let rule = vec!["---".to_owned(); head.len()];
    let mut text = format!("## {heading}\n\n{}{}", line(&head), line(&rule));
    for row in rows {
        text += &line(row);
    }
    text.push('\n');
    text
}

fn parameters((outcome, profiles): (&Outcome, &[Profile]), density_kg_m3: Option<f64>) -> String {
    let base = estimates(&outcome.base.best, &Structure::default());
    let value = |e: &Estimate| {
        let identified = if e.identified { "" } else { " (not identified)" };
        format!("{}{identified}", with_error(e.value, e.standard_error))
    };
    let rows: Vec<Vec<String>> = outcome
        .estimates()
        .iter()
        .map(|found| {
            let before = base.iter().find(|e| e.name == found.name);
            let interval = (!profiles.is_empty()).then(|| interval(found, 1.0, profiles).unwrap_or_default());
            let mut row = vec![
                parameter_title(&found.name, &found.unit),
                before.map_or_else(String::new, value),
                value(found),
            ];
            row.extend(interval);
            row.extend([
                unit(&found.unit).to_owned(),
                in_paper_units(found, density_kg_m3).unwrap_or_default(),
            ]);
            row
        })
        .collect();
    let mut head = vec!["parameter", "base model", "final model"];
    head.extend((!profiles.is_empty()).then_some("95 % interval"));
    head.extend(["unit", "final, paper's units"]);
    table("Parameters", &head, &rows)
}

fn errors(outcome: &Outcome) -> String {
    let row = |place: &str, before: &ResidualSummary, after: &ResidualSummary| {
        let figures = |s: &ResidualSummary| [format!("{:.2}", s.rms_mm), format!("{:.1}", s.floors)];
        let [before_mm, before_floors] = figures(before);
        let [after_mm, after_floors] = figures(after);
        let floor = format!("{:.2}", after.floor_mm);
        vec![
            place.to_owned(),
            before_mm,
            before_floors,
            after_mm,
            after_floors,
            floor,
        ]
    };
    let of = ResidualSummary::of;
    let rows = [
        row("where fitted", &of(&outcome.base.best), &of(&outcome.fitted.best)),
        row(
            "held out",
            &of(&outcome.held_out_before),
            &of(&outcome.held_out_after),
        ),
    ];
    let head = [
        "",
        "before, mm",
        "floors",
        "after, mm",
        "floors",
        "noise floor, mm",
    ];
    table("Error before and after", &head, &rows)
}

/// Every score of every round, and what became of it.
fn effects(rounds: &[Round]) -> String {
    let of_round = |(number, round): (usize, &Round)| -> Vec<Vec<String>> {
        let scores = round.table.scores.iter();
        scores
            .map(|score| {
                let left = refit(round, std::slice::from_ref(&score.id))
                    .map_or_else(String::new, |r| format!("{:.2}", r.held_out.rms_mm));
                vec![
                    (number + 1).to_string(),
                    effect_title(&score.id).to_owned(),
                    format!("{:.0}", score.statistic),
                    format!("{:.0}", score.threshold),
                    left,
                    outcome(round, score).to_owned(),
                ]
            })
            .collect()
    };
    let rows: Vec<Vec<String>> = rounds.iter().enumerate().flat_map(of_round).collect();
    let head = [
        "round",
        "effect",
        "score",
        "threshold",
        "leaves held out, mm",
        "outcome",
    ];
    table("Effects", &head, &rows)
}

fn miss(evaluations: [&Evaluation; 2]) -> String {
    let grids = GRIDS.into_iter().zip(evaluations);
    let rows = grids.clone().filter_map(|(grid, evaluation)| {
        let m = evaluation.miss.as_ref()?;
        Some(vec![
            grid.to_owned(),
            m.count.to_string(),
            format!("{:.1} ± {:.1}", m.mean_mm, m.spread_mm),
            format!("{:.1}", m.median_mm),
            format!("{:.1}", m.p90_mm),
            format!("{:.1}", m.max_mm),
            format!("{:.4} ± {:.4}", m.mean_paper, m.spread_paper),
        ])
    });
    let head = [
        "grid",
        "n",
        "mean ± spread, mm",
        "median",
        "90th percentile",
        "largest",
        "mean, paper's units",
    ];
    let mut text = table("Policy: |goal − reached|", &head, &rows.collect::<Vec<_>>());
    for (grid, evaluation) in grids {
        for (reason, count) in &evaluation.refusals {
            let _ = writeln!(text, "- refused, {grid}: {count} ({reason})");
        }
    }
    text
}
