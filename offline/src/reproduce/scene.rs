//! The paper's demonstration in SI: a rope lies straight on the ground, one end is lifted.
//!
//! From the released code's task "Move", paper units: a bar 0.5 long and 0.028 thick, gripped by a
//! sphere of radius 0.025 whose centre is 0.005 from the bar's end, lifted by 0.003 per step for 150
//! steps of 19 · 10⁻⁴ s, ground friction 0.5. Times become ours at equal Froude number. Two differences
//! stay: our rope is round with that thickness as its diameter, and our grip holds the rope's direction.

use super::adam::Parameters;
use crate::demo::RopeEnd;
use crate::paper_units::{METRES_PER_UNIT, seconds_per_unit, young_pa};
use crate::sim::clamp::{ClampPath, Knot};
use crate::sim::rope::{RopeShape, Sampling};
use crate::sim::scene::{Grip, PAPER_CELLS_PER_DIAMETER, Scene, Table};
use crate::sim::{Physics, Real, SimError};
use serde::{Deserialize, Serialize};

/// Recorded steps of the demonstration.
pub const STEPS: usize = 150;
/// Coulomb coefficient of the ground.
pub const FRICTION: f64 = 0.5;
/// Density of the rope, kg/m³. The paper's is 1; only E/ρ matters.
pub const DENSITY_KG_M3: f64 = 1000.0;

const LENGTH_UNITS: f64 = 0.5;
const THICKNESS_UNITS: f64 = 0.028;
const STEP_UNITS: f64 = 0.003;
const STEP_PAPER_S: f64 = 19.0 * 1e-4;
/// The sphere reaches 0.025 + 0.005 into the bar.
const GRIP_UNITS: f64 = 0.03;

/// How a simulation cuts the rope and time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Discretisation {
    /// Cells across the rope.
    pub cells: f64,
    /// Shift of the grid, cells.
    pub shift_cells: [f64; 3],
    /// Particles.
    pub sampling: Sampling,
    /// Share of the largest stable time step.
    pub step_share: f64,
}

impl Default for Discretisation {
    /// The paper's grid, our usual particles and time step.
    fn default() -> Self {
        Self {
            cells: PAPER_CELLS_PER_DIAMETER,
            shift_cells: [0.0; 3],
            sampling: Sampling::default(),
            step_share: 1.0,
        }
    }
}

/// The paper's rope.
pub fn rope() -> RopeShape {
    RopeShape::of_density(
        LENGTH_UNITS * METRES_PER_UNIT,
        THICKNESS_UNITS * METRES_PER_UNIT,
        DENSITY_KG_M3,
    )
}

/// The demonstration, recorded after each of its 150 steps.
///
/// # Errors
/// The rope is too thin for the grid.
pub fn demonstration(discretisation: &Discretisation) -> Result<Scene, SimError> {
    let rope = rope();
    let step_s = STEP_PAPER_S * seconds_per_unit();
    let speed_m_s = STEP_UNITS * METRES_PER_UNIT / step_s;
    let start_m = [0.0, 0.0, 0.5 * rope.diameter_m];
    let knot = |t_s: f64| Knot {
        t_s,
        pose: [0.0, 0.0, start_m[2] + speed_m_s * t_s, 0.0, 0.0, 0.0, 1.0],
        rate: [0.0, 0.0, speed_m_s, 0.0, 0.0, 0.0, 0.0],
        closed: true,
    };
    let grip = Grip {
        end: RopeEnd::Start,
        length_m: GRIP_UNITS * METRES_PER_UNIT,
        // Beyond the last frame, because the last time step may end there.
        path: ClampPath::new(vec![knot(0.0), knot((STEPS + 1) as f64 * step_s)]),
    };
    let mut scene = Scene::new(
        rope,
        start_m,
        [1.0, 0.0, 0.0],
        vec![grip],
        Some(Table { height_m: 0.0 }),
        discretisation.cells,
        (1..=STEPS).map(|i| i as f64 * step_s).collect(),
    )?;
    scene.grid.shift_cells = discretisation.shift_cells;
    scene.sampling = discretisation.sampling;
    scene.step_share = discretisation.step_share;
    scene.keep_particles = true;
    Ok(scene)
}

/// Elastic coefficients of (E in paper units, ν) for a rope of the given density.
pub fn physics<T: Real>(parameters: [T; 2], density_kg_m3: f64, friction: f64) -> Physics<T> {
    let pascals = young_pa(1.0, density_kg_m3);
    Physics::base(parameters[0].scale(pascals), parameters[1], T::of(friction))
}

/// θ of [`crate::model::Structure`] for parameters in paper units.
pub fn theta(parameters: Parameters, density_kg_m3: f64) -> Vec<f64> {
    vec![young_pa(parameters[0], density_kg_m3).ln(), parameters[1]]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lift_is_that_of_the_paper() {
        let scene = demonstration(&Discretisation::default()).unwrap();
        assert_eq!(scene.frame_times_s.len(), STEPS);
        let path = &scene.grips[0].path;
        let end_s = scene.duration_s;
        // 150 steps of 0.003 units.
        assert!((path.pose(end_s)[2] - path.pose(0.0)[2] - 0.225).abs() < 1e-12);
        // Inertia against weight, v²/(g L), is the same in both units.
        let speed_m_s = 0.225 / end_s;
        let real = speed_m_s.powi(2) / (9.81 * 0.25);
        let paper = (0.003f64 / 1.9e-3).powi(2) / (12.0 * 0.5);
        assert!((real / paper - 1.0).abs() < 1e-12);
    }
}
