//! What a person wants to know about a demonstration before fitting to it, and what looks wrong.

use super::plausible;
use super::{ClampSample, Demo, DemoSpec, Observations, RopeEnd, RopeMeasure, SceneKind};
use std::fmt::Write as _;
use std::ops::RangeInclusive;

/// Frames at rest that make a useful estimate of the sensor's noise.
const REST_FRAMES: usize = 3;
/// Speeds of a clamp that no lift or drag needs, m/s.
const FAST_M_S: f64 = 3.0;
/// Densities beyond which hardly any rope's lie, kg/m³.
const FOAM_KG_M3: f64 = 15.0;
const COPPER_KG_M3: f64 = 8960.0;
/// Points in a cloud below which little is seen of a rope.
const FEW_POINTS: usize = 20;

/// The demonstration in a few lines of text, with warnings at the end.
pub fn summary(demo: &Demo) -> String {
    let mut text = String::new();
    let rope = &demo.spec.rope;
    let scene = format!("{:?}", demo.spec.scene).to_lowercase();
    let _ = writeln!(
        text,
        "{}: {scene}, rope {:.3} m long, {:.1} mm thick, {:.1} g ({:.0} kg/m³)",
        demo.name,
        rope.length_m,
        1e3 * rope.diameter_m,
        1e3 * rope.mass_kg,
        rope.density_kg_m3()
    );
    if rope.end_mass_kg > 0.0 {
        let _ = writeln!(text, "end       carries {:.1} g", 1e3 * rope.end_mass_kg);
    }
    if rope.roll_rad != 0.0 {
        let _ = writeln!(
            text,
            "rolled    by {:.0} degrees about its axis",
            rope.roll_rad.to_degrees()
        );
    }
    for measure in &rope.assumed {
        let _ = writeln!(text, "assumed   {}", assumption(*measure));
    }
    let frames = frames(demo);
    let _ = writeln!(text, "seen      {}", observed(demo, &frames));
    for (index, path) in demo.clamps.iter().enumerate() {
        let _ = writeln!(text, "clamp {index}   {}", clamp_line(&demo.spec, index, path));
    }
    let _ = writeln!(
        text,
        "rest      {} frames before the first motion",
        demo.rest_frames(&demo.times_s())
    );
    let table = demo.spec.table.as_ref().map_or("no table".to_owned(), |table| {
        format!(
            "table at {:.3} m with friction {:.2}",
            table.height_m, table.friction
        )
    });
    let _ = writeln!(
        text,
        "declared  noise {:.2} mm, {table}, {} cameras",
        1e3 * demo.spec.noise_m,
        demo.spec.cameras.len()
    );
    let warnings = warnings(demo);
    for warning in &warnings {
        let _ = writeln!(text, "warning   {warning}");
    }
    if warnings.is_empty() {
        let _ = writeln!(text, "nothing looks wrong");
    }
    text
}

fn assumption(measure: RopeMeasure) -> &'static str {
    match measure {
        RopeMeasure::DiameterM => "diameter: bending stiffness is identified, Young's modulus is not",
        RopeMeasure::MassKg => "mass: stiffness per mass is identified, stiffness is not",
    }
}

/// What is allowed but looks wrong, one line each; empty for a plausible demonstration.
pub fn warnings(demo: &Demo) -> Vec<String> {
    let in_plane = demo.spec.planar.then(|| demo.clone().in_plane());
    let demo = in_plane.as_ref().unwrap_or(demo);
    let frames = frames(demo);
    let mut found = Vec::new();
    found.extend(timing(demo, &frames));
    found.extend(clamp_speed(demo));
    found.extend(first_cloud(demo, &frames));
    found.extend(heights(demo, &frames));
    found.extend(reach(demo, &frames));
    found.extend(density(demo));
    found.extend(plausible::contradictions(demo, &frames));
    if demo.spec.scene == SceneKind::Lift && demo.rest_frames(&demo.times_s()) < REST_FRAMES {
        found.push(format!(
            "fewer than {REST_FRAMES} frames before the clamp moves: the sensor's noise cannot be checked; \
             record some rest first"
        ));
    }
    found
}

