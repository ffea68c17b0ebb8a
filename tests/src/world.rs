//! An experiment in the twin world: what is declared, what really happens, what is recorded.

use crate::camera::{SensorSpec, observe};
use crate::contact::Table;
use crate::dynamics::{ClampMotion, Material, World};
use crate::effects::WorldEffects;
use nalgebra::Vector3;
use offline::demo::{
    CameraSpec, ClampSample, ClampSpec, CloudFrame, Demo, DemoSpec, FORMAT, Observations, SceneKind,
    StartState, TableSpec,
};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Rate at which clamp poses are recorded, Hz.
const CLAMP_RATE_HZ: u32 = 100;

/// An experiment as its makers believe it to be, and the rope's true stiffness.
#[derive(Clone, Debug)]
pub struct WorldSpec {
    /// Name of the demonstration.
    pub name: String,
    /// Notes in the demonstration.
    pub notes: String,
    /// Kind of experiment.
    pub scene: SceneKind,
    /// The rope.
    pub material: Material,
    /// Where the rope's start is at first, m.
    pub start_m: [f64; 3],
    /// The table.
    pub table: TableSpec,
    /// Clamps and their paths.
    pub clamps: Vec<ClampMotion>,
    /// The cameras.
    pub cameras: Vec<CameraSpec>,
    /// Their depth.
    pub sensor: SensorSpec,
    /// Frames per second.
    pub frame_rate_hz: f64,
    /// Length of the recording, s.
    pub duration_s: f64,
}

/// The rope's true axis at one instant.
#[derive(Clone, Debug)]
pub struct TruthFrame {
    /// Time on the cameras' clock, s.
    pub t_s: f64,
    /// Equally spaced nodes from s = 0 to s = length, m.
    pub nodes_m: Vec<Vector3<f64>>,
}

/// What happens: the rope's axis at every frame of the recording.
pub fn simulate(spec: &WorldSpec, effects: &WorldEffects) -> Vec<TruthFrame> {
    let table = Table {
        height_m: spec.table.height_m,
        friction: spec.table.friction,
    };
    let mut world = World::new(&spec.material, spec.start_m, Some(table), &spec.clamps, effects);
    let count = (spec.duration_s * spec.frame_rate_hz + 1e-9).floor() as usize;
    let mut frames = Vec::with_capacity(count + 1);
    for index in 0..=count {
        let t_s = index as f64 / spec.frame_rate_hz;
        world.advance_to((t_s - effects.clock_offset_s).max(0.0));
        frames.push(TruthFrame {
            t_s: round(t_s, 1e6),
            nodes_m: world.rod.x.clone(),
        });
    }
    frames
}

/// What is recorded: declared values, commanded clamp paths and what the cameras saw.
pub fn record_demo(spec: &WorldSpec, effects: &WorldEffects, seed: u64) -> Demo {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let radius = 0.5 * spec.material.rope.diameter_m;
    let mut frames = Vec::new();
    for truth in simulate(spec, effects) {
        let mut points_m = observe(
            &spec.cameras,
            effects.camera_offset_m,
            &truth.nodes_m,
            radius,
            &spec.sensor,
            &mut random,
        );
        for point in &mut points_m {
            *point = effects.seen_at(*point, spec.start_m);
        }
        // A lab leaves out a frame in which the rope has left the image.
        if !points_m.is_empty() {
            frames.push(CloudFrame {
                t_s: truth.t_s,
                points_m,
            });
        }
    }
    Demo {
        name: spec.name.clone(),
        spec: declared(spec),
        clamps: spec
            .clamps
            .iter()
            .map(|clamp| clamp_samples(clamp, spec.duration_s))
            .collect(),
        commanded: vec![None; spec.clamps.len()],
        observations: Observations::Clouds(frames),
    }
}

fn declared(spec: &WorldSpec) -> DemoSpec {
    let clamp = |motion: &ClampMotion| ClampSpec {
        end: motion.end,
        grip_m: motion.grip_m,
        direction: None,
    };
    DemoSpec {
        format: FORMAT.to_owned(),
        scene: spec.scene,
        noise_m: spec.sensor.noise_m,
        planar: false,
        notes: spec.notes.clone(),
        start: StartState::Straight,
        rope: spec.material.rope.clone(),
        table: Some(spec.table.clone()),
        clamps: spec.clamps.iter().map(clamp).collect(),
        cameras: spec.cameras.clone(),
    }
}

fn clamp_samples(clamp: &ClampMotion, duration_s: f64) -> Vec<ClampSample> {
    let count = (duration_s * f64::from(CLAMP_RATE_HZ)).ceil() as u32;
    let sample = |index: u32| {
        let t_s = f64::from(index) / f64::from(CLAMP_RATE_HZ);
        let position = clamp.path.position_m(t_s);
        ClampSample {
            t_s,
            position_m: [position.x, position.y, position.z].map(|x| round(x, 1e7)),
            quaternion_xyzw: [0.0, 0.0, 0.0, 1.0],
            closed: clamp.opens_at_s.is_none_or(|at| t_s < at),
        }
    };
    (0..=count).map(sample).collect()
}

/// To multiples of 1/`per_unit`, so that files stay short and readable.
fn round(value: f64, per_unit: f64) -> f64 {
    (value * per_unit).round() / per_unit
}
