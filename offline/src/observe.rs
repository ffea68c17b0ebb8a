//! The observation model: where a measured cloud says that the rope's axis is, relative to a
//! predicted centreline, per station of arc length, with its standard error.
//!
//! Nearest-point distances are biased at the truth and have kinks, so they are not used for
//! inference. Instead every point is projected on the predicted centreline; the points of a station
//! lie on the rope's surface, a circle of the known radius R in the plane across the rope, and the
//! offset δ of that circle's centre is found from |q − δ| = R. Seeing only the front of the rope
//! hence shifts nothing (`circle.rs`), and no camera has to be known; of one that is, the noise is known to lie along its
//! rays. What else the cameras saw is set aside (`background.rs`). Labelled markers give three offsets directly.

mod background;
mod circle;

use crate::demo::{Demo, Observations};
use crate::sim::kernel::weights;
use background::rope_points;
use circle::{Seen, circle_centres};
use nalgebra::{Matrix2, Vector2};

/// One measured number: the rope's axis lies `offset_m` from the prediction along `direction`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// Index of the recorded time.
    pub frame: usize,
    /// Index of the station.
    pub station: usize,
    /// Arc length, m.
    pub arc_m: f64,
    /// Predicted position of the axis there, m.
    pub position_m: [f64; 3],
    /// Unit vector in the world.
    pub direction: [f64; 3],
    /// Measured minus predicted, m.
    pub offset_m: f64,
    /// Standard error of the offset, m, from the noise of single points.
    pub sigma_m: f64,
}

/// Root mean square of the standard errors of rows, m: the error of a perfect model. Nothing of no rows.
pub fn noise_m<'a>(rows: impl IntoIterator<Item = &'a Row>) -> f64 {
    let (mut square, mut count) = (0.0, 0usize);
    for row in rows {
        square += row.sigma_m * row.sigma_m;
        count += 1;
    }
    (square / count.max(1) as f64).sqrt()
}

/// Which points of the rope a cloud holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Section {
    /// Points of the surface, as cameras see it: they lie on a circle around the axis.
    #[default]
    Surface,
    /// Points throughout the rope, evenly: the axis is their centre. The predicted rope's points are measured alike, so
    /// that what is wrong in measuring them cancels.
    Filled,
}

/// Number of stations along the rope for point clouds.
pub const STATIONS: usize = 24;
/// Fewest points from which a station's circle is estimated.
const MIN_POINTS: usize = 4;
/// Part of the standard error that more points do not lower: pixel pitch and calibration, m.
const SYSTEMATIC_M: f64 = 1e-4;
/// The same of points that no camera saw, m: centres of a simulation's particles were off by 2e-6 m as a root mean square
/// and 2e-5 m at most where θ was the truth, before what the predicted rope's own were off by was taken from them.
const UNSEEN_SYSTEMATIC_M: f64 = 1e-5;
/// Points further than this from the predicted axis are background, m, beyond the radius.
const GATE_M: f64 = 0.12;

/// A predicted centreline at one time.
pub struct Centreline<'a> {
    /// Arc length of each point, m.
    pub arc_m: &'a [f64],
    /// Points, m.
    pub points_m: &'a [[f64; 3]],
    /// Length of the rope, m.
    pub length_m: f64,
    /// Points that fill the predicted rope, m; none where they were not kept.
    pub filled_m: &'a [[f64; 3]],
}

/// Where an arc length falls between the points of a centreline: index of the lower point and the
/// share of the upper one, beyond [0, 1] at the ends.
pub fn bracket(arcs_m: &[f64], s_m: f64) -> (usize, f64) {
    let upper = arcs_m.partition_point(|&a| a < s_m).clamp(1, arcs_m.len() - 1);
    let low = upper - 1;
    (low, (s_m - arcs_m[low]) / (arcs_m[upper] - arcs_m[low]))
}

/// The point between two neighbours that [`bracket`] says.
pub fn interpolate<T: Copy + Into<f64>>(points: &[[T; 3]], (low, share): (usize, f64)) -> [f64; 3] {
    std::array::from_fn(|k| points[low][k].into() * (1.0 - share) + points[low + 1][k].into() * share)
}

impl Row {
    /// The part along the row's direction of a vector that is given at the points of a centreline.
    pub fn along(&self, vectors: &[[f64; 3]], place: (usize, f64)) -> f64 {
        let vector = interpolate(vectors, place);
        (0..3).map(|k| self.direction[k] * vector[k]).sum()
    }
}

