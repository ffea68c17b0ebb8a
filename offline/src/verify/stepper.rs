//! A rope stepped one step at a time with its particles in view: momentum, energy, invariance and
//! vibration need the state that a rollout does not show.

use crate::sim::error::Cause;
use crate::sim::grid::Grid;
use crate::sim::initial_particles;
use crate::sim::material::Material;
use crate::sim::real::Real;
use crate::sim::rollout::{grip_motions, masses_kg};
use crate::sim::rope::RopeLayout;
use crate::sim::step::{Particle, StepContext, grid_to_particles, step};
use crate::sim::time_step::time_step_s;
use crate::sim::{Physics, Scene, SimError};
use nalgebra::{Matrix3, Vector3};

/// A rope in double precision.
pub struct Stepper<'a> {
    /// The particles.
    pub particles: Vec<Particle<f64>>,
    /// The time step, s.
    pub dt_s: f64,
    /// Where the particles lie in the undeformed rope.
    pub layout: RopeLayout,
    scene: &'a Scene,
    physics: &'a Physics<f64>,
    grid: Grid<f64>,
    /// Where the nodes lie in the undeformed rope, and where they are now, m.
    nodes_material_m: Vec<[f64; 3]>,
    nodes_m: Vec<Vector3<f64>>,
    /// Turns material axes (s, side, up) to those of the undeformed rope in the world.
    straight: Matrix3<f64>,
    material: Material<f64>,
    steps: usize,
}

impl<'a> Stepper<'a> {
    /// The undeformed rope of a scene at rest, as a rollout would start it. The scene's settling is
    /// not used.
    ///
    /// # Panics
    /// The physics has clamps that give, which this does not turn.
    pub fn new(scene: &'a Scene, physics: &'a Physics<f64>) -> Self {
        assert!(
            physics.grip_compliance.is_none(),
            "clamps that give are not stepped here"
        );
        let layout = scene.layout();
        let masses = masses_kg(scene, physics, &layout);
        let particles = initial_particles(scene, &layout, &masses);
        let grid = Grid::new(&layout, scene.grid, &masses);
        let nodes_material_m = grid.nodes_material_m(&layout);
        Self {
            material: Material::new(physics, &layout),
            dt_s: time_step_s(scene, physics),
            nodes_m: nodes_material_m
                .iter()
                .map(|&m| scene.straight_m(m).into())
                .collect(),
            nodes_material_m,
            straight: matrix(&particles[0].deformation_gradient),
            particles,
            grid,
            layout,
            scene,
            physics,
            steps: 0,
        }
    }

    /// Gives the rope the velocity field `v(x) = velocity + gradient (x − centre)`.
    pub fn set_motion(&mut self, velocity: Vector3<f64>, gradient: Matrix3<f64>) {
        let centre = self.centre_m();
        for (node, at) in self.grid.velocities_m_s.iter_mut().zip(&self.nodes_m) {
            *node = f64::pack((velocity + gradient * (at - centre)).into());
        }
        grid_to_particles(&mut self.particles, &self.grid, 0.0);
    }

    /// Turns the rope about the world's origin as it moves and is strained, then shifts it.
    pub fn place(&mut self, turn: &Matrix3<f64>, shift_m: &Vector3<f64>) {
        for p in &mut self.particles {
            p.position_m = (turn * Vector3::from(p.position_m) + shift_m).into();
            p.deformation_gradient = rows(&(turn * matrix(&p.deformation_gradient)));
        }
        for at in &mut self.nodes_m {
            *at = turn * *at + shift_m;
        }
        for node in &mut self.grid.velocities_m_s {
            *node = f64::pack((turn * Vector3::from(f64::unpack(*node))).into());
        }
        grid_to_particles(&mut self.particles, &self.grid, 0.0);
    }

    /// Gives the rope a velocity field over the material coordinates (s, side, up), itself along the axes
    /// of the undeformed rope.
    pub fn set_material_motion(&mut self, field: impl Fn(Vector3<f64>) -> Vector3<f64>) {
        for (node, at) in self.grid.velocities_m_s.iter_mut().zip(&self.nodes_material_m) {
            *node = f64::pack((self.straight * field(Vector3::from(*at))).into());
        }
        grid_to_particles(&mut self.particles, &self.grid, 0.0);
    }

    /// Time, s.
    pub fn now_s(&self) -> f64 {
        self.steps as f64 * self.dt_s
    }

    /// Advances by `count` steps.
    ///
    /// # Errors
    /// The material turned inside out or a value is not finite.
    pub fn advance(&mut self, count: usize) -> Result<(), SimError> {
        self.advance_damped(count, 0.0)
    }

