//! The rope and the recordings that ship with the program (`offline/demos/sample-rope`).

use crate::camera::SensorSpec;
use crate::dynamics::{ClampMotion, Material};
use crate::effects::WorldEffects;
use crate::motion::{ClampPath, Leg};
use crate::world::{WorldSpec, record_demo};
use offline::demo::{CameraSpec, Demo, RopeEnd, RopeSpec, SceneKind, TableSpec};
use shared::profile::MotionLimits;
use std::f64::consts::FRAC_PI_4;

/// Name of the folder with the recordings.
pub const ROPE_NAME: &str = "sample-rope";
/// What nobody declared about this rope: a thing of 9 g, 23 % of the rope's mass, at its free end.
pub const TIP_MASS_KG: f64 = 0.009;
/// The rope's true Young's modulus, Pa.
pub const YOUNG_PA: f64 = 0.9e6;

const LENGTH_M: f64 = 0.25;
const DIAMETER_M: f64 = 0.014;
const DENSITY_KG_M3: f64 = 1000.0;

/// The rope: 0.25 m long, 14 mm thick, 1000 kg/m³.
pub fn material() -> Material {
    let mass_kg = DENSITY_KG_M3 * FRAC_PI_4 * DIAMETER_M * DIAMETER_M * LENGTH_M;
    Material {
        rope: RopeSpec {
            length_m: LENGTH_M,
            diameter_m: DIAMETER_M,
            mass_kg: (mass_kg * 1e6).round() / 1e6,
            direction: [1.0, 0.0, 0.0],
            end_mass_kg: 0.0,
            roll_rad: 0.0,
            assumed: Vec::new(),
        },
        young_pa: YOUNG_PA,
        segments: 50,
        retardation_s: 1e-4,
    }
}

/// Motion limits with the given largest speed, m/s.
pub fn limits(speed_m_s: f64) -> MotionLimits {
    MotionLimits {
        speed_m_s,
        acceleration_m_s2: 3.0,
        jerk_m_s3: 60.0,
    }
}

/// A lift of a straight rope on the table: rest 0.3 s, the legs, hold 0.5 s; two depth cameras.
pub fn lift(name: &str, material: Material, legs: &[Leg]) -> WorldSpec {
    let start_m = [0.0, 0.0, 0.5 * material.rope.diameter_m];
    let mut path_legs = legs.to_vec();
    if let Some(last) = path_legs.last_mut() {
        last.pause_s += 0.5;
    }
    let path = ClampPath::new(start_m, 0.3, &path_legs);
    let duration_s = path.duration_s();
    WorldSpec {
        name: name.to_owned(),
        notes: "Rope at rest on the table, gripped at its start and lifted; two depth cameras.".to_owned(),
        scene: SceneKind::Lift,
        material,
        start_m,
        table: TableSpec {
            height_m: 0.0,
            friction: 0.5,
        },
        clamps: vec![ClampMotion {
            end: RopeEnd::Start,
            grip_m: 0.02,
            path,
            opens_at_s: None,
        }],
        cameras: two_cameras(),
        sensor: depth_sensor(),
        frame_rate_hz: 30.0,
        duration_s,
    }
}

/// One camera in front to the left of the rope, one to the right, both looking down at its middle.
pub fn two_cameras() -> Vec<CameraSpec> {
    let target_m = [0.12, 0.0, 0.15];
    vec![
        CameraSpec::looking_at("front-left", [0.57, 0.42, 0.48], target_m),
        CameraSpec::looking_at("front-right", [0.57, -0.42, 0.48], target_m),
    ]
}

/// A depth camera's errors: 1 mm of noise, steps of 1 mm, one pixel in ten lost, 250 points kept.
pub fn depth_sensor() -> SensorSpec {
    SensorSpec {
        noise_m: 0.001,
        quantum_m: 0.001,
        dropout: 0.1,
        most_points: 250,
    }
}

/// A line without a pause.
pub fn leg(to_m: [f64; 3], speed_m_s: f64) -> Leg {
    Leg {
        to_m,
        limits: limits(speed_m_s),
        pause_s: 0.0,
    }
}

/// The experiments behind the shipped recordings, each with its seed.
pub fn shipped_specs() -> Vec<(WorldSpec, u64)> {
    let held_out_2 = [leg([0.04, 0.06, 0.22], 0.30), leg([-0.03, -0.05, 0.34], 0.30)];
    vec![
        (lift("fit", material(), &[leg([0.0, 0.0, 0.32], 0.25)]), 11),
        (lift("held-out-1", material(), &[leg([0.0, 0.0, 0.28], 0.35)]), 12),
        (lift("held-out-2", material(), &held_out_2), 13),
    ]
}

/// The shipped recordings.
pub fn shipped_demos() -> Vec<Demo> {
    let effects = WorldEffects {
        tip_mass_kg: TIP_MASS_KG,
        ..WorldEffects::default()
    };
    let specs = shipped_specs();
    specs
        .iter()
        .map(|(spec, seed)| record_demo(spec, &effects, *seed))
        .collect()
}