/// All rows of one recorded time.
pub fn measure(demo: &Demo, frame: usize, line: &Centreline, section: Section) -> Vec<Row> {
    match &demo.observations {
        Observations::Clouds(frames) => measure_cloud(
            &frames[frame].points_m,
            frame,
            line,
            &SectionShape {
                section,
                radius_m: 0.5 * demo.spec.rope.diameter_m,
                cameras_m: demo.spec.cameras.iter().map(|c| c.position_m).collect(),
            },
            demo.spec.noise_m,
        ),
        Observations::Markers(samples) => {
            let times = demo.times_s();
            let arcs_m = station_arcs_m(demo);
            let now = samples.iter().filter(|m| m.t_s == times[frame]);
            let axes = marker_axes(demo);
            now.flat_map(|marker| {
                let predicted = interpolate(line.points_m, bracket(line.arc_m, marker.s_m));
                let station = arcs_m.partition_point(|&s| s < marker.s_m);
                axes.iter().map(move |&k| {
                    let mut direction = [0.0; 3];
                    direction[k] = 1.0;
                    Row {
                        frame,
                        station,
                        arc_m: marker.s_m,
                        position_m: predicted,
                        direction,
                        offset_m: marker.position_m[k] - predicted[k],
                        sigma_m: demo.spec.noise_m.hypot(SYSTEMATIC_M),
                    }
                })
            })
            .collect()
        }
    }
}

/// Rows of each recorded time if every station is seen.
pub fn most_rows(demo: &Demo) -> Vec<usize> {
    match &demo.observations {
        Observations::Clouds(frames) => vec![2 * STATIONS; frames.len()],
        Observations::Markers(samples) => {
            let frames = samples.chunk_by(|a, b| a.t_s == b.t_s);
            frames.map(|now| now.len() * marker_axes(demo).len()).collect()
        }
    }
}

/// Along which axes of the world a marker was measured: where the motion is planar, not along y.
pub(crate) fn marker_axes(demo: &Demo) -> &'static [usize] {
    if demo.spec.planar { &[0, 2] } else { &[0, 1, 2] }
}

/// Arc length of every station, m, increasing: the middles of equal parts of the rope for clouds, the
/// places of all markers for markers, whether or not each was seen in every frame.
pub fn station_arcs_m(demo: &Demo) -> Vec<f64> {
    match &demo.observations {
        Observations::Clouds(_) => {
            let length_m = demo.spec.rope.length_m;
            let middle = |station: usize| (station as f64 + 0.5) / STATIONS as f64 * length_m;
            (0..STATIONS).map(middle).collect()
        }
        Observations::Markers(samples) => {
            let mut arcs_m: Vec<f64> = samples.iter().map(|marker| marker.s_m).collect();
            arcs_m.sort_by(f64::total_cmp);
            arcs_m.dedup();
            arcs_m
        }
    }
}

/// A point in the plane across the rope at its projection.
#[derive(Clone, Copy)]
struct Projected {
    arc_m: f64,
    across_m: Vector2<f64>,
}

/// What a cross-section of the cloud looks like.
struct SectionShape {
    section: Section,
    radius_m: f64,
    /// Where the cameras are that see it, as far as they are known.
    cameras_m: Vec<[f64; 3]>,
}

impl SectionShape {
    /// Stations that a point counts for, and how much; `place` is its arc length in parts of the rope as long as a
    /// station's. A part of a slanted section has its centre elsewhere: points that fill the section therefore come and
    /// go smoothly. Any arc of a circle tells where its centre is.
    fn stations(&self, place: f64) -> [(usize, f64); 3] {
        let station = |index: i32| index.clamp(0, STATIONS as i32 - 1) as usize;
        match self.section {
            Section::Surface => [(station(place as i32), 1.0), (0, 0.0), (0, 0.0)],
            Section::Filled => {
                let (first, _, shares) = weights(place - 0.5);
                std::array::from_fn(|k| (station(first + k as i32), shares[k]))
            }
        }
    }

    /// How far from their mean points of one section may lie, m: across the rope and back, with their noise, where the rope
    /// is thought to run at up to 45 degrees to how it does.
    fn reach_m(&self, length_m: f64, noise_m: f64) -> f64 {
        2.0 * self.radius_m + 4.0 * noise_m + length_m / STATIONS as f64
    }

    /// Part of the standard error that more points do not lower, m.
    fn systematic_m(&self) -> f64 {
        match self.section {
            Section::Surface => SYSTEMATIC_M,
            Section::Filled => UNSEEN_SYSTEMATIC_M,
        }
    }

