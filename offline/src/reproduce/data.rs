//! What is fitted in sim2sim: ropes with known parameters, simulated otherwise than the fitter does, and
//! seen as whole particle clouds (as in the paper) or by two noisy depth cameras.

use super::adam::Parameters;
use super::scene::{DENSITY_KG_M3, Discretisation, FRICTION, demonstration, physics};
use crate::collect::stream;
use crate::depth_cameras::DepthSensor;
use crate::sim::rope::Sampling;
use crate::sim::tensor::value3;
use crate::sim::{Laned, Scene, SimError, simulate};
use rand::RngExt;
use serde::{Deserialize, Serialize};

/// Where the paper's estimator starts, and where its sim2sim truths lie: E in paper units and ν.
pub const STARTS: [[f64; 2]; 2] = [[2000.0, 8000.0], [0.2, 0.4]];
/// The whole range of the released code's demonstrations.
pub const WHOLE_RANGE: [[f64; 2]; 2] = [[500.0, 10_500.0], [0.2, 0.4]];

/// How the simulation that makes the data differs from the one that is fitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Source {
    /// Not at all, as in the paper.
    Same,
    /// Other particles and half the time step.
    Sampled,
    /// Also the grid lies elsewhere in the rope.
    Shifted,
    /// Also the grid is twice as fine.
    Finer,
}

impl Source {
    /// In words, for a table's heading.
    pub fn words(self) -> &'static str {
        match self {
            Self::Same => "the simulation that is fitted",
            Self::Sampled => "other particles and half the time step",
            Self::Shifted => "other particles, half the time step and a shifted grid",
            Self::Finer => "other particles, half the time step and a shifted grid twice as fine",
        }
    }

    /// The discretisation that makes the data for a fitter with `fitter`.
    pub fn discretisation(self, fitter: &Discretisation) -> Discretisation {
        let mut made = *fitter;
        if self == Self::Same {
            return made;
        }
        made.sampling = Sampling {
            slice_cells: 0.43,
            section_cells: 0.3,
        };
        made.step_share = 0.5;
        if self != Self::Sampled {
            made.shift_cells = [0.37, 0.21, 0.13];
        }
        if self == Self::Finer {
            made.cells *= 2.0;
        }
        made
    }
}

/// Parameters drawn uniformly from a range; the same for one seed and index.
pub fn draw(range: [[f64; 2]; 2], seed: u64, index: u64) -> Parameters {
    let mut rng = stream(seed, index);
    range.map(|[low, high]| low + (high - low) * rng.random::<f64>())
}

/// A true rope in every recorded step.
pub struct Recorded {
    /// Its diameter, m.
    pub diameter_m: f64,
    /// Middles of its slices, m.
    pub lines_m: Vec<Vec<[f64; 3]>>,
    /// Its particles, m.
    pub particles_m: Vec<Vec<[f64; 3]>>,
}

/// The true rope, simulated as `source` says: in the precision that is fitted where nothing differs, else in double.
///
/// # Errors
/// The simulation stopped.
pub fn record(truth: Parameters, source: Source, fitter: &Discretisation) -> Result<Recorded, SimError> {
    let scene = demonstration(&source.discretisation(fitter))?;
    match source {
        Source::Same => recorded::<f32>(&scene, truth),
        Source::Sampled | Source::Shifted | Source::Finer => recorded::<f64>(&scene, truth),
    }
}

fn recorded<T: Laned>(scene: &Scene, truth: Parameters) -> Result<Recorded, SimError> {
    let rollout = simulate(scene, &physics(truth.map(T::of), DENSITY_KG_M3, FRICTION))?;
    let points = |states: Vec<Vec<[T; 3]>>| {
        let state = |state: Vec<[T; 3]>| state.into_iter().map(value3).collect();
        states.into_iter().map(state).collect()
    };
    Ok(Recorded {
        diameter_m: scene.rope.diameter_m,
        lines_m: points(rollout.frames),
        particles_m: points(rollout.particles),
    })
}

/// All particles of the last state at `parameters`, m, as the fitter simulates it.
///
/// # Errors
/// The simulation stopped.
pub fn last_state(parameters: Parameters, fitter: &Discretisation) -> Result<Vec<[f64; 3]>, SimError> {
    let mut scene = demonstration(fitter)?;
    scene.frame_times_s.drain(..super::scene::STEPS - 1);
    Ok(recorded::<f32>(&scene, parameters)?.particles_m.swap_remove(0))
}

/// Points that both cameras together keep of a frame.
const CAMERA_POINTS: usize = 1000;

/// What two depth cameras see of the rope, each point off by normal noise of `noise_m` along its ray.
pub fn seen_by_cameras(rope: &Recorded, noise_m: f64, seed: u64) -> Vec<Vec<[f64; 3]>> {
    let sensor = DepthSensor {
        noise_m,
        quantum_m: 0.0,
        points: CAMERA_POINTS,
    };
    sensor.clouds(&rope.lines_m, 0.5 * rope.diameter_m, seed)
}
