//! A way to do the steps of a rollout, and the plain one: one particle after the other. The other, many at
//! a time, is [`super::sweep`].

use super::clamp::{RigidMotion, grip_forces_n};
use super::error::Cause;
use super::grid::{Grid, GridSpec};
use super::legs::Placed;
use super::material::Material;
use super::real::Real;
use super::rope::RopeLayout;
use super::step::{
    ImpulseField, Particle, StepContext, grid_to_particles, particles_to_grid, scatter, update_nodes,
};
use super::tensor::{Vec3, add, norm, scaled, value3, zero3};

/// A way to do the steps.
pub(super) trait Engine<T> {
    /// A rope in the state of `particles`, which lie slice by slice.
    fn new(
        context: &StepContext<T>,
        layout: &RopeLayout,
        grid: GridSpec,
        particles: Vec<Particle<T>>,
        material: Material<T>,
    ) -> Self;
    /// Moves the particles with the nodes, which completes a step, and sums up the next one at the nodes.
    /// `decay` multiplies every velocity in the next step; pads that give turn `motions`, those of the grips in it.
    fn sweep(
        &mut self,
        context: &StepContext<T>,
        motions: &mut [Option<RigidMotion<T>>],
        decay: f64,
    ) -> Result<(), Cause>;
    /// Adds the momentum that forces per length, N/m, give in the step at hand to particles that stand
    /// for these lengths, m, by slice.
    fn push(&mut self, context: &StepContext<T>, force_n_m: &[Vec3<T>], lengths_m: &[f64]);
    /// Updates the nodes.
    fn update_nodes(&mut self, context: &StepContext<T>, decay: f64);
    /// Gives the nodes velocities, m/s, before the first step: one per node, in the order in which the particles
    /// meet them, which is that of [`Grid`].
    fn set_node_velocities(&mut self, velocities_m_s: &[Vec3<T>]);
    /// The fastest particle and its speed, m/s; one that is not finite counts as fastest, with NaN.
    fn fastest(&self) -> (usize, f64);
    /// Force of every grip on the rope in the step that ended in this state, N; the clamps' springs have
    /// the stiffness `clamp_per_kg`, 1/s², times mass.
    fn grip_forces_n(&self, motions: &[Option<RigidMotion<T>>], clamp_per_kg: T) -> Vec<Vec3<T>>;
    /// Number of slices.
    fn slices(&self) -> usize;
    /// Middle of a slice and its velocity, m and m/s.
    fn slice_mean(&self, slice: usize) -> (Vec3<T>, Vec3<T>);
    /// x of the middle of a slice, m.
    fn slice_x(&self, slice: usize) -> T;
    /// A member of a slice and its velocity, m and m/s.
    fn member(&self, slice: usize, member: usize) -> (Vec3<T>, Vec3<T>);
    /// Turns the motions of the grips in a step as their pads let them.
    fn turn(&self, context: &StepContext<T>, motions: &mut [Option<RigidMotion<T>>])
    where
        T: Real,
    {
        if let Some(pads) = &context.pads {
            pads.turn(motions, |place| self.place_after(place, context.dt_s));
        }
    }
    /// Where a member of a slice will be if it goes on for a time, m.
    fn place_after(&self, [slice, member]: [usize; 2], dt_s: f64) -> Vec3<T>
    where
        T: Real,
    {
        let (position_m, velocity_m_s) = self.member(slice, member);
        add(position_m, scaled(velocity_m_s, dt_s))
    }
    /// Where a member of a slice is.
    fn placed(&self, slice: usize, member: usize) -> Placed;
}

/// One particle after the other.
pub(super) struct OneByOne<T: Real> {
    particles: Vec<Particle<T>>,
    material: Material<T>,
    grid: Grid<T>,
    section: usize,
}

impl<T: Real> Engine<T> for OneByOne<T> {
    fn new(
        context: &StepContext<T>,
        layout: &RopeLayout,
        grid: GridSpec,
        particles: Vec<Particle<T>>,
        material: Material<T>,
    ) -> Self {
        let masses: Vec<T> = particles.iter().map(|p| p.mass_kg).collect();
        Self {
            grid: Grid::new(layout, grid, &masses),
            material,
            particles,
            section: context.section,
        }
    }
    fn sweep(
        &mut self,
        context: &StepContext<T>,
        motions: &mut [Option<RigidMotion<T>>],
        decay: f64,
    ) -> Result<(), Cause> {
        grid_to_particles(&mut self.particles, &self.grid, context.dt_s);
        self.turn(context, motions);
        particles_to_grid(
            &self.particles,
            &mut self.material,
            &mut self.grid,
            context,
            motions,
            decay,
        )
    }
    fn push(&mut self, context: &StepContext<T>, force_n_m: &[Vec3<T>], lengths_m: &[f64]) {
        for index in 0..self.particles.len() {
            let slice = index / self.section;
            let field = ImpulseField {
                at_particle: scaled(force_n_m[slice], context.dt_s * lengths_m[slice]),
                slope: [zero3(); 3],
            };
            let (link, nodes) = (&self.grid.links[index], &mut self.grid.impulses);
            scatter(link, self.grid.spacing_m, &field, nodes);
        }
    }
    fn update_nodes(&mut self, context: &StepContext<T>, decay: f64) {
        update_nodes(&mut self.grid, context, decay);
    }
    fn set_node_velocities(&mut self, velocities_m_s: &[Vec3<T>]) {
        for (node, velocity) in self.grid.velocities_m_s.iter_mut().zip(velocities_m_s) {
            *node = T::pack(*velocity);
        }
    }
    fn fastest(&self) -> (usize, f64) {
        let mut fastest = (0, 0.0);
        for (index, p) in self.particles.iter().enumerate() {
            if !norm(value3(p.position_m)).is_finite() {
                return (index, f64::NAN);
            }
            let speed = norm(value3(p.velocity_m_s));
            if speed > fastest.1 || speed.is_nan() {
                fastest = (index, speed);
            }
        }
        fastest
    }
    fn grip_forces_n(&self, motions: &[Option<RigidMotion<T>>], clamp_per_kg: T) -> Vec<Vec3<T>> {
        grip_forces_n(&self.particles, motions, clamp_per_kg)
    }
    fn slices(&self) -> usize {
        self.particles.len() / self.section
    }
    fn slice_mean(&self, slice: usize) -> (Vec3<T>, Vec3<T>) {
        let members = &self.particles[slice * self.section..(slice + 1) * self.section];
        let (mut place, mut velocity) = (zero3(), zero3());
        for p in members {
            place = add(place, p.position_m);
            velocity = add(velocity, p.velocity_m_s);
        }
        let share = 1.0 / members.len() as f64;
        (scaled(place, share), scaled(velocity, share))
    }
    fn slice_x(&self, slice: usize) -> T {
        self.slice_mean(slice).0[0]
    }
    fn member(&self, slice: usize, member: usize) -> (Vec3<T>, Vec3<T>) {
        let particle = &self.particles[slice * self.section + member];
        (particle.position_m, particle.velocity_m_s)
    }
    fn placed(&self, slice: usize, member: usize) -> Placed {
        let particle = &self.particles[slice * self.section + member];
        Placed {
            position_m: value3(particle.position_m),
            deformation_gradient: particle.deformation_gradient.map(value3),
        }
    }
}
