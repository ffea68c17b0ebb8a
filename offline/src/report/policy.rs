//! How well the policy reaches its goals, and what it was trained on.

use super::PolicySection;
use super::page::{BASE, FINAL, NOISE, figure_svg};
use crate::evaluate::{Evaluation, MissSummary};
use crate::fit::FINER;
use crate::plot::{Mark, Panel, Scales, Series, interval};
use maud::{Markup, html};
use std::collections::BTreeMap;

/// Size of a figure, pixels.
const FIGURE_PX: (u32, u32) = (500, 430);
/// On what the answers were swung.
pub(super) const GRIDS: [&str; 2] = ["own grid", "finer grid"];
/// Bars of the histogram.
const BARS: usize = 20;

pub(super) fn section(policy: Option<&PolicySection>) -> Markup {
    html! {
        h2 { "Policy" }
        @match policy {
            None => p { "No policy was trained in this run." },
            Some(policy) => (shown(policy)),
        }
    }
}

fn shown(policy: &PolicySection) -> Markup {
    let evaluation = policy.evaluation;
    html! {
        @match &evaluation.miss {
            Some(miss) => (summary(miss, policy.finer.miss.as_ref())),
            None => p { "Every attempt was refused: nothing can be said about the policy." },
        }
        p { "Refused swings: " (refusals(&evaluation.refusals)) }
        @if !policy.finer.refusals.is_empty() {
            p { "Refused on the finer grid: " (refusals(&policy.finer.refusals)) }
        }
        @if evaluation.miss.is_some() {
            figure.grid.two { (figure_svg(&scatter(evaluation, policy.finer))) (figure_svg(&misses(evaluation))) }
        }
        (training(policy))
        @if let Some(blob) = policy.blob {
            h3 { "Frozen policy" }
            pre { (blob.to_string()) }
        }
    }
}

