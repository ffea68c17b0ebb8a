//! Ropes that hang: their masses, the state in which a rollout starts, and scenes without time.

use super::error::SimError;
use super::physics::Physics;
use super::real::Real;
use super::rollout::{Rollout, perpendicular};
use super::rope::RopeLayout;
use super::scene::Scene;
use super::start::{Hang, Start};
use super::statics::{Nodes, Pose, Statics};
use super::step::Particle;
use super::tensor::{Mat3, Vec3, add, scaled, sub, zero3};
use super::time_step::time_step_s;
use super::track::Track;
use rayon::prelude::*;

/// Particles of the undeformed rope at rest.
pub fn initial_particles<T: Real>(scene: &Scene, layout: &RopeLayout, masses_kg: &[T]) -> Vec<Particle<T>> {
    let (side, up) = perpendicular(scene.direction);
    let straight = std::array::from_fn(|k| [scene.direction[k], side[k], up[k]].map(T::of));
    (0..layout.particles())
        .map(|index| {
            let material_m = layout.material_m(index);
            Particle {
                position_m: scene.straight_m(material_m).map(T::of),
                lost_m: zero3(),
                velocity_m_s: zero3(),
                deformation_rate: [zero3(); 3],
                deformation_gradient: straight,
                mass_kg: masses_kg[index],
                volume_m3: layout.particle_volume_m3(index),
                length_m: layout.particle_length_m(index),
                grip: scene.grip_offset(material_m),
            }
        })
        .collect()
}

/// A rope that hangs at the start of a scene with time.
#[derive(Clone, Debug)]
pub struct Hung<T> {
    /// Place, m, and deformation gradient of every particle, slice by slice.
    particles: Vec<(Vec3<T>, Mat3<T>)>,
    /// Velocities of the nodes, m/s, if it moves.
    pub(super) velocities_m_s: Option<Nodes<T>>,
}

impl<T: Real> Hung<T> {
    /// Where the rope of a scene hangs at the start; nothing where it does not hang.
    ///
    /// # Errors
    /// No rest state was found.
    pub fn of(scene: &Scene, physics: &Physics<T>) -> Result<Option<Self>, SimError> {
        let Some(hang) = scene.start.hang() else {
            return Ok(None);
        };
        let statics = Statics::new(scene, physics);
        let solve = |pose| statics.solve(pose).map_err(SimError::at_start);
        let mut first = solve(&hang.poses[0])?;
        let velocities_m_s: Option<Nodes<T>> = match (&scene.start, hang.poses.get(1)) {
            (Start::Moving(_), Some(pose)) => {
                let per_s = 1.0 / (pose.t_s - hang.poses[0].t_s);
                let moved = solve(pose)?.into_iter().zip(&first);
                Some(moved.map(|(b, a)| scaled(sub(b, *a), per_s)).collect())
            }
            _ => None,
        };
        if let Some(velocities_m_s) = &velocities_m_s {
            // Particles are moved by these before the rope is first seen.
            let dt_s = scene.chosen_step_s(time_step_s(scene, physics))?;
            for (node, velocity) in first.iter_mut().zip(velocities_m_s) {
                *node = sub(*node, scaled(*velocity, dt_s));
            }
        }
        let particles = 0..scene.layout().particles();
        Ok(Some(Self {
            particles: particles.map(|p| statics.particle(&first, p)).collect(),
            velocities_m_s,
        }))
    }

    /// The same in numbers of another precision with as many tangents.
    pub fn in_numbers_of<U: Real>(&self) -> Hung<U> {
        let vector = |v: &Vec3<T>| v.map(|x| U::with_tangents(x.value(), |k| x.tangent(k)));
        let particle = |(place, f): &(Vec3<T>, Mat3<T>)| (vector(place), f.map(|row| vector(&row)));
        Hung {
            particles: self.particles.iter().map(particle).collect(),
            velocities_m_s: self
                .velocities_m_s
                .as_ref()
                .map(|v| v.iter().map(vector).collect()),
        }
    }

    /// Brings the particles there.
    pub(super) fn place(&self, particles: &mut [Particle<T>]) {
        for (particle, at) in particles.iter_mut().zip(&self.particles) {
            (particle.position_m, particle.deformation_gradient) = *at;
        }
    }
}

/// A pose as it is seen, its particles where they are kept, and the grips' forces.
type Still<T> = (Track<T>, Option<Vec<Vec3<T>>>, Vec<Vec3<T>>);

/// The poses of a scene without time.
pub(super) fn hang_still<T: Real>(
    scene: &Scene,
    physics: &Physics<T>,
    hang: &Hang,
) -> Result<Rollout<T>, SimError> {
    let statics = Statics::new(scene, physics);
    let layout = scene.layout();
    let members = layout.section_m.len();
    let frame = |pose: &Pose| {
        let nodes = statics
            .solve(pose)
            .map_err(|cause| SimError::of_pose(pose.t_s, cause))?;
        let middle = |slice: usize| {
            let of_slice = slice * members..(slice + 1) * members;
            let sum = of_slice.fold(zero3(), |sum, p| add(sum, statics.particle(&nodes, p).0));
            scaled(sum, 1.0 / members as f64)
        };
        let points_m: Vec<Vec3<T>> = (0..layout.slices.len()).map(middle).collect();
        let velocities_m_s = vec![zero3(); points_m.len()];
        let track = Track {
            points_m,
            velocities_m_s,
        };
        let all = || {
            (0..layout.particles())
                .map(|p| statics.particle(&nodes, p).0)
                .collect()
        };
        let particles = scene.keep_particles.then(all);
        Ok((track, particles, statics.grip_forces_n(&nodes, pose)))
    };
    let found: Vec<Still<T>> = hang
        .poses
        .par_iter()
        .map(frame)
        .collect::<Result<_, SimError>>()?;
    let mut rollout = Rollout {
        frames: Vec::with_capacity(found.len()),
        tracks: Vec::with_capacity(found.len()),
        particles: Vec::new(),
        grip_forces_n: Vec::with_capacity(found.len()),
        arc_m: layout.slices.iter().map(|s| s.arc_m).collect(),
        reach_m: None,
        end: Vec::new(),
        steps: 0,
        dt_s: 0.0,
    };
    for (track, particles, grip_forces_n) in found {
        rollout.frames.push(track.seen(physics, scene));
        rollout.tracks.push(track);
        rollout.particles.extend(particles);
        rollout.grip_forces_n.push(grip_forces_n);
    }
    Ok(rollout)
}
