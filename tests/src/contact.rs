//! A flat table under the rod: a one-sided spring with damper, and Coulomb friction.

use nalgebra::Vector3;

/// Static indentation of a node under its own weight, m: small against the sensor's noise.
const INDENTATION_M: f64 = 1e-5;
const GRAVITY: f64 = 9.81;

/// A horizontal table.
#[derive(Clone, Copy, Debug)]
pub struct Table {
    /// Height of the surface, m.
    pub height_m: f64,
    /// Coulomb coefficient, static and sliding alike.
    pub friction: f64,
}

impl Table {
    /// Upward force on a node of mass `mass` whose surface is `radius_m` below its axis, N.
    ///
    /// The spring carries the node's weight at `INDENTATION_M`; the damper is critical, and the
    /// force never pulls.
    pub fn normal_force(&self, x: &Vector3<f64>, v: &Vector3<f64>, mass: f64, radius_m: f64) -> f64 {
        let depth = self.height_m + radius_m - x.z;
        if depth <= 0.0 {
            return 0.0;
        }
        let rate = (GRAVITY / INDENTATION_M).sqrt();
        (mass * (rate * rate * depth - 2.0 * rate * v.z)).max(0.0)
    }

    /// The velocity after friction has acted for `dt`: the largest impulse is μ N dt, and it stops
    /// the node rather than reversing it (Coulomb's law as a projection, so sticking does not creep).
    pub fn after_friction(&self, v: &Vector3<f64>, normal: f64, mass: f64, dt: f64) -> Vector3<f64> {
        let speed = v.x.hypot(v.y);
        let loss = self.friction * normal * dt / mass;
        let kept = if speed > loss { 1.0 - loss / speed } else { 0.0 };
        Vector3::new(v.x * kept, v.y * kept, v.z)
    }
}
