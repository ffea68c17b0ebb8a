//! Small scenes of the simulator for tests: ropes, knots of clamp paths, rest states.

use offline::demo::RopeEnd;
use offline::sim::clamp::{ClampPath, Knot};
use offline::sim::rope::RopeShape;
use offline::sim::scene::{Grip, Scene, Settling};

/// A rope of 1000 kg/m³.
pub fn rope(length_m: f64, diameter_m: f64) -> RopeShape {
    let mut shape = RopeShape {
        length_m,
        diameter_m,
        mass_kg: 1.0,
    };
    shape.mass_kg = 1000.0 * shape.volume_m3();
    shape
}

/// A knot of a path that does not turn and has no speed there.
pub fn knot(t_s: f64, position_m: [f64; 3], closed: bool) -> Knot {
    let [x, y, z] = position_m;
    Knot {
        t_s,
        pose: [x, y, z, 0.0, 0.0, 0.0, 1.0],
        rate: [0.0; 7],
        closed,
    }
}

/// A grip of the rope's start.
pub fn start_grip(length_m: f64, path: ClampPath) -> Grip {
    Grip {
        end: RopeEnd::Start,
        length_m,
        path,
    }
}

/// A rope without a table, from the origin, that comes to rest by `rest_s` and is seen then.
pub fn settled(
    shape: RopeShape,
    direction: [f64; 3],
    grips: Vec<Grip>,
    rest_s: f64,
    rate_per_s: f64,
) -> Scene {
    let mut scene = Scene::new(shape, [0.0; 3], direction, grips, None, 1.8, vec![rest_s])
        .expect("a scene that can be simulated");
    scene.settling = Some(Settling {
        until_s: rest_s,
        rate_per_s,
    });
    scene
}

/// The end point of a centreline, half a slice beyond the last.
pub fn tip(frame: &[[f64; 3]]) -> [f64; 3] {
    let (a, b) = (frame[frame.len() - 1], frame[frame.len() - 2]);
    std::array::from_fn(|k| a[k] + 0.5 * (a[k] - b[k]))
}