    /// What lies across the rope, at a place of a piece of it, of the unit vectors from the cameras to there.
    fn rays(&self, segment: &Segment, arc_m: f64) -> Vec<Vector2<f64>> {
        let there_m = segment.at(arc_m);
        let ray = |camera_m: &[f64; 3]| {
            let d: [f64; 3] = std::array::from_fn(|k| there_m[k] - camera_m[k]);
            Vector2::from(segment.normals.map(|normal| dot(d, normal))) / dot(d, d).sqrt()
        };
        self.cameras_m.iter().map(ray).collect()
    }
}

fn measure_cloud(
    points_m: &[[f64; 3]],
    frame: usize,
    line: &Centreline,
    shape: &SectionShape,
    noise_m: f64,
) -> Vec<Row> {
    let segments = segments(line);
    let filled_m = match shape.section {
        Section::Filled => line.filled_m,
        Section::Surface => &[],
    };
    let own = centres(filled_m, line, &segments, shape, noise_m);
    let mut rows = Vec::new();
    for (station, seen) in centres(points_m, line, &segments, shape, noise_m)
        .into_iter()
        .enumerate()
    {
        let Some((mut centre, covariance)) = seen else {
            continue;
        };
        if let Some((own, _)) = own[station] {
            centre -= own;
        }
        let (segment, arc_m) = middle(station, line, &segments);
        // Rotate to the axes of the error ellipse, where the two offsets are independent.
        let eigen = covariance.symmetric_eigen();
        for k in 0..2 {
            let axis = eigen.eigenvectors.column(k);
            rows.push(Row {
                frame,
                station,
                arc_m,
                position_m: segment.at(arc_m),
                direction: std::array::from_fn(|c| {
                    axis[0] * segment.normals[0][c] + axis[1] * segment.normals[1][c]
                }),
                offset_m: axis[0] * centre[0] + axis[1] * centre[1],
                sigma_m: eigen.eigenvalues[k].sqrt().hypot(shape.systematic_m()),
            });
        }
    }
    rows
}

/// The piece of the rope in which the middle of a station lies, and that one's arc length, m.
fn middle<'a>(station: usize, line: &Centreline, segments: &'a [Segment]) -> (&'a Segment, f64) {
    let arc_m = (station as f64 + 0.5) / STATIONS as f64 * line.length_m;
    let there = segments.iter().find(|s| arc_m <= s.arc_end_m);
    (there.unwrap_or(&segments[segments.len() - 1]), arc_m)
}

/// Centre of the section at every station, relative to the centreline, and its covariance, as these points show it.
fn centres(
    points_m: &[[f64; 3]],
    line: &Centreline,
    segments: &[Segment],
    shape: &SectionShape,
    noise_m: f64,
) -> Vec<Option<(Vector2<f64>, Matrix2<f64>)>> {
    let mut bins: Vec<Vec<(Projected, f64)>> = (0..STATIONS).map(|_| Vec::new()).collect();
    for &point in points_m {
        if let Some(p) = project(point, segments, shape.radius_m) {
            let stations = shape.stations(p.arc_m / line.length_m * STATIONS as f64);
            for (station, share) in stations.into_iter().filter(|&(_, share)| share > 0.0) {
                bins[station].push((p, share));
            }
        }
    }
    match shape.section {
        Section::Filled => {
            let centre = |bin: &Vec<_>| (bin.len() >= MIN_POINTS).then(|| filled_centre(bin, noise_m));
            bins.iter().map(centre).collect()
        }
        Section::Surface => {
            let seen = |(station, bin): (usize, &Vec<(Projected, f64)>)| {
                let (segment, arc_m) = middle(station, line, segments);
                let across_m = bin.iter().map(|(p, _)| p.across_m).collect();
                let points_m = rope_points(across_m, shape.reach_m(line.length_m, noise_m))?;
                (points_m.len() >= MIN_POINTS).then(|| Seen {
                    points_m,
                    rays: shape.rays(segment, arc_m),
                })
            };
            let seen: Vec<Option<Seen>> = bins.iter().enumerate().map(seen).collect();
            circle_centres(&seen, shape.radius_m, noise_m)
        }
    }
}

/// A straight piece of the centreline with its frame.
struct Segment {
    from_m: [f64; 3],
    along: [f64; 3],
    length_m: f64,
    arc_start_m: f64,
    arc_end_m: f64,
    /// First normal in the vertical plane of the tangent, second one horizontal.
    normals: [[f64; 3]; 2],
}

impl Segment {
    fn at(&self, arc_m: f64) -> [f64; 3] {
        let share = (arc_m - self.arc_start_m) / (self.arc_end_m - self.arc_start_m);
        std::array::from_fn(|k| self.from_m[k] + share * self.length_m * self.along[k])
    }
}