/// A mass that fits no material that ropes are made of: hardly any is heavier than copper or lighter than foam.
fn density(demo: &Demo) -> Option<String> {
    let rope = &demo.spec.rope;
    let kg_m3 = rope.density_kg_m3();
    let which = match kg_m3 {
        _ if kg_m3 > COPPER_KG_M3 => "heavier than copper",
        _ if kg_m3 < FOAM_KG_M3 => "lighter than foam",
        _ => return None,
    };
    Some(format!(
        "rope.mass_kg = {}, rope.diameter_m and rope.length_m make {kg_m3:.0} kg/m³, {which}: check their units; E is wrong \
         by the factor by which the mass is",
        rope.mass_kg
    ))
}

/// What was seen at one instant, whatever the sensor.
pub(super) struct Frame<'a> {
    pub(super) t_s: f64,
    pub(super) points: Vec<&'a [f64; 3]>,
}

/// What was seen, frame by frame.
pub(super) fn frames(demo: &Demo) -> Vec<Frame<'_>> {
    match &demo.observations {
        Observations::Clouds(frames) => frames
            .iter()
            .map(|frame| Frame {
                t_s: frame.t_s,
                points: frame.points_m.iter().collect(),
            })
            .collect(),
        Observations::Markers(samples) => samples
            .chunk_by(|a, b| a.t_s == b.t_s)
            .map(|group| Frame {
                t_s: group[0].t_s,
                points: group.iter().map(|sample| &sample.position_m).collect(),
            })
            .collect(),
    }
}

