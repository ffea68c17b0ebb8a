//! A centreline in motion, and what cameras report of it.

use super::physics::Physics;
use super::real::Real;
use super::scene::Scene;
use super::tensor::{Vec3, add, mul};

/// A centreline in motion.
#[derive(Clone, Debug)]
pub struct Track<T> {
    /// One point per slice, m.
    pub points_m: Vec<Vec3<T>>,
    /// Their velocities, m/s.
    pub velocities_m_s: Vec<Vec3<T>>,
}

impl<T: Real> Track<T> {
    /// What the cameras report of it in a scene. The clocks' offset has chosen the time already; what is left of
    /// it here are its tangents.
    pub fn seen(&self, physics: &Physics<T>, scene: &Scene) -> Vec<Vec3<T>> {
        let mut frame = self.points_m.clone();
        if physics.observation_laws.is_empty() {
            return frame;
        }
        let offset_s = scene.clock_offset_s(physics);
        let tangents_s = T::of(offset_s.value()) - offset_s;
        for (point, &velocity) in frame.iter_mut().zip(&self.velocities_m_s) {
            *point = add(*point, mul(velocity, tangents_s));
            for law in &physics.observation_laws {
                *point = add(*point, law.displacement_m(*point, scene.start_m));
            }
        }
        frame
    }
}
