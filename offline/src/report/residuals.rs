//! What each model leaves unexplained: maps over arc length and time, and curves over time.

use super::maps::{Scale, triple};
use super::page::{BASE, FINAL, NOISE, figure_svg, key};
use super::{DemoView, ReportInput};
use crate::plot::{Mark, Panel, Scales, Series};
use maud::{Markup, html};

/// Most fitted demonstrations whose maps are shown, and most held-out ones.
const MAX_MAPS: usize = 3;
/// Size of a panel of curves, pixels.
const CURVE_PX: (u32, u32) = (530, 260);

pub(super) fn section(input: &ReportInput) -> Markup {
    let pairs: Vec<(&DemoView, &DemoView)> = input.before.iter().zip(input.after).collect();
    let whole = !input.held_out.is_empty();
    let mapped = mapped(&pairs);
    let both = Scale::over(mapped.iter().flat_map(|(before, after)| [*before, *after]));
    let own = Scale::over(mapped.iter().map(|(_, after)| *after));
    html! {
        h2 { "What the models leave unexplained" }
        p {
            "Distance between the measured and the simulated axis of the rope, across the rope. The maps of both models have "
            "the same colour scale, which ends at the 99th percentile; the last shows the final model on a scale of its "
            "own. Grey is where nothing was seen."
        }
        @for (before, after) in &mapped {
            figure { figcaption { b { (after.name) } (role(after, whole)) } (triple(before, after, both, own)) }
        }
        h3 { "Error over time" }
        p {
            "Root mean square per direction over the rope." br;
            (key(BASE, "base model")) (key(FINAL, "final model")) (key(NOISE, "noise floor"))
        }
        figure.grid.two { @for panel in curves(&pairs, whole) { (figure_svg(&panel)) } }
        @if input.held_out.is_empty() {
            p.quiet {
                "No demonstration was held out: of each three tenths of the frames in motion were, in three blocks, the last "
                "among them, or every third pose at rest. The errors here are of all frames."
            }
        }
    }
}

/// What a demonstration was used for; a part of each judges where none was held out, and the others are fitted whole.
fn role(view: &DemoView, whole: bool) -> &'static str {
    match (view.held_out, whole) {
        (true, _) => " (held out)",
        (false, true) => " (fitted)",
        (false, false) => " (a part fitted, a part held out)",
    }
}

/// The first fitted demonstrations, and the held-out ones that the final model predicts worst.
fn mapped<'a>(pairs: &[(&'a DemoView, &'a DemoView)]) -> Vec<(&'a DemoView, &'a DemoView)> {
    let fitted = pairs.iter().filter(|(_, after)| !after.held_out).take(MAX_MAPS);
    let square = |view: &DemoView| {
        let seen: Vec<f64> = view.rms_mm.iter().flatten().map(|mm| mm * mm).collect();
        seen.iter().sum::<f64>() / seen.len().max(1) as f64
    };
    let mut held_out: Vec<_> = pairs
        .iter()
        .filter(|(_, after)| after.held_out)
        .enumerate()
        .collect();
    held_out.sort_by(|a, b| square(b.1.1).total_cmp(&square(a.1.1)));
    held_out.truncate(MAX_MAPS);
    held_out.sort_by_key(|(place, _)| *place);
    let held_out = held_out.into_iter().map(|(_, pair)| pair);
    fitted.chain(held_out).copied().collect()
}

fn curves(pairs: &[(&DemoView, &DemoView)], whole: bool) -> Vec<Panel> {
    let shown = pairs.iter().flat_map(|(before, after)| [before, after]);
    let highest = shown
        .flat_map(|view| view.rms_mm.iter().flatten())
        .fold(0.1, |high: f64, &mm| high.max(mm));
    // A third of the smallest floor: beneath it there is nothing to see.
    let floors = pairs
        .iter()
        .flat_map(|(_, after)| after.floor_mm.iter().flatten());
    let lowest = floors.fold(highest, |low: f64, &mm| low.min(mm)) / 3.0;
    pairs
        .iter()
        .map(|(before, after)| Panel {
            title: format!("{}{}", after.name, role(after, whole)),
            x_label: "time [s]".to_owned(),
            y_label: "error [mm]".to_owned(),
            x: after.times_s.first().copied().unwrap_or(0.0)
                ..after.times_s.last().copied().unwrap_or(0.0).max(1e-3),
            y: lowest..1.3 * highest,
            scales: Scales::DecadesUp,
            size_px: CURVE_PX,
            series: vec![
                curve(NOISE, 2, &after.times_s, &after.floor_mm),
                curve(BASE, 2, &before.times_s, &before.rms_mm),
                curve(FINAL, 2, &after.times_s, &after.rms_mm),
            ],
        })
        .collect()
}

fn curve(colour: crate::plot::Colour, width: u32, times_s: &[f64], values: &[Option<f64>]) -> Series {
    let points = times_s.iter().zip(values);
    Series {
        label: String::new(),
        colour,
        mark: Mark::Line(width),
        points: points.filter_map(|(&t, mm)| mm.map(|mm| [t, mm])).collect(),
    }
}
