//! The ropes and scenes of the suite.

use crate::demo::RopeEnd;
use crate::sim::clamp::{ClampPath, Knot};
use crate::sim::rope::RopeShape;
use crate::sim::scene::{Grip, Scene, Table};
use crate::sim::tensor::value3;
use crate::sim::{Physics, Real, SimError};

/// Acceleration of free fall, m/s².
pub const G_M_S2: f64 = crate::sim::physics::GRAVITY_M_S2;
/// Poisson's ratio of the suite's ropes.
pub const POISSON: f64 = 0.3;
/// Density of the suite's ropes, kg/m³.
pub const DENSITY_KG_M3: f64 = 1000.0;
/// Diameter of the paper's rope, m.
pub const DIAMETER_M: f64 = 0.014;
/// At this stiffness the rope moves in steps that the speed bound sets, not the wave speed: the step
/// does not depend on E and ν, as tangents assume.
pub const SOFT_PA: f64 = 0.4e6;

/// A rope of the suite's density.
pub fn rope(length_m: f64, diameter_m: f64) -> RopeShape {
    RopeShape::of_density(length_m, diameter_m, DENSITY_KG_M3)
}

/// An elastic rope on a table with friction 0.5.
pub fn elastic(young_pa: f64) -> Physics<f64> {
    Physics::base(young_pa, POISSON, 0.5)
}

/// A physics with an effect of the registry.
///
/// # Panics
/// The registry has no such effect.
pub fn with_effect(id: &str, values: &[f64], mut physics: Physics<f64>) -> Physics<f64> {
    let index = crate::effects::find(id).expect("the registry has the effect");
    crate::effects::add_to(index, values, &mut physics);
    physics
}

/// A knot without rotation.
pub fn knot(t_s: f64, position_m: [f64; 3], velocity_m_s: [f64; 3], closed: bool) -> Knot {
    let ([x, y, z], [u, v, w]) = (position_m, velocity_m_s);
    Knot {
        t_s,
        pose: [x, y, z, 0.0, 0.0, 0.0, 1.0],
        rate: [u, v, w, 0.0, 0.0, 0.0, 0.0],
        closed,
    }
}

/// A grip on the start of a rope.
pub fn start_grip(length_m: f64, path: ClampPath) -> Vec<Grip> {
    vec![Grip {
        end: RopeEnd::Start,
        length_m,
        path,
    }]
}

/// A scene whose rope starts at the origin, with one frame at its end.
///
/// # Errors
/// As [`Scene::new`].
pub fn scene(
    shape: RopeShape,
    direction: [f64; 3],
    grips: Vec<Grip>,
    table_m: Option<f64>,
    cells: f64,
    end_s: f64,
) -> Result<Scene, SimError> {
    let table = table_m.map(|height_m| Table { height_m });
    Scene::new(shape, [0.0; 3], direction, grips, table, cells, vec![end_s])
}

/// A short rope without grips on the coarsest grid, along `direction`.
///
/// # Panics
/// Never: the scene is possible.
pub fn free_scene(direction: [f64; 3], table_m: Option<f64>) -> Scene {
    scene(rope(0.12, DIAMETER_M), direction, vec![], table_m, 1.5, 0.3).expect("the scene is possible")
}

/// The end point of the axis in a frame of the scene.
pub fn tip<T: Real>(scene: &Scene, frame: &[[T; 3]]) -> [f64; 3] {
    let n = frame.len();
    let (last, before) = (value3(frame[n - 1]), value3(frame[n - 2]));
    let weights = scene.layout().end_weights();
    std::array::from_fn(|k| weights[0] * last[k] + weights[1] * before[k])
}
