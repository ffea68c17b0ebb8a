//! The swing task in the twin world: the rope hangs from a fixed clamp, its bottom end is dragged
//! to a release point and let go; the score is the largest x that the tip reaches.

use crate::dynamics::{ClampMotion, Material};
use crate::effects::WorldEffects;
use crate::motion::{ClampPath, Leg};
use crate::sample_rope::{depth_sensor, material, two_cameras};
use crate::world::{TruthFrame, WorldSpec, simulate};
use offline::demo::{RopeEnd, SceneKind, TableSpec};
use shared::profile::MotionLimits;
use shared::task::SwingTask;

/// Rest before the drag, s.
const REST_S: f64 = 0.3;
/// Time after the release in which the tip is watched, s.
const WATCH_S: f64 = 1.0;

/// So slow that a rope with next to no loss hangs still when it is released, as the program's does.
const CALM: MotionLimits = MotionLimits {
    speed_m_s: 0.1,
    acceleration_m_s2: 0.1,
    jerk_m_s3: 0.2,
};

/// Leans the gravity of the rod out of the plane as the program's: ropes that are folded fall to that side. Without it a
/// rope of 0.9 MPa stays in the plane and reaches 8 mm further from (0.08, 0.15).
const LEAN_RAD: f64 = 1e-3;

/// How far the program may be from the rod, m: set before the first run; the grid may bend 5 % too stiffly, which moves the
/// reach by 2 mm (design, section 4), and the rod knows no thickness at its clamps.
pub const TOLERANCE_M: f64 = 5e-3;

/// Reach of the sample rope with another Young's modulus, Pa, and effects, in the rod whose gravity leans, m.
pub fn calm_reach_m(young_pa: f64, effects: &WorldEffects, release_m: [f64; 2]) -> f64 {
    let leaning = WorldEffects {
        tilt_rad: [0.0, LEAN_RAD],
        ..effects.clone()
    };
    let mut rope = material();
    rope.young_pa = young_pa;
    let spec = swing("swing", rope, &SwingTask::PAPER, release_m, &CALM);
    reach_m(&spec, &simulate(&spec, &leaning))
}

/// A swing of the rope released at `release_m`, (x, z) in m, dragged within `limits`.
///
/// The fixed clamp holds the rope's first piece down from its top end; the gripper's pose is that of the bottom end.
pub fn swing(
    name: &str,
    mut material: Material,
    task: &SwingTask,
    release_m: [f64; 2],
    limits: &MotionLimits,
) -> WorldSpec {
    material.rope.direction = [0.0, 0.0, -1.0];
    let start_m = [task.top_m[0], 0.0, task.top_m[1]];
    let end_m = [start_m[0], 0.0, start_m[2] - material.rope.length_m];
    let drag = Leg {
        to_m: [release_m[0], 0.0, release_m[1]],
        limits: *limits,
        pause_s: task.dwell_s,
    };
    let dragged = ClampPath::new(end_m, REST_S, &[drag]);
    let release_s = dragged.duration_s();
    let clamp = |end, grip_m, path, opens_at_s| ClampMotion {
        end,
        grip_m,
        path,
        opens_at_s,
    };
    WorldSpec {
        name: name.to_owned(),
        notes: "Rope hanging from a fixed clamp, dragged at its bottom end and released.".to_owned(),
        scene: SceneKind::Swing,
        material,
        start_m,
        table: TableSpec {
            height_m: 0.0,
            friction: 0.5,
        },
        clamps: vec![
            clamp(
                RopeEnd::Start,
                task.grip_m,
                ClampPath::new(start_m, 0.0, &[]),
                None,
            ),
            clamp(RopeEnd::End, task.grip_m, dragged, Some(release_s)),
        ],
        cameras: two_cameras(),
        sensor: depth_sensor(),
        frame_rate_hz: 100.0,
        duration_s: release_s + WATCH_S,
    }
}

/// The score: the largest x of the rope's end from the release on, m.
pub fn reach_m(spec: &WorldSpec, frames: &[TruthFrame]) -> f64 {
    let release_s = spec.duration_s - WATCH_S;
    let swing = frames.iter().filter(|frame| frame.t_s >= release_s);
    let tips = swing.filter_map(|frame| frame.nodes_m.last());
    tips.map(|tip| tip.x).fold(f64::NEG_INFINITY, f64::max)
}
