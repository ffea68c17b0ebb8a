//! The swing task in the simulator: what a rope with its effects reaches from a release point.

use crate::collect::{SwingRefusal, Swinger};
use crate::fit::Resolution;
use crate::model::Structure;
use crate::sim::physics::GRAVITY_M_S2;
use crate::sim::rope::RopeShape;
use crate::sim::{Cause, Scene, SimError, simulate};
use shared::task::SwingTask;

/// A rope of known shape and effects whose elastic parameters vary.
#[derive(Clone, Debug, PartialEq)]
pub struct SimulatedSwing {
    /// Shape and mass.
    pub rope: RopeShape,
    /// The task.
    pub task: SwingTask,
    /// Effects.
    pub structure: Structure,
    /// Parameters of the effects, in the order of the structure.
    pub effect_values: Vec<f64>,
    /// Grid.
    pub resolution: Resolution,
}

/// A rope folded at its release point can buckle out of the task plane, as a real one does; in an exactly
/// planar simulation only rounding would start that. This lean of gravity starts it the same way every
/// time (measured: without it the reach of such releases is up to 15 mm off; planar ones move by 0.001 mm).
const LEAN_RAD: f64 = 1e-3;

impl SimulatedSwing {
    /// Length of rope between the two grips, m.
    pub fn free_length_m(&self) -> f64 {
        self.rope.length_m - 2.0 * self.task.grip_m
    }
}

impl Swinger for SimulatedSwing {
    fn reach_m(&self, young_pa: f64, poisson: f64, release_m: [f64; 2]) -> Result<f64, SwingRefusal> {
        let mut scene = Scene::swing_settled(self.rope, &self.task, release_m, self.resolution.cells)
            .map_err(|error| refusal(&error))?;
        // In double precision: in single, a rope that has fallen out of the plane never comes to rest.
        let mut theta = vec![young_pa.ln(), poisson];
        theta.extend(&self.effect_values);
        // No table in this scene, so its friction does not matter.
        let mut physics = self.structure.physics(&theta, 0.0);
        physics.gravity_m_s2[1] += LEAN_RAD * GRAVITY_M_S2;
        // A gripper that opens late shall not cut the swing short.
        scene.duration_s += physics.release_delay_s;
        let rollout = simulate(&scene, &physics).map_err(|error| refusal(&error))?;
        rollout
            .reach_m
            .ok_or_else(|| SwingRefusal::Failed("the swing ended before the release".into()))
    }
}

fn refusal(error: &SimError) -> SwingRefusal {
    match error.cause {
        Cause::Unreachable {
            distance_m, length_m, ..
        } => SwingRefusal::Unreachable { distance_m, length_m },
        _ => SwingRefusal::Failed(error.to_string()),
    }
}
