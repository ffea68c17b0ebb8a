//! Static plots as SVG text: panels with axes, lines and points. No fonts, no scripts, and the same
//! bytes for the same data.

use plotters::prelude::*;
use std::ops::Range;

/// Colour of a series, red green blue.
pub type Colour = (u8, u8, u8);

/// Dark neutral for measured references such as a gripper's path.
pub const INK: Colour = (40, 40, 40);
/// Light neutral for surroundings such as a table.
pub const FAINT: Colour = (160, 150, 140);

const MARGIN_PX: u32 = 10;
const TITLE_PX: u32 = 26;
const X_LABELS_PX: u32 = 42;
const Y_LABELS_PX: u32 = 62;
const TEXT_PX: u32 = 13;

/// Width and height of a panel that its axes, labels and title take, pixels.
pub const FRAME_PX: (u32, u32) = (
    2 * MARGIN_PX + Y_LABELS_PX,
    2 * MARGIN_PX + TITLE_PX + X_LABELS_PX,
);

/// How a series is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mark {
    /// Connected points, with a stroke in pixels.
    Line(u32),
    /// Dots, with a radius in pixels.
    Dots(u32),
    /// The area between the points and the horizontal axis's zero.
    Area,
}

/// Data drawn in one colour.
#[derive(Clone, Debug)]
pub struct Series {
    /// Entry in the legend; none where this is empty.
    pub label: String,
    /// Colour.
    pub colour: Colour,
    /// Dots or line.
    pub mark: Mark,
    /// Data.
    pub points: Vec<[f64; 2]>,
}

/// How the two axes of a panel are scaled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scales {
    /// Each as its interval asks.
    Free,
    /// Both alike; the shorter interval is widened.
    Equal,
    /// Each as its interval asks, with decades upwards: the interval along y begins above zero, and what lies below it is
    /// drawn on its border.
    DecadesUp,
}

/// A pair of axes with data.
#[derive(Clone, Debug)]
pub struct Panel {
    /// Title above the axes.
    pub title: String,
    /// Quantity and unit along x.
    pub x_label: String,
    /// Quantity and unit along y.
    pub y_label: String,
    /// Shown interval along x.
    pub x: Range<f64>,
    /// Shown interval along y.
    pub y: Range<f64>,
    /// How the axes are scaled.
    pub scales: Scales,
    /// Width and height, pixels.
    pub size_px: (u32, u32),
    /// Data, drawn in order.
    pub series: Vec<Series>,
}

impl Panel {
    /// How high a value is drawn.
    fn up(&self, value: f64) -> f64 {
        match self.scales {
            Scales::DecadesUp => value.max(self.y.start).log10(),
            Scales::Free | Scales::Equal => value,
        }
    }

    /// The number at a tick that is drawn so high.
    fn tick(&self, up: f64) -> String {
        match self.scales {
            Scales::DecadesUp => tidy(two_digits(10f64.powf(up))),
            Scales::Free | Scales::Equal => tidy(up),
        }
    }
}

/// Panels below each other as one SVG document.
pub fn svg(panels: &[Panel]) -> String {
    let width = panels.iter().map(|panel| panel.size_px.0).max().unwrap_or(1);
    let height = panels.iter().map(|panel| panel.size_px.1).sum::<u32>().max(1);
    let mut text = String::new();
    {
        let root = SVGBackend::with_string(&mut text, (width, height)).into_drawing_area();
        let mut rest = root.clone();
        // Writing into a string cannot fail; a panel without an extent is the caller's mistake and
        // shows as an empty one.
        let _ = root.fill(&WHITE);
        for panel in panels {
            let (area, below) = rest.split_vertically(panel.size_px.1);
            let _ = draw(panel, &area);
            rest = below;
        }
        let _ = root.present();
    }
    text
}

/// The interval that holds all values, widened on both sides by a share of its length; at least
/// `least` long.
pub fn interval(values: impl IntoIterator<Item = f64>, margin: f64, least: f64) -> Range<f64> {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for value in values {
        low = low.min(value);
        high = high.max(value);
    }
    if low > high {
        return -0.5 * least..0.5 * least;
    }
    let half = (0.5 * (high - low) * (1.0 + 2.0 * margin)).max(0.5 * least);
    let middle = 0.5 * (low + high);
    middle - half..middle + half
}