fn segments(line: &Centreline) -> Vec<Segment> {
    let n = line.points_m.len();
    (0..n - 1)
        .map(|i| {
            let (mut a, mut b) = (line.points_m[i], line.points_m[i + 1]);
            let (mut arc_start_m, mut arc_end_m) = (line.arc_m[i], line.arc_m[i + 1]);
            let rate: [f64; 3] = std::array::from_fn(|k| (b[k] - a[k]) / (arc_end_m - arc_start_m));
            // The first and last half slices are continued straight to the rope's ends.
            if i == 0 {
                a = std::array::from_fn(|k| a[k] - rate[k] * arc_start_m);
                arc_start_m = 0.0;
            }
            if i + 2 == n {
                b = std::array::from_fn(|k| b[k] + rate[k] * (line.length_m - arc_end_m));
                arc_end_m = line.length_m;
            }
            let d: [f64; 3] = std::array::from_fn(|k| b[k] - a[k]);
            let length_m = dot(d, d).sqrt();
            let along = d.map(|c| c / length_m);
            Segment {
                from_m: a,
                along,
                length_m,
                arc_start_m,
                arc_end_m,
                normals: normals(along),
            }
        })
        .collect()
}

/// Scalar product.
pub fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Two unit normals of a tangent: the second horizontal and as near to +y as can be, so that for
/// motion in the task plane the first offset lies in the plane and the second out of it.
pub fn normals(along: [f64; 3]) -> [[f64; 3]; 2] {
    let reference = if along[1].abs() < 0.9 {
        [0.0, 1.0, 0.0]
    } else {
        [0.0, 0.0, 1.0]
    };
    let share = dot(reference, along);
    let raw: [f64; 3] = std::array::from_fn(|k| reference[k] - share * along[k]);
    let size = dot(raw, raw).sqrt();
    let second = raw.map(|c| c / size);
    let first = [
        along[1] * second[2] - along[2] * second[1],
        along[2] * second[0] - along[0] * second[2],
        along[0] * second[1] - along[1] * second[0],
    ];
    [first, second]
}

fn project(point: [f64; 3], segments: &[Segment], radius_m: f64) -> Option<Projected> {
    let mut best: Option<(f64, f64, &Segment)> = None;
    for segment in segments {
        let d: [f64; 3] = std::array::from_fn(|k| point[k] - segment.from_m[k]);
        let along = dot(d, segment.along);
        let inside = along.clamp(0.0, segment.length_m);
        let square = dot(d, d) - along * along + (along - inside) * (along - inside);
        if best.is_none_or(|(s, _, _)| square < s) {
            best = Some((square, along, segment));
        }
    }
    let (square, along, segment) = best?;
    let s = segment.arc_start_m + along / segment.length_m * (segment.arc_end_m - segment.arc_start_m);
    // Points past the ends lie on the caps, whose distance is not that of the side.
    let first = &segments[0];
    let last = &segments[segments.len() - 1];
    if s < first.arc_start_m || s > last.arc_end_m || square.sqrt() > radius_m + GATE_M {
        return None;
    }
    let d: [f64; 3] = std::array::from_fn(|k| point[k] - segment.from_m[k] - along * segment.along[k]);
    Some(Projected {
        arc_m: s,
        across_m: Vector2::new(dot(d, segment.normals[0]), dot(d, segment.normals[1])),
    })
}