fn observed(demo: &Demo, frames: &[Frame<'_>]) -> String {
    let counts = frames.iter().map(|frame| frame.points.len());
    let (least, most) = (counts.clone().min().unwrap_or(0), counts.max().unwrap_or(0));
    let duration = frames.last().map_or(0.0, |last| last.t_s - frames[0].t_s);
    let rate = (frames.len() as f64 - 1.0) / duration.max(1e-9);
    let (what, points) = match demo.observations {
        Observations::Clouds(_) => ("clouds", "points"),
        Observations::Markers(_) => ("instants", "markers"),
    };
    let each = if least == most {
        format!("{least}")
    } else {
        format!("{least} to {most}")
    };
    format!(
        "{} {what} in {duration:.2} s ({rate:.1} Hz), {each} {points} each",
        frames.len()
    )
}

fn clamp_line(spec: &DemoSpec, index: usize, path: &[ClampSample]) -> String {
    let clamp = &spec.clamps[index];
    let end = match clamp.end {
        RopeEnd::Start => "start",
        RopeEnd::End => "end",
    };
    // Folded from zero: the sum of nothing is -0.
    let travel = path
        .windows(2)
        .map(|pair| distance(&pair[0].position_m, &pair[1].position_m))
        .fold(0.0, |sum, part| sum + part);
    let opening = path.iter().find(|sample| !sample.closed);
    let hold = opening.map_or("never opens".to_owned(), |sample| {
        format!("opens at {:.2} s", sample.t_s)
    });
    format!(
        "holds {:.0} mm at the {end}, {} samples, moves {travel:.3} m at up to {:.3} m/s, {hold}",
        1e3 * clamp.grip_m,
        path.len(),
        fastest(path)
    )
}

/// Largest speed between neighbouring samples, m/s.
pub(super) fn fastest(path: &[ClampSample]) -> f64 {
    let speed = |pair: &[ClampSample]| {
        distance(&pair[0].position_m, &pair[1].position_m) / (pair[1].t_s - pair[0].t_s)
    };
    path.windows(2).map(speed).fold(0.0, f64::max)
}

/// Times at which a clamp's path is known, s, to a sample's worth of time.
pub(super) fn known_s(path: &[ClampSample]) -> RangeInclusive<f64> {
    let (from, to) = (path[0].t_s, path[path.len() - 1].t_s);
    let slack = 1e-3
        + if path.len() > 1 {
            (to - from) / (path.len() - 1) as f64
        } else {
            f64::INFINITY
        };
    from - slack..=to + slack
}

fn gaps_s(frames: &[Frame<'_>]) -> impl Iterator<Item = f64> {
    frames.windows(2).map(|pair| pair[1].t_s - pair[0].t_s)
}

/// Median time from one frame to the next, s.
pub(super) fn usual_gap_s(frames: &[Frame<'_>]) -> Option<f64> {
    let mut gaps: Vec<f64> = gaps_s(frames).collect();
    gaps.sort_by(f64::total_cmp);
    gaps.get(gaps.len() / 2).copied()
}

/// Share of all points that lie under the table by more than the noise; none without a table.
pub(super) fn share_under_table(demo: &Demo, frames: &[Frame<'_>]) -> Option<f64> {
    let floor = demo.spec.table.as_ref()?.height_m - 5.0 * demo.spec.noise_m;
    let points = || frames.iter().flat_map(|frame| &frame.points);
    let under = points().filter(|p| p[2] < floor).count();
    Some(under as f64 / points().count().max(1) as f64)
}

fn timing(demo: &Demo, frames: &[Frame<'_>]) -> Vec<String> {
    let mut found = Vec::new();
    let (Some(first), Some(last)) = (frames.first(), frames.last()) else {
        return found;
    };
    for (index, path) in demo.clamps.iter().enumerate() {
        let known = known_s(path);
        if !known.contains(&first.t_s) || !known.contains(&last.t_s) {
            let (from, to) = (path[0].t_s, path[path.len() - 1].t_s);
            found.push(format!(
                "frames last from {:.3} to {:.3} s but clamp {index} is known from {from:.3} to {to:.3} s only; \
                 check that both use one clock",
                first.t_s, last.t_s
            ));
        }
    }
    let largest = gaps_s(frames).fold(0.0, f64::max);
    if let Some(middle) = usual_gap_s(frames)
        && largest > 3.5 * middle
    {
        found.push(format!(
            "a gap of {largest:.3} s between frames that are usually {middle:.3} s apart"
        ));
    }
    let few = frames
        .iter()
        .filter(|frame| frame.points.len() < FEW_POINTS)
        .count();
    if few > 0 && matches!(demo.observations, Observations::Clouds(_)) {
        found.push(format!("{few} clouds have fewer than {FEW_POINTS} points"));
    }
    found
}

fn clamp_speed(demo: &Demo) -> Option<String> {
    let (index, speed) = demo
        .clamps
        .iter()
        .map(|path| fastest(path))
        .enumerate()
        .max_by(|a, b| a.1.total_cmp(&b.1))?;
    (speed > FAST_M_S)
        .then(|| format!("clamp {index} moves at {speed:.1} m/s; look for a jump in its path or wrong units"))
}

/// Checks the place and the direction of the first frame against the clamp and the declared rope.
fn first_cloud(demo: &Demo, frames: &[Frame<'_>]) -> Vec<String> {
    let mut found = Vec::new();
    let (Some(first), rope) = (frames.first(), &demo.spec.rope) else {
        return found;
    };
    if !matches!(demo.observations, Observations::Clouds(_)) {
        return found;
    }
    for (clamp, path) in demo.spec.clamps.iter().zip(&demo.clamps) {
        let nearest = first.points.iter().map(|p| distance(p, &path[0].position_m));
        let nearest = nearest.fold(f64::INFINITY, f64::min);
        let allowed = clamp.grip_m + 2.0 * rope.diameter_m + 5.0 * demo.spec.noise_m;
        if nearest > allowed {
            found.push(format!(
                "the first cloud's nearest point is {:.0} mm from a clamp; check the camera's pose, \
                 the axes and which end is gripped",
                1e3 * nearest
            ));
        }
    }
    let along = |p: &[f64; 3]| (0..3).map(|k| p[k] * rope.direction[k]).sum::<f64>();
    let spread = |f: &dyn Fn(&[f64; 3]) -> f64| {
        let values = first.points.iter().map(|p| f(p));
        values.clone().fold(f64::NEG_INFINITY, f64::max) - values.fold(f64::INFINITY, f64::min)
    };
    let longest = (0..3).map(|k| spread(&|p| p[k])).fold(0.0, f64::max);
    let lies = spread(&along);
    if demo.spec.scene != SceneKind::Free && lies < 0.6 * longest {
        found.push(format!(
            "the first cloud is {:.0} mm long along the rope's declared direction {:?} but {:.0} mm \
             along another axis; are axes swapped?",
            1e3 * lies,
            rope.direction,
            1e3 * longest
        ));
    }
    found
}

/// Checks that the rope is above the table and, where one end is lifted, below the clamp.
fn heights(demo: &Demo, frames: &[Frame<'_>]) -> Vec<String> {
    let mut found = Vec::new();
    let Some(under) = share_under_table(demo, frames) else {
        return found;
    };
    if under > 0.01 {
        found.push(format!(
            "{:.0} % of the points lie under the table; check table.height_m and that z points up",
            100.0 * under
        ));
    }
    if let (SceneKind::Lift, Some(last), Some(path)) = (demo.spec.scene, frames.last(), demo.clamps.first()) {
        let clamp = path[path.len() - 1].position_m[2];
        let above = last
            .points
            .iter()
            .filter(|p| p[2] > clamp + demo.spec.rope.diameter_m)
            .count();
        if 2 * above > last.points.len() {
            found.push(
                "most of the last frame lies above the clamp that lifts the rope; is z upside down?".into(),
            );
        }
    }
    found
}

/// Checks that no more than a few points are farther from a closed clamp than the rope is long.
fn reach(demo: &Demo, frames: &[Frame<'_>]) -> Option<String> {
    let path = demo.clamps.first()?;
    let longest = 1.1 * demo.spec.rope.length_m + demo.spec.rope.diameter_m + 5.0 * demo.spec.noise_m;
    let (mut all, mut far) = (0usize, 0usize);
    for frame in frames {
        let after = path.partition_point(|sample| sample.t_s <= frame.t_s);
        let sample = &path[after.saturating_sub(1)];
        if sample.closed {
            all += frame.points.len();
            far += frame
                .points
                .iter()
                .filter(|p| distance(p, &sample.position_m) > longest)
                .count();
        }
    }
    (100 * far > all).then(|| {
        format!(
            "{:.0} % of the points are farther from clamp 0 than the rope is long; crop the background \
             and check the clocks",
            100.0 * far as f64 / all as f64
        )
    })
}

pub(super) fn distance(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn shipped() -> Demo {
        let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("demos/sample-rope/fit");
        Demo::load(dir).expect("the shipped demo loads")
    }

    /// The shipped demo with every point moved.
    fn moved(turn: impl Fn([f64; 3]) -> [f64; 3]) -> Demo {
        let mut demo = shipped();
        if let Observations::Clouds(frames) = &mut demo.observations {
            for point in frames.iter_mut().flat_map(|frame| &mut frame.points_m) {
                *point = turn(*point);
            }
        }
        demo
    }

    fn warned(demo: &Demo, of: &str) {
        let found = warnings(demo);
        assert!(found.iter().any(|warning| warning.contains(of)), "{found:?}");
    }

    #[test]
    fn a_plausible_demo_has_no_warnings_and_a_summary_with_its_figures() {
        assert_eq!(warnings(&shipped()), Vec::<String>::new());
        let text = summary(&shipped());
        for figure in [
            "0.250 m long",
            "38.5 g",
            "95 clouds",
            "30.0 Hz",
            "250 points",
            "0.313 m",
            "0.250 m/s",
        ] {
            assert!(text.contains(figure), "no '{figure}' in\n{text}");
        }
    }

    #[test]
    fn a_mass_that_no_rope_of_that_size_has_is_noticed() {
        let mut demo = shipped();
        demo.spec.rope.mass_kg *= 10.0;
        warned(&demo, "heavier than copper");
        demo.spec.rope.mass_kg *= 1e-3;
        warned(&demo, "lighter than foam");
    }

    #[test]
    fn swapped_axes_are_noticed() {
        warned(&moved(|[x, y, z]| [y, x, z]), "axes swapped");
    }

    #[test]
    fn clouds_upside_down_are_noticed() {
        warned(&moved(|[x, y, z]| [x, y, -z]), "under the table");
        warned(&moved(|[x, y, z]| [x, y, 0.7 - z]), "upside down");
    }

    #[test]
    fn a_cloud_far_from_the_clamp_is_noticed() {
        warned(&moved(|[x, y, z]| [x + 0.2, y, z]), "mm from a clamp");
        warned(&moved(|[x, y, z]| [2.0 * x, y, z]), "than the rope is long");
    }

    #[test]
    fn clocks_that_differ_are_noticed() {
        let mut demo = shipped();
        for sample in &mut demo.clamps[0] {
            sample.t_s += 1.0;
        }
        warned(&demo, "one clock");
    }

    #[test]
    fn a_jump_of_the_clamp_and_a_demo_without_rest_are_noticed() {
        let mut demo = shipped();
        demo.clamps[0][2].position_m[0] += 0.1;
        warned(&demo, "jump");
        warned(&demo, "record some rest");
    }
}
