//! Small scenes of the simulator for tests: what the verification suite has, knots at rest, rest states.

use offline::sim::clamp::Knot;
use offline::sim::rope::RopeShape;
use offline::sim::scene::{Grip, Scene, Settling};
use offline::verify::setup;
pub use offline::verify::setup::{rope, start_grip, tip};

/// A knot of a path that does not turn and has no speed there.
pub fn knot(t_s: f64, position_m: [f64; 3], closed: bool) -> Knot {
    setup::knot(t_s, position_m, [0.0; 3], closed)
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
        still_m_s: 0.0,
    });
    scene
}
