//! The rod as a reality of the diagnosis' benchmark: effects of the library translated into what the twin
//! world calls them, and causes that the library does not hold.

use crate::contact::Table;
use crate::dynamics::{ClampMotion, Material, World};
use crate::effects::{AirJet, GripSlip, StiffPiece, WorldEffects};
use crate::motion::{ClampPath, Leg};
use nalgebra::Vector3;
use offline::bench_diagnosis::experiment::{FRICTION, GRIP_M, Motion, Track, marker_arcs_m, rope};
use offline::bench_diagnosis::reality::{Part, Reality};
use offline::demo::RopeEnd;

/// The independent rod.
pub struct Rod;

const SEGMENTS: usize = 50;
/// Retardation time of the rope, s: small, it only quiets the shortest waves.
const RETARDATION_S: f64 = 1e-4;
/// Middle of the motions, where a jet blows, m.
const JET_M: [f64; 3] = [0.08, 0.0, 0.15];

/// What happens to the rope, and what the cameras make of it beyond what the twin world knows.
#[derive(Default)]
struct Played {
    world: WorldEffects,
    /// The cameras move, m/s.
    drift_m_s: f64,
    /// The cameras' scale is off, relative.
    scale: f64,
}

impl Reality for Rod {
    fn name(&self) -> &'static str {
        "g3"
    }

    fn revision(&self) -> u32 {
        0
    }

    fn effects(&self) -> Vec<&'static str> {
        vec![
            "air_drag",
            "internal_damping",
            "table_friction",
            "tilted_gravity",
            "tip_mass",
            "density_gradient",
            "rest_curvature",
            "curvature_gradient",
            "bending_ratio",
            "strain_stiffening",
            "steady_wind",
            "gripper_lag",
            "clock_offset",
            "release_delay",
            "camera_offset",
            "clamp_compliance",
        ]
    }

    fn outside(&self) -> Vec<(&'static str, f64)> {
        vec![
            ("air_jet", 20.0),
            ("grip_slip", 30.0),
            ("stiff_piece", 50.0),
            ("camera_drift", 50.0),
            ("camera_scale", 50.0),
        ]
    }

    fn tracks(&self, young_pa: f64, parts: &[Part], motions: &[Motion]) -> Result<Vec<Track>, String> {
        Ok(motions
            .iter()
            .map(|motion| track(young_pa, parts, motion))
            .collect())
    }
}

fn played(parts: &[Part], motion: &Motion) -> Played {
    let mut played = Played::default();
    for part in parts {
        add(part, motion, &mut played);
    }
    played
}

/// Adds a cause. Sizes of causes outside the library count in 1 m/s of wind, 1 mm of slip, a piece stiffer
/// by its own stiffness, 1 mm/s of drift and 1 % of scale.
fn add(part: &Part, motion: &Motion, played: &mut Played) {
    let (v, w) = (&part.values, &mut played.world);
    match part.id.as_str() {
        "air_drag" => [w.drag_normal, w.drag_tangential, w.drag_linear_per_s] = [v[0], v[1], v[2]],
        "internal_damping" => w.damping_s = v[0],
        "table_friction" => w.friction_change = v[0],
        // The twin counts tilts the other way about x.
        "tilted_gravity" => w.tilt_rad = [-v[0], v[1]],
        "tip_mass" => w.tip_mass_kg = v[0],
        "density_gradient" => w.density_slope = v[0],
        "rest_curvature" => w.rest_curvature_per_m = v[1],
        "curvature_gradient" => w.curvature_growth_per_m2 = v[1],
        "bending_ratio" => w.bending_change = v[0] - 1.0,
        "strain_stiffening" => w.stiffening = v[0],
        "steady_wind" => {
            // The library's parameter is q = |w| w; a rope in a wind has drag as well.
            let speed = v[0].hypot(v[1]).sqrt();
            w.wind_m_s = [v[0] / speed, v[1] / speed, 0.0];
            w.drag_normal = 1.1;
        }
        "gripper_lag" => w.gripper_lag_s = v[0],
        "clock_offset" => w.clock_offset_s = v[0],
        "release_delay" => w.release_delay_s = v[0],
        "camera_offset" => {
            w.rig_shift_m = [v[0], v[1], v[2]];
            w.rig_turn_rad = [v[3], v[4], v[5]];
        }
        "clamp_compliance" => w.clamp_compliance = v[0],
        "air_jet" => {
            w.air_jet = Some(AirJet {
                centre_m: JET_M,
                radius_m: 0.05,
                velocity_m_s: [0.0, v[0], 0.0],
            });
        }
        "grip_slip" => {
            w.grip_slip = Some(GripSlip {
                at_s: 0.5 * (motion.rest_s() + motion.opens_at_s()),
                for_s: 0.1,
                by_m: 1e-3 * v[0],
            });
        }
        "stiff_piece" => {
            w.stiff_piece = Some(StiffPiece {
                from_m: 0.10,
                to_m: 0.14,
                factor: 1.0 + v[0],
            });
        }
        "camera_drift" => played.drift_m_s = 1e-3 * v[0],
        "camera_scale" => played.scale = 0.01 * v[0],
        other => panic!("the rod does not play {other}"),
    }
}

