//! Finds the stiffness of a rope from how it falls, by the gradient that rides along with a rollout.
//!
//! A rope is held level at one end and let go at the other. What it did is known at some times; from a
//! guess three times too soft, each round simulates once with the derivative with respect to ln E and
//! takes a Gauss-Newton step.
//!
//! ```sh
//! cargo run --release -p offline --no-default-features --example fit_stiffness
//! ```

use offline::demo::RopeEnd;
use offline::sim::Laned;
use offline::sim::clamp::ClampPath;
use offline::sim::rope::RopeShape;
use offline::sim::scene::{Grip, Scene};
use offline::sim::{Dual, Physics, Real, Rollout, SimError, simulate};

/// The stiffness that made the recording, Pa.
pub const TRUE_PA: f64 = 0.45e6;
const GUESS_PA: f64 = 0.15e6;
const ROUNDS: usize = 8;

fn scene() -> Result<Scene, SimError> {
    let rope = RopeShape::of_density(0.14, 0.014, 1000.0);
    let grips = vec![Grip {
        end: RopeEnd::Start,
        length_m: 0.02,
        path: ClampPath::fixed([0.0; 3]),
    }];
    let times = (1..=8).map(|k| 0.025 * f64::from(k)).collect();
    Scene::new(rope, [0.0; 3], [1.0, 0.0, 0.0], grips, None, 1.5, times)
}

fn fall<T: Laned>(scene: &Scene, ln_young: T) -> Result<Rollout<T>, SimError> {
    simulate(scene, &Physics::base(ln_young.exp(), T::of(0.3), T::of(0.5)))
}

/// Prints the way from the guess to the answer, and returns it, Pa.
pub fn main() -> Result<(), SimError> {
    fit().map(|_| ())
}

/// Young's modulus as found, Pa.
pub fn fit() -> Result<f64, SimError> {
    let scene = scene()?;
    let recording = fall(&scene, TRUE_PA.ln())?;
    let mut ln_young = GUESS_PA.ln();
    for round in 0..ROUNDS {
        let rollout = fall(&scene, Dual::<f64, 1>::input(ln_young, 0))?;
        let simulated = rollout.frames.iter().flatten().flatten();
        let (mut square, mut descent, mut curvature, mut count) = (0.0, 0.0, 0.0, 0.0);
        for (x, recorded) in simulated.zip(recording.frames.iter().flatten().flatten()) {
            let off = x.value() - recorded;
            square += off * off;
            descent -= x.tangent[0] * off;
            curvature += x.tangent[0] * x.tangent[0];
            count += 1.0;
        }
        println!(
            "round {round}: E = {:.6} MPa, off by {:.6} mm rms",
            1e-6 * ln_young.exp(),
            1e3 * f64::sqrt(square / count)
        );
        ln_young += (descent / curvature).clamp(-0.7, 0.7);
    }
    println!("true:    E = {:.6} MPa", 1e-6 * TRUE_PA);
    Ok(ln_young.exp())
}