/// Centre of points that fill a disc evenly: their mean.
fn filled_centre(points: &[(Projected, f64)], noise_m: f64) -> (Vector2<f64>, Matrix2<f64>) {
    let sum: f64 = points.iter().map(|(_, share)| share).sum();
    let squares: f64 = points.iter().map(|(_, share)| share * share).sum();
    let centre = points
        .iter()
        .map(|(p, share)| p.across_m * *share)
        .sum::<Vector2<f64>>()
        / sum;
    (
        centre,
        Matrix2::identity() * (noise_m * noise_m * squares / (sum * sum)),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demo::MarkerSample;
    use std::path::Path;

    /// Markers at 0.05, 0.15 and 0.2 m, of which the first is not seen in the second frame: the others
    /// keep their stations, else their residuals would be compared with those of another marker.
    #[test]
    fn a_marker_that_is_missing_in_a_frame_does_not_shift_the_stations_of_others() {
        let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("demos/sample-rope/fit");
        let mut demo = Demo::load(dir).unwrap();
        let marker = |t_s: f64, s_m: f64| MarkerSample {
            t_s,
            marker: format!("{s_m}"),
            s_m,
            position_m: [s_m, 0.0, 0.1],
        };
        // Within a frame the rows need not be in the order of the arc length.
        demo.observations = Observations::Markers(vec![
            marker(0.0, 0.2),
            marker(0.0, 0.05),
            marker(0.0, 0.15),
            marker(0.1, 0.15),
            marker(0.1, 0.2),
        ]);
        let line = Centreline {
            arc_m: &[0.0, 0.25],
            points_m: &[[0.0, 0.0, 0.1], [0.25, 0.0, 0.1]],
            length_m: 0.25,
            filled_m: &[],
        };
        let stations = |frame: usize| -> Vec<(usize, f64)> {
            let rows = measure(&demo, frame, &line, Section::default());
            rows.iter().map(|r| (r.station, r.arc_m)).collect()
        };
        assert_eq!(stations(0)[0], (2, 0.2));
        assert_eq!(stations(0)[3], (0, 0.05));
        assert_eq!(stations(1)[0], (1, 0.15));
        assert_eq!(stations(1)[3], (2, 0.2));
        assert_eq!(most_rows(&demo), [9, 6]);
        demo.spec.planar = true;
        let rows = measure(&demo, 1, &line, Section::default());
        assert!(rows.len() == 4 && rows.iter().all(|r| r.direction[1] == 0.0));
        assert_eq!(most_rows(&demo)[1], 4);
    }

    /// Half of a rope's surface is seen; the prediction is off by a known vector.
    #[test]
    fn half_a_surface_gives_the_offset_of_the_axis() {
        let arc_m: Vec<f64> = (0..50).map(|i| 0.005 * (i as f64 + 0.5)).collect();
        let points_m: Vec<[f64; 3]> = arc_m.iter().map(|&s| [s, 0.0, 0.1]).collect();
        let line = Centreline {
            arc_m: &arc_m,
            points_m: &points_m,
            length_m: 0.25,
            filled_m: &[],
        };
        let truth = [0.0, 0.004, 0.103];
        let cloud: Vec<[f64; 3]> = (0..2000)
            .map(|i| {
                let s = 0.25 * ((i * 7919) % 2000) as f64 / 2000.0;
                let angle = -0.3 + 2.6 * ((i * 104729) % 2000) as f64 / 2000.0;
                [s, truth[1] + 0.007 * angle.cos(), truth[2] + 0.007 * angle.sin()]
            })
            .collect();
        let shape = SectionShape {
            section: Section::Surface,
            radius_m: 0.007,
            cameras_m: Vec::new(),
        };
        let rows = measure_cloud(&cloud, 0, &line, &shape, 0.001);
        assert_eq!(rows.len(), 2 * STATIONS);
        for row in rows {
            let expected = row.direction[1] * 0.004 + row.direction[2] * 0.003;
            assert!((row.offset_m - expected).abs() < 2e-5, "{row:?}");
        }
    }

    /// Slices of points that fill a rope and lean, as those of a bent rope do, say that it lies where it lies, but for the
    /// ends, where shares are one-sided; against the predicted rope's own points they do everywhere. When every point
    /// counted for one station alone, neighbours into which a slice reached were up to a millimetre off.
    #[test]
    fn sections_that_lean_are_centred_where_they_are() {
        const LEAN: f64 = 0.05;
        const HALF_M: f64 = 0.005;
        let arc_m: Vec<f64> = (0..53).map(|i| 0.25 * (f64::from(i) + 0.5) / 53.0).collect();
        let points_m: Vec<[f64; 3]> = arc_m.iter().map(|&s| [s, 0.0, 0.1]).collect();
        let corner = |s: f64, [y, z]: [f64; 2]| [s + LEAN * z * HALF_M, y * HALF_M, 0.1 + z * HALF_M];
        let corners = [[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]];
        let slice = |&s: &f64| corners.map(|at| corner(s, at));
        let cloud: Vec<[f64; 3]> = arc_m.iter().flat_map(slice).collect();
        let shape = SectionShape {
            section: Section::Filled,
            radius_m: 0.007,
            cameras_m: Vec::new(),
        };
        let rows = |filled_m: &[[f64; 3]]| {
            let line = Centreline {
                arc_m: &arc_m,
                points_m: &points_m,
                length_m: 0.25,
                filled_m,
            };
            measure_cloud(&cloud, 0, &line, &shape, 0.0)
        };
        let (alone, beside) = (rows(&[]), rows(&cloud));
        assert_eq!([alone.len(), beside.len()], [2 * STATIONS; 2]);
        for row in alone
            .iter()
            .filter(|row| (1..STATIONS - 1).contains(&row.station))
        {
            assert!(row.offset_m.abs() < 1e-5, "{row:?}");
        }
        for row in beside {
            assert!(row.offset_m.abs() < 1e-12, "{row:?}");
        }
    }
}