/// A colour for a share from 0 (dark blue) to 1 (yellow), even to the eye and to the colour-blind
/// (nine samples of matplotlib's viridis).
pub fn ramp(share: f64) -> Colour {
    const SAMPLES: [[f64; 3]; 9] = [
        [68.0, 1.0, 84.0],
        [71.0, 45.0, 123.0],
        [59.0, 82.0, 139.0],
        [44.0, 114.0, 142.0],
        [33.0, 145.0, 140.0],
        [40.0, 174.0, 128.0],
        [94.0, 201.0, 98.0],
        [173.0, 220.0, 48.0],
        [253.0, 231.0, 37.0],
    ];
    let place = share.clamp(0.0, 1.0) * 8.0;
    let index = (place as usize).min(7);
    let part = place - index as f64;
    let mix = |k: usize| {
        let value = SAMPLES[index][k] + part * (SAMPLES[index + 1][k] - SAMPLES[index][k]);
        value.round() as u8
    };
    (mix(0), mix(1), mix(2))
}

/// The intervals as they are drawn: the shorter one is widened until both axes have the same scale in the panel's plotting
/// area, or decades go up.
fn shown(panel: &Panel) -> (Range<f64>, Range<f64>) {
    let (x, y) = (panel.x.clone(), panel.y.clone());
    if panel.scales != Scales::Equal {
        return (x, panel.up(y.start)..panel.up(y.end));
    }
    let across = f64::from(panel.size_px.0.saturating_sub(FRAME_PX.0).max(1));
    let up = f64::from(panel.size_px.1.saturating_sub(FRAME_PX.1).max(1));
    let scale = ((x.end - x.start) / across).max((y.end - y.start) / up);
    let widen = |range: Range<f64>, pixels: f64| {
        let middle = 0.5 * (range.start + range.end);
        middle - 0.5 * scale * pixels..middle + 0.5 * scale * pixels
    };
    (widen(x, across), widen(y, up))
}

type Drawn = Result<(), DrawingAreaErrorKind<std::io::Error>>;
type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;

fn draw(panel: &Panel, area: &Area<'_>) -> Drawn {
    let (x, y) = shown(panel);
    let text = ("sans-serif", TEXT_PX).into_font().color(&RGBColor(60, 60, 60));
    let title = ("sans-serif", TEXT_PX + 2).into_font().color(&BLACK);
    let (area, _) = area.split_horizontally(panel.size_px.0);
    // A caption has a height of its own choice; a strip of known height keeps the scales equal.
    let (strip, body) = area.split_vertically(TITLE_PX + MARGIN_PX);
    strip.draw(&Text::new(
        panel.title.clone(),
        ((MARGIN_PX + Y_LABELS_PX) as i32, MARGIN_PX as i32),
        title,
    ))?;
    let mut chart = ChartBuilder::on(&body)
        .margin_left(MARGIN_PX)
        .margin_right(MARGIN_PX)
        .margin_bottom(MARGIN_PX)
        .x_label_area_size(X_LABELS_PX)
        .y_label_area_size(Y_LABELS_PX)
        .build_cartesian_2d(x.clone(), y.clone())?;
    chart
        .configure_mesh()
        .x_desc(&panel.x_label)
        .y_desc(&panel.y_label)
        .x_labels(ticks(panel.size_px.0, FRAME_PX.0, 60))
        .y_labels(ticks(panel.size_px.1, FRAME_PX.1, 36))
        .x_label_formatter(&|value| tidy(*value))
        .y_label_formatter(&|value| panel.tick(*value))
        .axis_desc_style(text.clone())
        .label_style(text.clone())
        .bold_line_style(RGBColor(225, 225, 225))
        .light_line_style(TRANSPARENT)
        .axis_style(RGBColor(120, 120, 120))
        .draw()?;
    for series in &panel.series {
        draw_series(&mut chart, panel, series)?;
    }
    if panel.series.iter().any(|series| !series.label.is_empty()) {
        chart
            .configure_series_labels()
            .position(emptiest_corner(panel, &x, &y))
            .background_style(WHITE.mix(0.85))
            .border_style(RGBColor(200, 200, 200))
            .label_font(text)
            .draw()?;
    }
    Ok(())
}

