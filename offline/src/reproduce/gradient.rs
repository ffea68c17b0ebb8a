//! The paper's estimator: gradient descent by Adam on the L1 difference of grid densities, of all steps
//! or of the last one.
//!
//! The gradient comes from the simulator's tangents in the same pass, where the released code runs the
//! simulation backward; the numbers are the same, the derivative of the same steps.

use super::adam::{Adam, Parameters, Rates, clipped};
use super::density::{Density, DensityGrid, Loss, LossSum};
use super::scene::physics;
use crate::sim::dual::Dual;
use crate::sim::{Scene, SimError, simulate};
use serde::{Deserialize, Serialize};

/// Which recorded states the loss compares.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Steps {
    /// All of them.
    All,
    /// The last one.
    Last,
}

/// What is descended on: a scene, and the densities that were seen in it.
pub struct Descent {
    scene: Scene,
    friction: f64,
    grid: DensityGrid,
    measured: Vec<Density>,
}

/// Where a descent went.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Descended {
    /// Where it started.
    pub start: Parameters,
    /// The last iterate, clipped: what the released code reports.
    pub last: Parameters,
    /// The iterate with the lowest loss, clipped.
    pub best: Parameters,
    /// Loss of every iterate, the start's first.
    pub losses: Vec<f64>,
}

impl Descent {
    /// A descent for `scene` on clouds seen at its frame times, in m.
    pub fn new(scene: &Scene, friction: f64, clouds_m: &[Vec<[f64; 3]>], steps: Steps) -> Self {
        let mut scene = scene.clone();
        scene.keep_particles = true;
        let grid = DensityGrid::around(clouds_m.iter().flatten(), scene.rope.length_m);
        let mut clouds = clouds_m;
        if steps == Steps::Last {
            let from = clouds.len().saturating_sub(1);
            clouds = &clouds[from..];
            scene.frame_times_s.drain(..from);
        }
        Self {
            measured: clouds.iter().map(|cloud| grid.density(cloud)).collect(),
            scene,
            friction,
            grid,
        }
    }

    /// Loss and gradient at parameters in paper units.
    ///
    /// # Errors
    /// The simulation stopped.
    pub fn loss(&self, parameters: Parameters) -> Result<Loss<2>, SimError> {
        let inputs: [Dual<f32, 2>; 2] = std::array::from_fn(|k| Dual::input(parameters[k], k));
        let physics = physics(inputs, self.scene.rope.density_kg_m3(), self.friction);
        let rollout = simulate(&self.scene, &physics)?;
        let mut sum = LossSum::new(self.grid);
        for (particles, measured) in rollout.particles.iter().zip(&self.measured) {
            sum.add(particles, measured);
        }
        Ok(sum.total())
    }

    /// Descends from `start` with `rates`, for `iterations` steps.
    ///
    /// # Errors
    /// A simulation stopped.
    pub fn run(&self, start: Parameters, rates: Rates, iterations: usize) -> Result<Descended, SimError> {
        let mut adam = Adam::new(start, rates);
        let mut losses = Vec::with_capacity(iterations + 1);
        let mut best = (f64::INFINITY, start);
        for iteration in 0..=iterations {
            let here = clipped(adam.parameters);
            let loss = self.loss(here)?;
            losses.push(loss.value);
            if loss.value < best.0 {
                best = (loss.value, here);
            }
            if iteration < iterations {
                adam.step(loss.gradient);
            }
        }
        Ok(Descended {
            start,
            last: clipped(adam.parameters),
            best: best.1,
            losses,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::scene::{Discretisation, FRICTION, demonstration};
    use super::*;
    use crate::sim::real::Arithmetic;
    use crate::sim::scene::StepLength;
    use crate::sim::time_step::time_step_s;

    /// The scene's first tenth, on the coarsest grid, to save time.
    fn short() -> Scene {
        let coarse = Discretisation {
            cells: 1.5,
            ..Discretisation::default()
        };
        let mut scene = demonstration(&coarse).unwrap();
        scene.frame_times_s.truncate(30);
        scene.duration_s = scene.frame_times_s[29];
        scene
    }

    fn clouds(scene: &Scene, parameters: Parameters) -> Vec<Vec<[f64; 3]>> {
        let physics = physics::<f64>(parameters, scene.rope.density_kg_m3(), FRICTION);
        simulate(scene, &physics).unwrap().particles
    }

    /// Through the whole chain from (E, ν) to the loss, against central differences in double precision
    /// of the same formula.
    #[test]
    fn the_gradient_through_the_simulator_is_that_of_differences() {
        let mut scene = short();
        let truth = [5000.0, 0.3];
        // Tangents hold the time step, so differences have to hold it too.
        let stiffer = physics::<f64>(truth, scene.rope.density_kg_m3(), FRICTION);
        scene.step = StepLength::Fixed(time_step_s(&scene, &stiffer));
        let descent = Descent::new(&scene, FRICTION, &clouds(&scene, truth), Steps::All);
        let here = [2500.0, 0.3];
        let value = |p: Parameters| {
            let measured = &descent.measured;
            let mut sum = LossSum::<2>::new(descent.grid);
            for (frame, density) in clouds(&scene, p).iter().zip(measured) {
                let points: Vec<_> = frame.iter().map(|p| p.map(Dual::of)).collect();
                sum.add(&points, density);
            }
            sum.total().value
        };
        let found = descent.loss(here).unwrap().gradient[0];
        let h = 50.0;
        let expected = (value([here[0] + h, here[1]]) - value([here[0] - h, here[1]])) / (2.0 * h);
        assert!((found / expected - 1.0).abs() < 0.05, "{found} {expected}");
    }

    #[test]
    fn a_few_steps_lower_the_loss_and_the_last_step_needs_one_frame() {
        let scene = short();
        let truth = [5000.0, 0.3];
        for steps in [Steps::All, Steps::Last] {
            let descent = Descent::new(&scene, FRICTION, &clouds(&scene, truth), steps);
            assert_eq!(descent.measured.len(), if steps == Steps::All { 30 } else { 1 });
            let found = descent.run([4000.0, 0.3], Rates::RELEASED, 3).unwrap();
            assert_eq!(found.losses.len(), 4);
            assert!(found.losses[3] < found.losses[0], "{:?}", found.losses);
            assert!(found.best[0] > 4200.0, "{:?}", found.best);
        }
    }
}