    /// Advances by `count` steps while every velocity decays at a rate, 1/s.
    ///
    /// # Errors
    /// As [`Self::advance`].
    pub fn advance_damped(&mut self, count: usize, rate_per_s: f64) -> Result<(), SimError> {
        let section = self.layout.section_m.len();
        let context = StepContext::new(self.scene, self.physics, self.dt_s, section);
        let decay = (-rate_per_s * self.dt_s).exp();
        for _ in 0..count {
            let t_s = self.now_s();
            let motions = grip_motions(self.scene, self.physics, t_s, self.dt_s);
            let stop = |cause: Cause| SimError {
                step: self.steps,
                t_s,
                cause,
            };
            step(
                &mut self.particles,
                &mut self.material,
                &mut self.grid,
                &context,
                &motions,
                decay,
            )
            .map_err(stop)?;
            for (place, &velocity) in self.nodes_m.iter_mut().zip(&self.grid.velocities_m_s) {
                *place += Vector3::from(f64::unpack(velocity)) * self.dt_s;
            }
            self.steps += 1;
        }
        Ok(())
    }

    /// Centre of every slice, m.
    pub fn centreline_m(&self) -> Vec<Vector3<f64>> {
        self.particles
            .chunks(self.layout.section_m.len())
            .map(|slice| {
                let sum: Vector3<f64> = slice.iter().map(|p| Vector3::from(p.position_m)).sum();
                sum / slice.len() as f64
            })
            .collect()
    }

    /// Mass, kg.
    pub fn mass_kg(&self) -> f64 {
        self.particles.iter().map(|p| p.mass_kg).sum()
    }

    /// Centre of mass, m.
    pub fn centre_m(&self) -> Vector3<f64> {
        let sum: Vector3<f64> = self
            .particles
            .iter()
            .map(|p| Vector3::from(p.position_m) * p.mass_kg)
            .sum();
        sum / self.mass_kg()
    }

    /// Velocity of the centre of mass, m/s.
    pub fn velocity_m_s(&self) -> Vector3<f64> {
        let sum: Vector3<f64> = self.nodes().map(|(mass_kg, _, v)| v * mass_kg).sum();
        sum / self.mass_kg()
    }

    /// Angular momentum about the centre of mass, kg m²/s.
    pub fn angular_momentum(&self) -> Vector3<f64> {
        let centre = self.centre_m();
        self.nodes()
            .map(|(mass_kg, place, velocity)| (place - centre).cross(&velocity) * mass_kg)
            .sum()
    }

    /// Kinetic, elastic and potential energy, J; takes a step. The kinetic energy is ½ Σ m v·v' of the velocities
    /// before and after the step's forces: what a symplectic step keeps exactly where forces are linear.
    ///
    /// # Errors
    /// As [`Self::advance`].
    pub fn energy_of_step_j(&mut self) -> Result<f64, SimError> {
        let rest = self.potential_j();
        let before: Vec<Vector3<f64>> = self.nodes().map(|(_, _, velocity)| velocity).collect();
        self.advance(1)?;
        let moving = self
            .nodes()
            .zip(&before)
            .map(|((mass_kg, _, v), u)| 0.5 * mass_kg * v.dot(u));
        Ok(rest + moving.sum::<f64>())
    }

    /// Elastic and potential energy, J.
    fn potential_j(&self) -> f64 {
        let volumes: Vec<f64> = self.particles.iter().map(|p| p.volume_m3).collect();
        let gradient = |index: usize| &self.particles[index].deformation_gradient;
        let stored = self.material.energy_j(self.physics, gradient, &volumes);
        let gravity = Vector3::from(self.physics.gravity_m_s2);
        let fallen = self
            .nodes()
            .map(|(mass_kg, place, _)| mass_kg * gravity.dot(&place));
        stored - fallen.sum::<f64>()
    }

    /// Mass, place and velocity of every node, kg, m and m/s.
    fn nodes(&self) -> impl Iterator<Item = (f64, Vector3<f64>, Vector3<f64>)> {
        let velocities = self
            .grid
            .velocities_m_s
            .iter()
            .map(|&v| Vector3::from(f64::unpack(v)));
        let masses = self.grid.mass_kg.iter().copied();
        masses
            .zip(&self.nodes_m)
            .zip(velocities)
            .map(|((m, &x), v)| (m, x, v))
    }
}

/// A row-major matrix as nalgebra's.
pub fn matrix(rows: &[[f64; 3]; 3]) -> Matrix3<f64> {
    Matrix3::from_fn(|i, j| rows[i][j])
}

/// nalgebra's matrix as rows.
pub fn rows(m: &Matrix3<f64>) -> [[f64; 3]; 3] {
    std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)]))
}
