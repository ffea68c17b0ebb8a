//! Measured and simulated rope from the side, at a few times.

use super::page::{BASE, FINAL, MEASURED, dot, figure_svg, key};
use super::{DemoView, ReportInput};
use crate::demo::{Demo, Observations};
use crate::plot::{FAINT, FRAME_PX, Mark, Panel, Scales, Series, interval};
use maud::{Markup, html};
use std::ops::Range;

/// How many instants are shown of each demonstration.
const SHOWN: usize = 6;
/// Most measured points in the whole report, and in one panel.
const MAX_DOTS: usize = 9000;
const MAX_PANEL_DOTS: usize = 300;
/// Width of a panel and the least and largest height of its plotting area, pixels.
const WIDTH_PX: u32 = 350;
const HEIGHT_PX: Range<f64> = 110.0..270.0;

pub(super) fn section(input: &ReportInput) -> Markup {
    let demos: Vec<&Demo> = input.demos.iter().chain(input.held_out).copied().collect();
    let panels = (SHOWN * demos.len()).max(1);
    let dots = (MAX_DOTS / panels).clamp(20, MAX_PANEL_DOTS);
    html! {
        h2 { "Measured and simulated rope" }
        p {
            "From the side, same scale along both axes. Points lie on the surface that the cameras see, lines are "
            "the axis of the rope." br;
            (dot(MEASURED, "measured")) (key(BASE, "base model")) (key(FINAL, "final model"))
            (key(FAINT, "table"))
        }
        @for (demo, (before, after)) in demos.iter().zip(input.before.iter().zip(input.after)) {
            figure {
                figcaption { b { (after.name) } (if after.held_out { " (held out)" } else { " (fitted)" }) }
                div.grid.three {
                    @for panel in panels_of(demo, before, after, dots) { (figure_svg(&panel)) }
                }
            }
        }
    }
}

/// About [`SHOWN`] frames, evenly chosen, the first and the last among them.
pub(super) fn frames_shown(frames: usize) -> Vec<usize> {
    let last = frames.saturating_sub(1);
    let mut shown: Vec<usize> = (0..SHOWN)
        .map(|k| (k * last + (SHOWN - 1) / 2) / (SHOWN - 1))
        .collect();
    shown.dedup();
    shown.retain(|&frame| frame < frames);
    shown
}

fn panels_of(demo: &Demo, before: &DemoView, after: &DemoView, dots: usize) -> Vec<Panel> {
    let shown = frames_shown(after.times_s.len().min(before.times_s.len()));
    let height_m = demo.spec.table.as_ref().map(|table| table.height_m);
    let mut panels: Vec<Panel> = shown
        .iter()
        .map(|&frame| Panel {
            title: format!("t = {:.2} s", after.times_s[frame]),
            x_label: "x [m]".to_owned(),
            y_label: "z [m]".to_owned(),
            x: 0.0..1.0,
            y: 0.0..1.0,
            scales: Scales::Equal,
            size_px: (WIDTH_PX, 0),
            series: vec![
                series(
                    MEASURED,
                    Mark::Dots(1),
                    measured(demo, after.times_s[frame], dots),
                ),
                series(BASE, Mark::Line(2), side(&before.centrelines_m[frame])),
                series(FINAL, Mark::Line(2), side(&after.centrelines_m[frame])),
            ],
        })
        .collect();
    let values = |k: usize| {
        let series = panels.iter().flat_map(|panel| &panel.series);
        let values = series.flat_map(move |one| one.points.iter().map(move |p| p[k]));
        values.collect::<Vec<f64>>()
    };
    let least = 4.0 * demo.spec.rope.diameter_m;
    let mut x = interval(values(0), 0.05, least);
    let mut y = interval(values(1), 0.05, least);
    // Close to the table the table belongs in the picture.
    let near = height_m.filter(|height_m| y.start - height_m < 0.3 * (y.end - y.start));
    if let Some(height_m) = near {
        y.start = y.start.min(height_m - 0.03 * (y.end - y.start));
    }
    let across = f64::from(WIDTH_PX - FRAME_PX.0);
    let scale = ((x.end - x.start) / across).max((y.end - y.start) / HEIGHT_PX.end);
    let up = ((y.end - y.start) / scale).clamp(HEIGHT_PX.start, HEIGHT_PX.end);
    widen(&mut x, scale * across);
    widen(&mut y, scale * up);
    let table = height_m
        .filter(|height_m| y.contains(height_m))
        .map(|height_m| series(FAINT, Mark::Line(1), vec![[x.start, height_m], [x.end, height_m]]));
    for panel in &mut panels {
        (panel.x, panel.y) = (x.clone(), y.clone());
        panel.size_px.1 = FRAME_PX.1 + up.round() as u32;
        if let Some(table) = &table {
            panel.series.insert(0, table.clone());
        }
    }
    panels
}

fn widen(range: &mut Range<f64>, length: f64) {
    let middle = 0.5 * (range.start + range.end);
    *range = middle - 0.5 * length..middle + 0.5 * length;
}

fn series(colour: crate::plot::Colour, mark: Mark, points: Vec<[f64; 2]>) -> Series {
    Series {
        label: String::new(),
        colour,
        mark,
        points,
    }
}

fn side(line_m: &[[f64; 3]]) -> Vec<[f64; 2]> {
    // A point every few pixels: more of them, each on a whole pixel, would make the line wobble.
    const POINTS: usize = 32;
    let last = line_m.len().saturating_sub(1);
    let points = POINTS.min(line_m.len());
    (0..points)
        .map(|k| line_m[k * last / (points - 1).max(1)])
        .map(|p| [p[0], p[2]])
        .collect()
}

/// At most `dots` of the points measured at a time, evenly taken.
pub(super) fn measured(demo: &Demo, t_s: f64, dots: usize) -> Vec<[f64; 2]> {
    let points: Vec<[f64; 3]> = match &demo.observations {
        Observations::Clouds(frames) => frames
            .iter()
            .min_by(|a, b| (a.t_s - t_s).abs().total_cmp(&(b.t_s - t_s).abs()))
            .map(|frame| frame.points_m.clone())
            .unwrap_or_default(),
        Observations::Markers(samples) => {
            let now = samples.iter().filter(|sample| sample.t_s == t_s);
            now.map(|sample| sample.position_m).collect()
        }
    };
    let count = points.len().min(dots);
    (0..count)
        .map(|k| points[k * points.len() / count])
        .map(|p| [p[0], p[2]])
        .collect()
}
