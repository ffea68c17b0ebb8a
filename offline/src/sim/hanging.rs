//! Ropes that hang: their masses, the state in which a rollout starts, and scenes without time.

use super::error::{Cause, SimError};
use super::physics::Physics;
use super::real::Real;
use super::rollout::Rollout;
use super::rope::RopeLayout;
use super::scene::Scene;
use super::start::{Hang, Start};
use super::statics::{Nodes, Pose, Statics};
use super::step::Particle;
use super::tensor::{Vec3, add, scaled, sub, zero3};
use rayon::prelude::*;

/// Brings the particles to where the scene starts, if the rope hangs there. Returns the velocities of
/// the nodes, m/s, if it moves.
pub(super) fn hang<T: Real>(
    scene: &Scene,
    physics: &Physics<T>,
    particles: &mut [Particle<T>],
) -> Result<Option<Nodes<T>>, Cause> {
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

/// Mass of every particle, kg: the rope's, the declared mass at its end, and what the laws change.
pub(super) fn particle_masses<T: Real>(scene: &Scene, layout: &RopeLayout, physics: &Physics<T>) -> Vec<T> {
    let density = scene.rope.density_kg_m3();
    let members = layout.section_m.len();
    let first_of_end = layout.particles() - members;
    let mut masses: Vec<T> = (0..layout.particles())
        .map(|p| {
            let end = if p >= first_of_end {
                scene.end_mass_kg / members as f64
            } else {
                0.0
            };
            T::of(density * layout.particle_volume_m3(p) + end)
        })
        .collect();
    for law in &physics.mass_laws {
        law.change_masses_kg(layout, &mut masses);
    }
    masses
}

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
        let nodes = statics.solve(pose).map_err(|cause| SimError {
            step: 0,
            t_s: pose.t_s,
            cause,
        })?;
        let middle = |slice: usize| {
            let of_slice = slice * members..(slice + 1) * members;
            let sum = of_slice.fold(zero3(), |sum, p| add(sum, statics.particle(&nodes, p).0));
            scaled(sum, 1.0 / members as f64)
        };
        let line: Vec<Vec3<T>> = (0..layout.slices.len()).map(middle).collect();
        Ok((line, statics.grip_forces_n(&nodes, pose)))
    };
    let found: Vec<_> = hang
        .poses
        .par_iter()
        .map(frame)
        .collect::<Result<_, SimError>>()?;
    let (frames, grip_forces_n) = found.into_iter().unzip();
    Ok(Rollout {
        frames,
        grip_forces_n,
        arc_m: layout.slices.iter().map(|s| s.arc_m).collect(),
        reach_m: None,
        steps: 0,
        dt_s: 0.0,
    })
}
