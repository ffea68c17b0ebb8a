//! Ropes that hang: their masses, the state in which a rollout starts, and scenes without time.

use super::error::{Cause, SimError};
use super::physics::Physics;
use super::real::Real;
use super::rollout::{Rollout, Track};
use super::scene::Scene;
use super::start::{Hang, Start};
use super::statics::{Nodes, Pose, Statics};
use super::step::Particle;
use super::tensor::{Vec3, add, scaled, sub, zero3};
use rayon::prelude::*;

/// Brings the particles to where the scene starts, if the rope does not lie straight there. Returns the velocities of
/// the nodes, m/s, if it moves.
pub(super) fn hang<T: Real>(
    scene: &Scene,
    physics: &Physics<T>,
    particles: &mut [Particle<T>],
) -> Result<Option<Nodes<T>>, Cause> {
    if let Start::Placed(placed) = &scene.start {
        for (particle, at) in particles.iter_mut().zip(placed) {
            particle.position_m = at.position_m.map(T::of);
            particle.deformation_gradient = at.deformation_gradient.map(|row| row.map(T::of));
        }
    }
    let Some(hang) = scene.start.hang() else {
        return Ok(None);
    };
    let statics = Statics::new(scene, physics);
    let first = statics.solve(&hang.poses[0])?;
    let later = match (&scene.start, hang.poses.get(1)) {
        (Start::Moving(_), Some(pose)) => Some((pose.t_s - hang.poses[0].t_s, statics.solve(pose)?)),
        _ => None,
    };
    for (index, particle) in particles.iter_mut().enumerate() {
        (particle.position_m, particle.deformation_gradient) = statics.particle(&first, index);
    }
    Ok(later.map(|(after_s, nodes)| {
        let pairs = nodes.iter().zip(&first);
        pairs.map(|(b, a)| scaled(sub(*b, *a), 1.0 / after_s)).collect()
    }))
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
        rollout.frames.push(track.seen(physics, scene.start_m));
        rollout.tracks.push(track);
        rollout.particles.extend(particles);
        rollout.grip_forces_n.push(grip_forces_n);
    }
    Ok(rollout)
}
