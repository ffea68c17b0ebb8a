//! A centreline in motion, and what cameras report of it.

use super::physics::Physics;
use super::real::Real;
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
    /// What the cameras report of it. The clocks' offset has chosen the time already; what is left of
    /// it here are its tangents.
    pub fn seen(&self, physics: &Physics<T>, pivot_m: [f64; 3]) -> Vec<Vec3<T>> {
        let mut frame = self.points_m.clone();
        if physics.observation_laws.is_empty() {
            return frame;
        }
        let offset_s = physics.clock_offset_s();
        let tangents_s = T::of(offset_s.value()) - offset_s;
        for (point, &velocity) in frame.iter_mut().zip(&self.velocities_m_s) {
            *point = add(*point, mul(velocity, tangents_s));
            for law in &physics.observation_laws {
                *point = add(*point, law.displacement_m(*point, pivot_m));
            }
        }
        frame
    }
}