fn summary(own: &MissSummary, finer: Option<&MissSummary>) -> Markup {
    type Figure = (&'static str, fn(&MissSummary) -> String);
    let figures: [Figure; 6] = [
        ("mean ± spread, mm", |m| {
            format!("{:.1} ± {:.1}", m.mean_mm, m.spread_mm)
        }),
        ("median, mm", |m| format!("{:.1}", m.median_mm)),
        ("90th percentile, mm", |m| format!("{:.1}", m.p90_mm)),
        ("largest, mm", |m| format!("{:.1}", m.max_mm)),
        ("mean ± spread, paper’s units", |m| {
            format!("{:.4} ± {:.4}", m.mean_paper, m.spread_paper)
        }),
        ("swings", |m| m.count.to_string()),
    ];
    html! {
        table {
            tr { th { "|goal − reached|" } @for grid in GRIDS { th.n { (grid) } } }
            @for (name, figure) in figures {
                tr {
                    td { (name) }
                    td.n { (figure(own)) }
                    td.n { (finer.map_or("–".to_owned(), figure)) }
                }
            }
        }
        p.quiet {
            "The policy learnt on its own grid. The same answers were swung on one finer by " (FINER)
            ": what is more there is the simulator’s own error, and a part of what a real rope will show."
        }
    }
}

fn refusals(refusals: &BTreeMap<String, usize>) -> String {
    if refusals.is_empty() {
        return "none.".to_owned();
    }
    let listed: Vec<String> = refusals.iter().map(|(why, n)| format!("{n} × {why}")).collect();
    format!("{}.", listed.join("; "))
}

/// Goal and reach of every scored attempt, and its Young's modulus.
fn scored(evaluation: &Evaluation) -> Vec<(f64, f64, f64)> {
    let attempts = evaluation.attempts.iter();
    attempts
        .filter_map(|a| Some((a.goal.goal_x_m, *a.reached_m.as_ref().ok()?, a.goal.young_pa)))
        .collect()
}

fn series(colour: crate::plot::Colour, mark: Mark, points: Vec<[f64; 2]>) -> Series {
    Series {
        label: String::new(),
        colour,
        mark,
        points,
    }
}

fn scatter(own: &Evaluation, finer: &Evaluation) -> Panel {
    let [own, finer] = [own, finer].map(scored);
    let all = interval(own.iter().chain(&finer).flat_map(|s| [s.0, s.1]), 0.05, 0.02);
    let of_grid = |k: usize, colour, scored: &[(f64, f64, f64)]| Series {
        label: GRIDS[k].to_owned(),
        ..series(colour, Mark::Dots(2), scored.iter().map(|s| [s.0, s.1]).collect())
    };
    Panel {
        title: "Goal and reach".to_owned(),
        x_label: "goal x [m]".to_owned(),
        y_label: "reached x [m]".to_owned(),
        x: all.clone(),
        y: all.clone(),
        scales: Scales::Equal,
        size_px: FIGURE_PX,
        series: vec![
            series(NOISE, Mark::Line(1), vec![[all.start; 2], [all.end; 2]]),
            of_grid(1, BASE, &finer),
            of_grid(0, FINAL, &own),
        ],
    }
}

/// Misses over Young's modulus; their histogram where there is only one rope.
pub(super) fn misses(evaluation: &Evaluation) -> Panel {
    let scored = scored(evaluation);
    let mm: Vec<f64> = scored.iter().map(|s| 1e3 * (s.1 - s.0).abs()).collect();
    let highest = mm.iter().copied().fold(0.1, f64::max);
    let one_rope = scored.iter().all(|s| s.2 == scored[0].2);
    let (x_label, y_label, x, data) = if one_rope {
        let mut counts = [0usize; BARS];
        for value in &mm {
            counts[((value / highest * BARS as f64) as usize).min(BARS - 1)] += 1;
        }
        let width = highest / BARS as f64;
        let step = |(k, &n): (usize, &usize)| {
            let left = k as f64 * width;
            [[left, n as f64], [left + width, n as f64]]
        };
        let area = counts.iter().enumerate().flat_map(step).collect();
        (
            "|goal − reached| [mm]",
            "swings",
            0.0..highest,
            series(FINAL, Mark::Area, area),
        )
    } else {
        let points: Vec<[f64; 2]> = scored.iter().zip(&mm).map(|(s, &mm)| [1e-6 * s.2, mm]).collect();
        let range = interval(points.iter().map(|p| p[0]), 0.03, 0.01);
        (
            "E [MPa]",
            "|goal − reached| [mm]",
            range,
            series(FINAL, Mark::Dots(2), points),
        )
    };
    let top = data.points.iter().map(|p| p[1]).fold(0.1, f64::max);
    Panel {
        title: if one_rope {
            "Histogram of misses"
        } else {
            "Misses over Young's modulus"
        }
        .to_owned(),
        x_label: x_label.to_owned(),
        y_label: y_label.to_owned(),
        x,
        y: 0.0..1.05 * top,
        scales: Scales::Free,
        size_px: FIGURE_PX,
        series: vec![data],
    }
}

fn training(policy: &PolicySection) -> Markup {
    let (record, dataset) = (policy.record, policy.dataset);
    html! {
        h3 { "Training" }
        p {
            (format!("{} rollouts, {} with a score. Refused: ", dataset.rollouts, dataset.scored))
            (refusals(&dataset.refusals))
        }
        table {
            tr {
                th { "after" } th.n { "forward model, training [mm]" } th.n { "forward model, held back [mm]" }
                th.n { "answers missed by [mm]" }
            }
            @for (round, errors) in record.forward.iter().enumerate() {
                tr {
                    td { @if round == 0 { "random design" } @else { "round " (round) } }
                    td.n { (format!("{:.2}", errors.training_rms_mm)) }
                    td.n { (format!("{:.2}", errors.validation_rms_mm)) }
                    td.n { @match round.checked_sub(1).and_then(|r| record.round_miss_mm.get(r)) {
                        Some(Some(mm)) => (format!("{mm:.2}")),
                        Some(None) => "all refused",
                        None => "",
                    } }
                }
            }
        }
    }
}