/// Width of a legend besides its text, and per letter; height of one of its lines: about, pixels.
const LEGEND_PX: [f64; 3] = [44.0, 7.0, 18.0];
/// Points for which each stretch of a line counts.
const STRETCH: usize = 24;

/// The corner in which a legend hides least.
fn emptiest_corner(panel: &Panel, x: &Range<f64>, y: &Range<f64>) -> SeriesLabelPosition {
    let labels = || {
        panel
            .series
            .iter()
            .map(|s| s.label.chars().count())
            .filter(|&n| n > 0)
    };
    let [least, per_letter, per_line] = LEGEND_PX;
    let wide = least + per_letter * labels().max().unwrap_or(0) as f64;
    let high = per_line * labels().count() as f64;
    let across = wide / f64::from(panel.size_px.0.saturating_sub(FRAME_PX.0).max(1));
    let up = high / f64::from(panel.size_px.1.saturating_sub(FRAME_PX.1).max(1));
    // Places as shares of the plotting area, from its lower left corner.
    let place = |p: &[f64; 2]| {
        [
            (p[0] - x.start) / (x.end - x.start),
            (panel.up(p[1]) - y.start) / (y.end - y.start),
        ]
    };
    let mut places: Vec<[f64; 2]> = Vec::new();
    for series in &panel.series {
        places.extend(series.points.iter().map(place));
        if matches!(series.mark, Mark::Dots(_)) {
            continue;
        }
        for pair in series.points.windows(2) {
            let [from, to] = [place(&pair[0]), place(&pair[1])];
            let between = |k: usize| {
                let share = k as f64 / STRETCH as f64;
                [0, 1].map(|axis| from[axis] + share * (to[axis] - from[axis]))
            };
            places.extend((1..STRETCH).map(between));
        }
    }
    let hidden = |right: bool, upper: bool| {
        let covers = |at: f64, size: f64, far: bool| if far { at > 1.0 - size } else { at < size };
        let under = places
            .iter()
            .filter(|p| covers(p[0], across, right) && covers(p[1], up, upper));
        under.count()
    };
    // Where two are as empty, the first.
    let corners = [
        (SeriesLabelPosition::UpperRight, hidden(true, true)),
        (SeriesLabelPosition::UpperLeft, hidden(false, true)),
        (SeriesLabelPosition::LowerRight, hidden(true, false)),
        (SeriesLabelPosition::LowerLeft, hidden(false, false)),
    ];
    let best = corners.into_iter().min_by_key(|corner| corner.1);
    best.map_or(SeriesLabelPosition::UpperRight, |corner| corner.0)
}

/// How many ticks an axis has room for, one every `apart` pixels.
fn ticks(size: u32, frame: u32, apart: u32) -> usize {
    (size.saturating_sub(frame) / apart).max(3) as usize
}

type Chart<'a> = ChartContext<
    'a,
    SVGBackend<'a>,
    Cartesian2d<plotters::coord::types::RangedCoordf64, plotters::coord::types::RangedCoordf64>,
>;

fn draw_series(chart: &mut Chart<'_>, panel: &Panel, series: &Series) -> Drawn {
    let (red, green, blue) = series.colour;
    let colour = RGBColor(red, green, blue);
    let points = series.points.iter().map(|p| (p[0], panel.up(p[1])));
    let drawn = match series.mark {
        Mark::Line(width) => chart.draw_series(LineSeries::new(points, colour.stroke_width(width)))?,
        Mark::Dots(radius) => {
            chart.draw_series(points.map(|at| Circle::new(at, radius as i32, colour.filled())))?
        }
        Mark::Area => chart.draw_series(AreaSeries::new(points, 0.0, colour.mix(0.35)))?,
    };
    if series.label.is_empty() {
        return Ok(());
    }
    let drawn = drawn.label(series.label.clone());
    match series.mark {
        Mark::Line(width) => drawn.legend(move |(x, y)| {
            PathElement::new(vec![(x + 2, y), (x + 16, y)], colour.stroke_width(width)).into_dyn()
        }),
        _ => drawn.legend(move |(x, y)| Circle::new((x + 9, y), 4, colour.filled()).into_dyn()),
    };
    Ok(())
}

