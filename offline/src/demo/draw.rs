//! A demonstration as a picture: the rope from the side and from above at several times.

use super::{Demo, Observations};
use crate::plot::{FAINT, FRAME_PX, INK, Mark, Panel, Scales, Series, interval, ramp, svg};
use std::ops::Range;

/// How many instants are shown.
const SHOWN: usize = 6;
/// Largest plotting area of a view, pixels.
const WIDEST_PX: f64 = 680.0;
const HIGHEST_PX: f64 = 560.0;
/// Height that a view needs for its axis's name, pixels.
const LOWEST_PX: u32 = 110;

/// Two views of the demonstration, from the side (x, z) and from above (x, y), as SVG text: what
/// was seen at about six times, the clamps' paths and the table. All axes have the same scale.
pub fn plot_svg(demo: &Demo) -> String {
    let shown = instants(demo);
    let mut side = view(demo, &shown, 2, "from the side");
    let mut top = view(demo, &shown, 1, "from above");
    let length = |range: &Range<f64>| range.end - range.start;
    let scale = (length(&side.x) / WIDEST_PX)
        .max(length(&side.y) / HIGHEST_PX)
        .max(length(&top.y) / HIGHEST_PX);
    for panel in [&mut side, &mut top] {
        // Both views show the same x, so that the eye can go straight down from one to the other.
        let middle = 0.5 * (panel.x.start + panel.x.end);
        panel.x = middle - 0.5 * scale * WIDEST_PX..middle + 0.5 * scale * WIDEST_PX;
        let up = (length(&panel.y) / scale).round() as u32;
        panel.size_px = (FRAME_PX.0 + WIDEST_PX as u32, FRAME_PX.1 + up.max(LOWEST_PX));
    }
    svg(&[side, top])
}

/// Points seen at one time.
struct Instant {
    t_s: f64,
    points_m: Vec<[f64; 3]>,
}

/// About [`SHOWN`] instants, the first and the last among them, evenly chosen.
fn instants(demo: &Demo) -> Vec<Instant> {
    let all: Vec<Instant> = match &demo.observations {
        Observations::Clouds(frames) => {
            let instant = |frame: &super::CloudFrame| Instant {
                t_s: frame.t_s,
                points_m: frame.points_m.clone(),
            };
            frames.iter().map(instant).collect()
        }
        Observations::Markers(samples) => {
            let same_time = |a: &super::MarkerSample, b: &super::MarkerSample| a.t_s == b.t_s;
            let instant = |group: &[super::MarkerSample]| Instant {
                t_s: group[0].t_s,
                points_m: group.iter().map(|sample| sample.position_m).collect(),
            };
            samples.chunk_by(same_time).map(instant).collect()
        }
    };
    let last = all.len().saturating_sub(1);
    let wanted: Vec<usize> = (0..SHOWN)
        .map(|k| (k * last + (SHOWN - 1) / 2) / (SHOWN - 1))
        .collect();
    let chosen = all
        .into_iter()
        .enumerate()
        .filter(|(index, _)| wanted.contains(index));
    chosen.map(|(_, instant)| instant).collect()
}

/// One view: x to the right, `axis` (1 for y, 2 for z) up.
fn view(demo: &Demo, shown: &[Instant], axis: usize, from: &str) -> Panel {
    let mut series = Vec::new();
    let side = axis == 2;
    let radius = if matches!(demo.observations, Observations::Clouds(_)) {
        1
    } else {
        4
    };
    let span = shown.last().map_or(0.0, |last| last.t_s - shown[0].t_s).max(1e-9);
    for instant in shown {
        // The ramp's lightest part is hard to see on white.
        let share = 0.92 * (instant.t_s - shown[0].t_s) / span;
        series.push(Series {
            label: if side {
                format!("{:.2} s", instant.t_s)
            } else {
                String::new()
            },
            colour: ramp(share),
            mark: Mark::Dots(radius),
            points: instant.points_m.iter().map(|p| [p[0], p[axis]]).collect(),
        });
    }
    for (index, path) in demo.clamps.iter().enumerate() {
        series.push(Series {
            label: if side {
                format!("clamp {index}")
            } else {
                String::new()
            },
            colour: INK,
            mark: Mark::Line(2),
            points: path
                .iter()
                .map(|s| [s.position_m[0], s.position_m[axis]])
                .collect(),
        });
    }
    let values = |k: usize| {
        series
            .iter()
            .flat_map(move |one| one.points.iter().map(move |p| p[k]))
    };
    let least = 2.0 * demo.spec.rope.diameter_m;
    let x = interval(values(0), 0.1, least);
    let height = demo.spec.table.as_ref().map(|table| table.height_m);
    let table = height.filter(|_| side);
    let y = interval(values(1).chain(table), 0.1, least);
    if let Some(height) = table {
        // The table reaches as far as the widest view; the axes clip it.
        let far = 2.0 * (x.end - x.start);
        let points = vec![[x.start - far, height], [x.end + far, height]];
        series.insert(0, line("table", points));
    }
    Panel {
        title: format!("{} {from}", demo.name),
        x_label: "x [m]".to_owned(),
        y_label: if side { "z [m]" } else { "y [m]" }.to_owned(),
        size_px: FRAME_PX,
        x,
        y,
        scales: Scales::Equal,
        series,
    }
}

fn line(label: &str, points: Vec<[f64; 2]>) -> Series {
    Series {
        label: label.to_owned(),
        colour: FAINT,
        mark: Mark::Line(2),
        points,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demo::MarkerSample;
    use std::path::Path;

    fn shipped() -> Demo {
        let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("demos/sample-rope/fit");
        Demo::load(dir).expect("the shipped demo loads")
    }

    #[test]
    fn both_views_name_axes_units_times_clamp_and_table() {
        let text = plot_svg(&shipped());
        let words = [
            "x [m]",
            "y [m]",
            "z [m]",
            "from the side",
            "from above",
            "0.00 s",
            "3.13 s",
            "clamp 0",
            "table",
        ];
        for word in words {
            assert!(text.contains(word), "no {word}");
        }
    }

    #[test]
    fn instants_are_few_and_hold_the_first_and_the_last() {
        let shown = instants(&shipped());
        assert_eq!(shown.len(), SHOWN);
        assert_eq!(shown[0].t_s, 0.0);
        assert_eq!(shown[SHOWN - 1].t_s, 3.133333);
    }

    #[test]
    fn markers_of_a_single_instant_are_drawn_too() {
        let mut demo = shipped();
        let marker = |s_m: f64| MarkerSample {
            t_s: 0.0,
            marker: format!("{s_m}"),
            s_m,
            position_m: [s_m, 0.0, 0.007],
        };
        demo.observations = Observations::Markers(vec![marker(0.1), marker(0.2)]);
        assert_eq!(instants(&demo).len(), 1);
        assert!(plot_svg(&demo).contains("0.00 s"));
        assert!(crate::demo::summary(&demo).contains("1 instants"));
    }
}
