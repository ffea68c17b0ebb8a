//! How a rope moves where and when a force may push it.

use super::estimate::block_of;
use crate::fit::{KNOTS, Pushes};
use crate::observe::{bracket, interpolate};
use crate::sim::tensor::{Vec3, norm, scaled, sub};
use crate::sim::{Rollout, Scene};

/// Motion of the rope at a knot, mean over a block of time.
#[derive(Clone, Debug, Default)]
pub(super) struct Motion {
    /// m.
    pub(super) position_m: Vec3<f64>,
    /// m/s.
    pub(super) velocity_m_s: Vec3<f64>,
    /// m/s².
    pub(super) acceleration_m_s2: Vec3<f64>,
    /// From start to end, a unit vector.
    pub(super) tangent: Vec3<f64>,
    /// Towards the inside of the bend, 1/m.
    pub(super) curvature_per_m: Vec3<f64>,
    /// Its change, 1/(m s).
    pub(super) bending_per_m_s: Vec3<f64>,
    /// Whether the rope lies on the table.
    pub(super) on_table: bool,
    /// Which knot it is, from 0 at the start.
    pub(super) knot: usize,
}

impl Motion {
    pub(super) fn speed_m_s(&self) -> f64 {
        norm(self.velocity_m_s)
    }
}

/// A frame at a knot.
struct Instant {
    position_m: Vec3<f64>,
    velocity_m_s: Vec3<f64>,
    tangent: Vec3<f64>,
    curvature_per_m: Vec3<f64>,
}

/// Mean motions by block and knot. A block without a frame moves as the frame nearest to its middle.
pub(super) fn motions(scene: &Scene, rollout: &Rollout<f32>, pushes: &Pushes) -> Vec<[Motion; KNOTS]> {
    let times_s = &scene.frame_times_s;
    let table_m = scene
        .table
        .map(|table| table.height_m + 1.5 * scene.rope.diameter_m);
    let of_block = |block: usize| -> Vec<usize> {
        let inside = |&frame: &usize| block_of(times_s[frame], pushes) == block;
        let frames: Vec<usize> = (0..times_s.len()).filter(inside).collect();
        if !frames.is_empty() {
            return frames;
        }
        let middle_s = (block as f64 + 0.5) * pushes.block_s;
        let away = |&frame: &usize| (times_s[frame] - middle_s).abs();
        let nearest = (0..times_s.len()).min_by(|a, b| away(a).total_cmp(&away(b)));
        nearest.into_iter().collect()
    };
    let instants: Vec<Vec<Instant>> = (0..KNOTS)
        .map(|knot| {
            let arc_m = pushes.knots_m[knot];
            (0..times_s.len())
                .map(|frame| instant(rollout, frame, arc_m))
                .collect()
        })
        .collect();
    let at = |frames: &[usize], knot: usize| {
        let mut motion = mean(times_s, &instants[knot], frames);
        motion.on_table = table_m.is_some_and(|height_m| motion.position_m[2] < height_m);
        motion.knot = knot;
        motion
    };
    (0..pushes.blocks)
        .map(of_block)
        .map(|frames| std::array::from_fn(|knot| at(&frames, knot)))
        .collect()
}

fn instant(rollout: &Rollout<f32>, frame: usize, arc_m: f64) -> Instant {
    let arcs_m = &rollout.arc_m;
    let [first_m, last_m] = [arcs_m[0], arcs_m[arcs_m.len() - 1]];
    // A span over which a curvature is seen, inside the rope.
    let half_m = (last_m - first_m) / 12.0;
    let middle_m = arc_m.clamp(first_m + half_m, last_m - half_m);
    let track = &rollout.tracks[frame];
    let place = |s_m: f64| interpolate(&track.points_m, bracket(arcs_m, s_m));
    let [before, middle, after] = [-half_m, 0.0, half_m].map(|by_m| place(middle_m + by_m));
    let [inwards, outwards] = [sub(middle, before), sub(after, middle)];
    let chord = sub(after, before);
    Instant {
        position_m: place(arc_m.clamp(first_m, last_m)),
        velocity_m_s: interpolate(
            &track.velocities_m_s,
            bracket(arcs_m, arc_m.clamp(first_m, last_m)),
        ),
        tangent: scaled(chord, 1.0 / norm(chord).max(1e-12)),
        curvature_per_m: scaled(sub(outwards, inwards), 1.0 / (half_m * half_m)),
    }
}

fn mean(times_s: &[f64], instants: &[Instant], frames: &[usize]) -> Motion {
    let share = 1.0 / frames.len().max(1) as f64;
    let mut motion = Motion::default();
    for &frame in frames {
        let (before, after) = (frame.saturating_sub(1), (frame + 1).min(instants.len() - 1));
        let per_s = 1.0 / (times_s[after] - times_s[before]).max(1e-9);
        let [a, b] = [&instants[before], &instants[after]];
        let now = &instants[frame];
        for k in 0..3 {
            motion.position_m[k] += share * now.position_m[k];
            motion.velocity_m_s[k] += share * now.velocity_m_s[k];
            motion.tangent[k] += share * now.tangent[k];
            motion.curvature_per_m[k] += share * now.curvature_per_m[k];
            motion.acceleration_m_s2[k] += share * per_s * (b.velocity_m_s[k] - a.velocity_m_s[k]);
            motion.bending_per_m_s[k] += share * per_s * (b.curvature_per_m[k] - a.curvature_per_m[k]);
        }
    }
    motion.tangent = scaled(motion.tangent, 1.0 / norm(motion.tangent).max(1e-12));
    motion
}
