//! Residual maps over arc length and time, drawn as SVG: two on one colour scale, and the second on its own.

use super::DemoView;
use super::page::hex;
use crate::plot::ramp;
use crate::residual::ResidualMap;
use crate::sim::tensor::norm;
use maud::{Markup, PreEscaped, html};
use std::fmt::Write;

/// Steps of the colour scale.
const STEPS: usize = 40;
/// Most columns of a map; more frames than these are taken together.
const MAX_COLUMNS: usize = 240;
/// Where nothing was seen.
const UNSEEN: &str = "#ececec";

const WIDTH: f64 = 1000.0;
const HEIGHT: f64 = 250.0;
const MAP_WIDTH: f64 = 222.0;
const MAP_HEIGHT: f64 = 180.0;
const MAP_TOP: f64 = 26.0;
const MAP_LEFT: [f64; 3] = [52.0, 340.0, 698.0];
/// Of each scale's bar: beside the second and the third map.
const BAR_LEFT: [f64; 2] = [576.0, 934.0];

/// A colour scale from zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Scale {
    /// Residual at the end of the scale, mm.
    pub end_mm: f64,
}

impl Scale {
    /// One scale for all maps: up to the 99th percentile of everything shown, so that a single
    /// outlier does not darken all the rest.
    pub(super) fn over<'a>(views: impl Iterator<Item = &'a DemoView>) -> Self {
        let mut all: Vec<f64> = views
            .flat_map(|view| view.residual.offsets_mm.iter().flatten().flatten())
            .map(|&offset_mm| norm(offset_mm))
            .collect();
        all.sort_by(f64::total_cmp);
        let end = all.get(((all.len() as f64 * 0.99) as usize).min(all.len().saturating_sub(1)));
        let end = end.copied().unwrap_or(1.0).max(0.1);
        let step = 10f64.powf(end.log10().floor()) / 2.0;
        Self {
            end_mm: (end / step).ceil() * step,
        }
    }

    fn step_of(self, mm: f64) -> usize {
        ((mm / self.end_mm * STEPS as f64) as usize).min(STEPS - 1)
    }
}

fn colour(step: usize) -> String {
    hex(ramp((step as f64 + 0.5) / STEPS as f64))
}

/// The maps of one demonstration on the scale of both models and on that of the second alone, and the bars of both scales.
pub(super) fn triple(before: &DemoView, after: &DemoView, both: Scale, own: Scale) -> Markup {
    let mut body = String::new();
    let maps = [
        (before, both, "base model"),
        (after, both, "final model"),
        (after, own, "final model, own scale"),
    ];
    for ((view, scale, title), left) in maps.into_iter().zip(MAP_LEFT) {
        let _ = write!(
            body,
            "<g transform=\"translate({left} {MAP_TOP})\"><text x=\"0\" y=\"-9\" font-size=\"14\">{title}</text>"
        );
        map(&mut body, &view.residual, scale);
        axes(&mut body, &view.residual);
        body.push_str("</g>");
    }
    for (scale, left) in [both, own].into_iter().zip(BAR_LEFT) {
        bar(&mut body, scale, left);
    }
    html! {
        svg viewBox=(format!("0 0 {WIDTH} {HEIGHT}")) width=(WIDTH) height=(HEIGHT) role="img"
            font-family="system-ui,sans-serif" font-size="12" fill="#333" {
            (PreEscaped(body))
        }
    }
}

/// Borders of cells whose centres are given: half way between them.
fn borders(centres: &[f64]) -> Vec<f64> {
    let n = centres.len();
    if n < 2 {
        let centre = centres.first().copied().unwrap_or(0.0);
        return vec![centre - 0.5, centre + 0.5];
    }
    let first = 1.5 * centres[0] - 0.5 * centres[1];
    let last = 1.5 * centres[n - 1] - 0.5 * centres[n - 2];
    std::iter::once(first)
        .chain(centres.windows(2).map(|pair| 0.5 * (pair[0] + pair[1])))
        .chain([last])
        .collect()
}

/// Share of the way from the first to the last border.
fn share(borders: &[f64], value: f64) -> f64 {
    let (first, last) = (borders[0], borders[borders.len() - 1]);
    (value - first) / (last - first)
}

