//! A rope stepped one step at a time with its particles in view: momentum, energy, invariance and
//! vibration need the state that a rollout does not show.

use crate::sim::elastic::energy_density;
use crate::sim::error::Cause;
use crate::sim::grid::Grid;
use crate::sim::rollout::{grip_motions, initial_particles, time_step_s};
use crate::sim::rope::RopeLayout;
use crate::sim::step::{Particle, StepContext, step};
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
    steps: usize,
}

impl<'a> Stepper<'a> {
    /// The undeformed rope of a scene at rest, as a rollout would start it. The scene's settling and
    /// changes of mass are not used.
    pub fn new(scene: &'a Scene, physics: &'a Physics<f64>) -> Self {
        let layout = scene.layout();
        let density = scene.rope.density_kg_m3();
        let masses: Vec<f64> = (0..layout.particles())
            .map(|p| density * layout.particle_volume_m3(p))
            .collect();
        Self {
            particles: initial_particles(scene, &layout, &masses),
            dt_s: time_step_s(scene, physics),
            grid: Grid::new(&layout, scene.grid, &masses),
            layout,
            scene,
            physics,
            steps: 0,
        }
    }

    /// Gives every particle the velocity field `v(x) = velocity + gradient (x − centre)`.
    pub fn set_motion(&mut self, velocity: Vector3<f64>, gradient: Matrix3<f64>) {
        let centre = self.centre_m();
        for p in &mut self.particles {
            let v = velocity + gradient * (Vector3::from(p.position_m) - centre);
            p.velocity_m_s = v.into();
            let f = matrix(&p.deformation_gradient);
            p.deformation_rate = rows(&(gradient * f));
        }
    }

    /// Gives the undeformed rope a velocity field over the material coordinates (s, side, up), itself
    /// along these axes, with its gradient.
    pub fn set_material_motion(&mut self, field: impl Fn(Vector3<f64>) -> Vector3<f64>) {
        const H_M: f64 = 1e-7;
        for (index, p) in self.particles.iter_mut().enumerate() {
            let [side, up] = self.layout.section_m[index % self.layout.section_m.len()];
            let at = Vector3::new(self.layout.slice_of(index).arc_m, side, up);
            let turn = matrix(&p.deformation_gradient);
            p.velocity_m_s = (turn * field(at)).into();
            let slope = |k: usize| {
                let step = Vector3::ith(k, H_M);
                (field(at + step) - field(at - step)) / (2.0 * H_M)
            };
            let gradient = Matrix3::from_columns(&[slope(0), slope(1), slope(2)]);
            p.deformation_rate = rows(&(turn * gradient));
        }
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
        let context = StepContext {
            physics: self.physics,
            lame: self.physics.lame(),
            dt_s: self.dt_s,
            diameter_m: self.scene.rope.diameter_m,
            table_m: self.scene.table.map(|t| t.height_m),
            section: self.layout.section_m.len(),
        };
        let decay = (-rate_per_s * self.dt_s).exp();
        for _ in 0..count {
            let t_s = self.now_s();
            let motions = grip_motions(self.scene, self.physics, t_s, self.dt_s);
            let stop = |cause: Cause| SimError {
                step: self.steps,
                t_s,
                cause,
            };
            step(&mut self.particles, &mut self.grid, &context, &motions, decay).map_err(stop)?;
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
        let sum: Vector3<f64> = self
            .particles
            .iter()
            .map(|p| Vector3::from(p.velocity_m_s) * p.mass_kg)
            .sum();
        sum / self.mass_kg()
    }

    /// Angular momentum about the centre of mass, kg m²/s, with the part that the particles' affine
    /// velocity fields carry: each column of Ḟ moves at the end of a lever, the same column of F.
    pub fn angular_momentum(&self) -> Vector3<f64> {
        let centre = self.centre_m();
        let lever = self.affine_inertia_m2();
        self.particles
            .iter()
            .map(|p| {
                let (f, rate) = (matrix(&p.deformation_gradient), matrix(&p.deformation_rate));
                let affine: Vector3<f64> = (0..3)
                    .map(|b| f.column(b).into_owned().cross(&rate.column(b).into_owned()))
                    .sum();
                let orbit = (Vector3::from(p.position_m) - centre).cross(&Vector3::from(p.velocity_m_s));
                (orbit + affine * lever) * p.mass_kg
            })
            .sum()
    }

    /// Kinetic, elastic and potential energy, J.
    pub fn energy_j(&self) -> f64 {
        let lame = self.physics.lame();
        let lever = self.affine_inertia_m2();
        let gravity = Vector3::from(self.physics.gravity_m_s2);
        self.particles
            .iter()
            .map(|p| {
                let affine = matrix(&p.deformation_rate).norm_squared() * lever;
                let speed = Vector3::from(p.velocity_m_s).norm_squared();
                let fall = gravity.dot(&Vector3::from(p.position_m));
                p.mass_kg * (0.5 * (speed + affine) - fall)
                    + p.volume_m3 * energy_density(&p.deformation_gradient, &lame)
            })
            .sum()
    }

    /// dx²/4: second moment of the quadratic kernel (Jiang et al. 2015).
    fn affine_inertia_m2(&self) -> f64 {
        0.25 * self.scene.grid.spacing_m.powi(2)
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