fn two_digits(value: f64) -> f64 {
    let unit = 10f64.powf(value.log10().floor() - 1.0);
    (value / unit).round() * unit
}

/// A tick's number with up to four digits after the point and no needless zeros.
fn tidy(value: f64) -> String {
    let text = format!("{value:.4}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" {
        "0".to_owned()
    } else {
        text.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn panel(points: Vec<[f64; 2]>) -> Panel {
        Panel {
            title: "title".to_owned(),
            x_label: "x [m]".to_owned(),
            y_label: "y [m]".to_owned(),
            x: 0.0..1.0,
            y: 0.0..1.0,
            scales: Scales::Equal,
            size_px: (600, 300),
            series: vec![Series {
                label: "points".to_owned(),
                colour: ramp(0.5),
                mark: Mark::Dots(2),
                points,
            }],
        }
    }

    #[test]
    fn decades_go_up_evenly_from_the_least_that_is_shown() {
        let panel = Panel {
            y: 0.1..10.0,
            scales: Scales::DecadesUp,
            ..panel(Vec::new())
        };
        assert_eq!(shown(&panel).1, -1.0..1.0);
        assert_eq!([0.0, 0.1, 1.0].map(|value| panel.up(value)), [-1.0, -1.0, 0.0]);
        assert_eq!([-0.5, 0.0, 1.0].map(|up| panel.tick(up)), ["0.32", "1", "10"]);
    }

    #[test]
    fn equal_scale_means_as_many_metres_a_pixel_both_ways() {
        let (x, y) = shown(&panel(Vec::new()));
        let across = f64::from(600 - FRAME_PX.0);
        let up = f64::from(300 - FRAME_PX.1);
        assert!(((x.end - x.start) / across - (y.end - y.start) / up).abs() < 1e-12);
        assert!(x.start <= 0.0 && x.end >= 1.0 && y.start <= 0.0 && y.end >= 1.0);
    }

    #[test]
    fn the_same_data_give_the_same_text_with_labels() {
        let panels = [panel(vec![[0.5, 0.5]]), panel(Vec::new())];
        let text = svg(&panels);
        assert_eq!(text, svg(&panels));
        for word in ["<svg", "x [m]", "y [m]", "title", "points", "</svg>"] {
            assert!(text.contains(word), "no {word}");
        }
    }

    #[test]
    fn a_legend_stands_where_nothing_is_drawn() {
        let corner = |points: &[[f64; 2]]| {
            let panel = panel(points.to_vec());
            let (x, y) = shown(&panel);
            emptiest_corner(&panel, &x, &y)
        };
        assert!(matches!(corner(&[]), SeriesLabelPosition::UpperRight));
        let (x, y) = shown(&panel(Vec::new()));
        let upper_right = [x.end - 1e-3, y.end - 1e-3];
        let upper_left = [x.start + 1e-3, y.end - 1e-3];
        assert!(matches!(corner(&[upper_right]), SeriesLabelPosition::UpperLeft));
        let both = [upper_right, upper_left];
        assert!(matches!(corner(&both), SeriesLabelPosition::LowerRight));
    }

    #[test]
    fn intervals_hold_their_values() {
        assert_eq!(interval([1.0, 3.0], 0.0, 0.1), 1.0..3.0);
        assert_eq!(interval([2.0], 0.1, 1.0), 1.5..2.5);
        assert_eq!(interval([], 0.1, 1.0), -0.5..0.5);
    }

    #[test]
    fn the_colour_ramp_runs_from_dark_to_light() {
        assert_eq!(ramp(0.0), (68, 1, 84));
        assert_eq!(ramp(1.0), (253, 231, 37));
        assert_eq!(ramp(-1.0), ramp(0.0));
    }
}