fn track(young_pa: f64, parts: &[Part], motion: &Motion) -> Track {
    let played = played(parts, motion);
    let effects = &played.world;
    let legs: Vec<Leg> = motion
        .legs
        .iter()
        .map(|leg| Leg {
            to_m: leg.to_m,
            limits: leg.limits(),
            pause_s: 0.0,
        })
        .collect();
    let clamp = ClampMotion {
        end: RopeEnd::Start,
        grip_m: GRIP_M,
        path: ClampPath::new(Motion::START_M, motion.rest_s(), &legs),
        opens_at_s: Some(motion.opens_at_s()),
    };
    let material = Material {
        rope: rope(),
        young_pa,
        segments: SEGMENTS,
        retardation_s: RETARDATION_S,
    };
    let table = Table {
        height_m: 0.0,
        friction: FRICTION,
    };
    let mut world = World::new(&material, Motion::START_M, Some(table), &[clamp], effects);
    motion
        .frame_times_s()
        .into_iter()
        .map(|t_s| {
            world.advance_to((t_s - effects.clock_offset_s).max(0.0));
            let nodes = &world.rod.x;
            marker_arcs_m()
                .into_iter()
                .map(|s| played.seen(at(nodes, s / world.rod.rest_m), t_s))
                .collect()
        })
        .collect()
}

/// The point of the axis at a number of segments from the start.
fn at(nodes: &[Vector3<f64>], segments: f64) -> [f64; 3] {
    let low = (segments as usize).min(nodes.len() - 2);
    let share = segments - low as f64;
    (nodes[low] * (1.0 - share) + nodes[low + 1] * share).into()
}

impl Played {
    /// Where the cameras make a point appear.
    fn seen(&self, point_m: [f64; 3], t_s: f64) -> [f64; 3] {
        let [x, y, z] = self.world.seen_at(point_m, Motion::START_M);
        let start = Motion::START_M;
        let scaled = |value: f64, from: f64| value + self.scale * (value - from);
        [
            scaled(x, start[0]) + self.drift_m_s * t_s,
            scaled(y, start[1]),
            scaled(z, start[2]),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use offline::bench_diagnosis::experiment::MOTIONS;
    use offline::bench_diagnosis::reality::part;

    /// Everything that it claims to play moves what is seen.
    #[test]
    fn every_cause_is_seen() {
        let motions = &MOTIONS[..1];
        let seen = |parts: &[Part]| Rod.tracks(0.4e6, parts, motions).unwrap();
        let plain = seen(&[]);
        let of_size = |id: &str, size: f64| Part {
            id: id.into(),
            values: vec![size],
        };
        let library = Rod.effects().into_iter().map(|id| part(id, 2.0));
        let outside = Rod.outside().into_iter().map(|(id, _)| of_size(id, 2.0));
        for part in library.chain(outside) {
            let moved = seen(std::slice::from_ref(&part));
            let pairs = plain
                .iter()
                .flatten()
                .flatten()
                .zip(moved.iter().flatten().flatten());
            let largest = pairs
                .map(|(a, b)| (0..3).map(|k| (a[k] - b[k]).abs()).fold(0.0, f64::max))
                .fold(0.0, f64::max);
            assert!(largest > 1e-6, "{}: {largest}", part.id);
        }
    }
}
