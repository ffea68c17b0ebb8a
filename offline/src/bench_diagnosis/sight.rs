//! How the rope of a cell is seen: as labelled points along it, or as the clouds of two depth cameras.

use super::cells::Cell;
use super::experiment::{DIAMETER_M, LENGTH_M, Motion, Track, marker_arcs_m, seen};
use crate::demo::{CloudFrame, Demo, Observations};
use crate::depth_cameras::{DepthSensor, cameras};
use crate::observe::{bracket, interpolate};

/// Step in which the depth cameras tell distances, m.
const QUANTUM_M: f64 = 1e-3;
/// Points that both cameras together keep of a frame.
const CLOUD_POINTS: usize = 250;
/// How far off a cloud says that the rope's axis is, against the noise of single points: root mean square over stations and
/// directions, as frames at rest tell it. Declared is half of that noise, because a circle's points are thought to be off in
/// every direction across the rope, and those of a camera are along its rays only.
const CLOUD_FLOOR: f64 = 0.35;

/// The noise floor of a cell, in which the strength of its causes is counted, mm.
pub fn floor_mm(cell: &Cell) -> f64 {
    let of_one_point = if cell.clouds { CLOUD_FLOOR } else { 1.0 };
    of_one_point * cell.noise_mm
}

/// A motion as a cell has it seen, where the markers are on `track`.
pub fn see(cell: &Cell, motion: &Motion, track: &Track, seed: u64) -> Demo {
    let mut demo = motion.demo(track, 1e-3 * cell.noise_mm, seed);
    if cell.clouds {
        demo.spec.cameras = cameras();
        see_again(cell, &mut demo, track, seed);
    }
    demo
}

/// Has a demonstration that declares everything else seen as a cell has it.
pub fn see_again(cell: &Cell, demo: &mut Demo, track: &Track, seed: u64) {
    let times_s = demo.times_s();
    let noise_m = 1e-3 * cell.noise_mm;
    demo.observations = if cell.clouds {
        Observations::Clouds(clouds(&times_s, track, noise_m, seed))
    } else {
        Observations::Markers(seen(&times_s, track, noise_m, seed))
    };
}

fn clouds(times_s: &[f64], track: &Track, noise_m: f64, seed: u64) -> Vec<CloudFrame> {
    let sensor = DepthSensor {
        noise_m,
        quantum_m: QUANTUM_M,
        points: CLOUD_POINTS,
    };
    let lines_m: Vec<Vec<[f64; 3]>> = track.iter().map(|markers_m| visible_line(markers_m)).collect();
    let clouds = sensor.clouds(&lines_m, 0.5 * DIAMETER_M, seed);
    let frame = |(&t_s, points_m)| CloudFrame { t_s, points_m };
    times_s.iter().zip(clouds).map(frame).collect()
}

/// Pieces of the line from one marker to the next.
const PIECES: usize = 8;

/// The rope's axis where it is seen: from the first marker, up to which the gripper hides it, to its free end. Between
/// markers it is the cubic of Catmull and Rom (1974) through them, beyond the last one, where nothing bends it, straight.
fn visible_line(markers_m: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let arcs_m = marker_arcs_m();
    // The markers with one more at either end, which goes on as the curve began.
    let mirrored =
        |at: usize, other: usize| std::array::from_fn(|k| 2.0 * markers_m[at][k] - markers_m[other][k]);
    let last = markers_m.len() - 1;
    let mut knots: Vec<[f64; 3]> = vec![mirrored(0, 1)];
    knots.extend(markers_m);
    knots.push(mirrored(last, last - 1));
    let mut line: Vec<[f64; 3]> = Vec::with_capacity(PIECES * last + 2);
    for around in knots.windows(4) {
        line.extend((0..PIECES).map(|piece| catmull_rom(around, piece as f64 / PIECES as f64)));
    }
    line.push(markers_m[last]);
    line.push(interpolate(markers_m, bracket(&arcs_m, LENGTH_M)));
    line
}

/// The point a share `u` of the way from the second of four knots to the third.
fn catmull_rom(around: &[[f64; 3]], u: f64) -> [f64; 3] {
    std::array::from_fn(|k| {
        let [a, b, c, d] = [0, 1, 2, 3].map(|i| around[i][k]);
        b + 0.5 * u * (c - a + u * (2.0 * a - 5.0 * b + 4.0 * c - d + u * (3.0 * (b - c) + d - a)))
    })
}

#[cfg(test)]
mod tests {
    use super::super::cells::{Extent, matrix};
    use super::super::experiment::MOTIONS;
    use super::super::reality::{Finer, Reality};
    use super::*;
    use crate::diagnose::Noise;
    use crate::fit::{Problem, Resolution};
    use crate::model::Structure;
    use crate::observe::noise_m;

    fn cell() -> Cell {
        let extent = Extent {
            quick: true,
            seeds: 1,
            first_seed: 1,
            alone: false,
            clouds: true,
        };
        matrix(&Finer.repertoire(), &extent).remove(0)
    }

    /// On an arc of a radius to which no demonstration bends the rope, 30 mm.
    #[test]
    fn the_line_between_markers_is_that_of_the_rope() {
        const RADIUS_M: f64 = 0.03;
        let on = |s_m: f64| {
            let angle = s_m / RADIUS_M;
            [RADIUS_M * angle.cos(), 0.0, RADIUS_M * angle.sin()]
        };
        let markers_m: Vec<[f64; 3]> = marker_arcs_m().into_iter().map(on).collect();
        let line = visible_line(&markers_m);
        let inner = &line[PIECES..line.len() - 1 - PIECES];
        let off = |p: &[f64; 3]| (p[0].hypot(p[2]) - RADIUS_M).abs();
        let worst = inner.iter().map(off).fold(0.0, f64::max);
        assert!(worst < 1e-4, "{worst} m");
        let tip = line[line.len() - 1];
        let reached: f64 = (0..3).map(|k| (tip[k] - markers_m[15][k]).powi(2)).sum();
        assert!((reached.sqrt() / (0.5 * 0.23 / 16.0) - 1.0).abs() < 0.02);
    }

    /// What is told of a rope without a cause lies where it is, and the floor in which causes are counted is that of what is
    /// told.
    #[test]
    fn clouds_lie_around_the_rope_and_their_floor_is_the_one_that_is_counted_in() {
        const YOUNG_PA: f64 = 0.4e6;
        let cell = cell();
        let track = Finer
            .rough_tracks(YOUNG_PA, &[], &MOTIONS[..1])
            .unwrap()
            .remove(0);
        let demo = see(&cell, &MOTIONS[0], &track, 5);
        let problem = Problem::new(&[&demo], Resolution::COARSEST).unwrap();
        let structure = Structure::default();
        let left = problem.residuals(&structure, &structure.start(YOUNG_PA)).unwrap();
        let floor_m = Noise::measured(&problem, &left).scale * noise_m(left.all_rows());
        let counted_m = 1e-3 * floor_mm(&cell);
        assert!(
            (floor_m / counted_m - 1.0).abs() < 0.1,
            "{floor_m} against {counted_m}"
        );
        // The rest is between the two simulations.
        let off_m = left.rms_m();
        assert!(
            off_m > floor_m && off_m < 2.0 * floor_m,
            "{off_m} against {floor_m}"
        );
    }
}
