//! A rope without grips, stepped one step at a time with its particles in view: tests of momentum,
//! energy and invariance need the state that a rollout does not show.

use nalgebra::{Matrix3, Vector3};
use offline::sim::elastic::energy_density;
use offline::sim::error::Cause;
use offline::sim::grid::Grid;
use offline::sim::rollout::initial_particles;
use offline::sim::step::{Particle, StepContext, step};
use offline::sim::{Physics, Scene};

/// A free rope in double precision.
pub struct Stepper<'a> {
    /// The particles.
    pub particles: Vec<Particle<f64>>,
    /// The time step, s.
    pub dt_s: f64,
    scene: &'a Scene,
    physics: &'a Physics<f64>,
    grid: Grid<f64>,
    section: usize,
}

impl<'a> Stepper<'a> {
    /// The undeformed rope of a scene at rest, as a rollout would start it. The scene's grips,
    /// settling and changes of mass are not used.
    pub fn new(scene: &'a Scene, physics: &'a Physics<f64>) -> Self {
        let layout = scene.layout();
        let density = scene.rope.density_kg_m3();
        let masses: Vec<f64> = (0..layout.particles())
            .map(|p| density * layout.particle_volume_m3(p))
            .collect();
        let lame = physics.lame();
        let viscosities = physics.stress_laws.iter().map(|law| law.viscosity_pa_s(&lame));
        let dt_s = scene.time_step_s(lame.p_wave_modulus(), viscosities.fold(0.0, f64::max));
        Self {
            particles: initial_particles(scene, &layout, &masses, physics).expect("a straight rope"),
            dt_s,
            scene,
            physics,
            grid: Grid::new(&layout, scene.grid, &masses),
            section: layout.section_m.len(),
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

    /// Advances by `count` steps.
    ///
    /// # Errors
    /// The material turned inside out or a value is not finite.
    pub fn advance(&mut self, count: usize) -> Result<(), Cause> {
        let context = StepContext {
            physics: self.physics,
            lame: self.physics.lame(),
            dt_s: self.dt_s,
            diameter_m: self.scene.rope.diameter_m,
            table_m: self.scene.table.map(|t| t.height_m),
            section: self.section,
        };
        for _ in 0..count {
            step(&mut self.particles, &mut self.grid, &context, &[], 1.0)?;
        }
        Ok(())
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