/// The cells: one path per colour.
fn map(body: &mut String, residual: &ResidualMap, scale: Scale) {
    let _ = write!(
        body,
        "<rect width=\"{MAP_WIDTH}\" height=\"{MAP_HEIGHT}\" fill=\"{UNSEEN}\"/>"
    );
    let (times, arcs) = (borders(&residual.times_s), borders(&residual.arcs_m));
    let stride = residual.times_s.len().div_ceil(MAX_COLUMNS).max(1);
    let mut paths = vec![String::new(); STEPS];
    for (column, frames) in residual.offsets_mm.chunks(stride).enumerate() {
        let first = column * stride;
        let x = MAP_WIDTH * share(&times, times[first]);
        // A little into the next column, or pixels between the two stay empty.
        let width = MAP_WIDTH * share(&times, times[first + frames.len()]) - x + 0.4;
        for station in 0..residual.arcs_m.len() {
            let seen: Vec<f64> = frames
                .iter()
                .filter_map(|frame| frame.get(station)?.as_ref())
                .map(|offset| norm(*offset).powi(2))
                .collect();
            if seen.is_empty() {
                continue;
            }
            let mm = (seen.iter().sum::<f64>() / seen.len() as f64).sqrt();
            let top = MAP_HEIGHT * (1.0 - share(&arcs, arcs[station + 1]));
            let height = MAP_HEIGHT * (1.0 - share(&arcs, arcs[station])) - top;
            let _ = write!(
                paths[scale.step_of(mm)],
                "M{x:.1} {top:.1}h{width:.1}v{height:.1}h-{width:.1}z"
            );
        }
    }
    for (step, path) in paths.iter().enumerate().filter(|(_, path)| !path.is_empty()) {
        let _ = write!(
            body,
            "<path fill=\"{}\" shape-rendering=\"crispEdges\" d=\"{path}\"/>",
            colour(step)
        );
    }
}

/// Ticks and names of both axes.
fn axes(body: &mut String, residual: &ResidualMap) {
    let (times, arcs) = (borders(&residual.times_s), borders(&residual.arcs_m));
    for t in ticks(&times, 4) {
        let x = MAP_WIDTH * share(&times, t);
        let (y, text) = (MAP_HEIGHT + 16.0, short(t));
        let _ = write!(
            body,
            "<path stroke=\"#777\" d=\"M{x:.1} {MAP_HEIGHT}v4\"/><text x=\"{x:.1}\" y=\"{y}\" text-anchor=\"middle\">{text}</text>"
        );
    }
    for s in ticks(&arcs, 5) {
        let y = MAP_HEIGHT * (1.0 - share(&arcs, s));
        let (below, text) = (y + 4.0, short(s));
        let _ = write!(
            body,
            "<path stroke=\"#777\" d=\"M0 {y:.1}h-4\"/><text x=\"-7\" y=\"{below:.1}\" text-anchor=\"end\">{text}</text>"
        );
    }
    let (middle, low) = (0.5 * MAP_WIDTH, MAP_HEIGHT + 34.0);
    let (up, left) = (-0.5 * MAP_HEIGHT, -40.0);
    let _ = write!(
        body,
        "<text x=\"{middle}\" y=\"{low}\" text-anchor=\"middle\">time [s]</text>\
         <text transform=\"rotate(-90)\" x=\"{up}\" y=\"{left}\" text-anchor=\"middle\">arc length [m]</text>"
    );
}

/// Round values within the borders, at most about `most`.
fn ticks(borders: &[f64], most: usize) -> Vec<f64> {
    let (low, high) = (borders[0], borders[borders.len() - 1]);
    let rough = (high - low).max(1e-9) / most as f64;
    let power = 10f64.powf(rough.log10().floor());
    let factor = [1.0, 2.0, 5.0, 10.0].into_iter().find(|f| f * power >= rough);
    let step = factor.unwrap_or(10.0) * power;
    let first = (low / step).ceil() as i64;
    let last = (high / step).floor() as i64;
    (first..=last).map(|k| k as f64 * step).collect()
}

fn short(value: f64) -> String {
    let text = format!("{value:.3}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0" } else { text }.to_owned()
}

/// The bar of a colour scale.
fn bar(body: &mut String, scale: Scale, left: f64) {
    let _ = write!(body, "<g transform=\"translate({left} {MAP_TOP})\">");
    let height = MAP_HEIGHT / STEPS as f64;
    for step in 0..STEPS {
        let y = MAP_HEIGHT - (step + 1) as f64 * height;
        let _ = write!(
            body,
            "<rect y=\"{y:.1}\" width=\"16\" height=\"{:.1}\" fill=\"{}\" shape-rendering=\"crispEdges\"/>",
            height + 0.5,
            colour(step)
        );
    }
    for value in ticks(&[0.0, scale.end_mm], 5) {
        let y = MAP_HEIGHT * (1.0 - value / scale.end_mm);
        let text = short(value);
        let _ = write!(
            body,
            "<path stroke=\"#777\" d=\"M16 {y:.1}h4\"/><text x=\"24\" y=\"{:.1}\">{text}</text>",
            y + 4.0
        );
    }
    body.push_str("<text x=\"-12\" y=\"-9\">offset [mm]</text></g>");
}
