//! A clamp: a path in time, and the particles that follow it through stiff, implicit springs.
//!
//! Each gripped particle is pulled to its place in the rigid motion of the clamp by a spring of
//! stiffness κ m/dt², integrated implicitly on the grid. Being tied to particles, hence to the
//! material, the clamp does not depend on how it lies relative to grid nodes; being a spring to a
//! *place*, it neither creeps nor hinges, which velocity constraints do.

use super::physics::{PathLaw, Pose};
use super::real::Real;
use super::step::Particle;
use super::tensor::{
    Mat3, Vec3, add, matmul_transposed, matvec, mul, rotation_of_quaternion, scaled, sub, zero3,
};

/// κ: stiffness of the clamp's springs. On an elastic foundation of this stiffness a beam's clamped
/// end gives by a length (4 E I / k)^¼, a fifth of a cell here. Measured on a cantilever 1.8 cells
/// thick with the clamp at four places between nodes: the sag spreads over 1.5 % for κ = 5, 2.2 %
/// for 10, 3.4 % for 20, 6 % for 100 and 9 % for 1000, because stiff springs lock the nodes at the
/// clamp's edge, and which nodes these are depends on the place; its mean is 3 % above beam theory.
pub const STIFFNESS: f64 = 10.0;

/// One knot of a path: pose, its rate, and whether the clamp is closed from here on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Knot {
    /// Time, s.
    pub t_s: f64,
    /// Pose.
    pub pose: Pose<f64>,
    /// Rate of change of the pose, 1/s.
    pub rate: Pose<f64>,
    /// Whether the clamp holds from this knot to the next.
    pub closed: bool,
}

/// Path of a clamp: cubic Hermite interpolation between knots, constant beyond the ends. A path whose
/// last knot opens while moving goes on at that knot's rate: the last closed step aims at a time just
/// after the opening, and would brake the rope if the path stood still there.
#[derive(Clone, Debug, PartialEq)]
pub struct ClampPath {
    knots: Vec<Knot>,
}

impl ClampPath {
    /// A path through knots in time order (at least one).
    pub fn new(knots: Vec<Knot>) -> Self {
        assert!(!knots.is_empty(), "a path has at least one knot");
        Self { knots }
    }

    /// A path from sampled poses; rates are the slopes of the parabolas through neighbours. It starts
    /// at rest, as the rope does; at its end the last parabola goes on.
    pub fn from_samples(samples: &[(f64, Pose<f64>, bool)]) -> Self {
        let n = samples.len();
        let slope = |a: usize, b: usize, k: usize| {
            (samples[b].1[k] - samples[a].1[k]) / (samples[b].0 - samples[a].0)
        };
        let knots = (0..n)
            .map(|i| {
                let rate = std::array::from_fn(|k| {
                    if i == 0 {
                        return 0.0;
                    }
                    if i + 1 == n {
                        return end_slope(samples, k);
                    }
                    let (before, after) = (samples[i].0 - samples[i - 1].0, samples[i + 1].0 - samples[i].0);
                    (after * slope(i - 1, i, k) + before * slope(i, i + 1, k)) / (before + after)
                });
                Knot {
                    t_s: samples[i].0,
                    pose: samples[i].1,
                    rate,
                    closed: samples[i].2,
                }
            })
            .collect();
        Self::new(knots)
    }

    /// A clamp that stays at a point and never opens.
    pub fn fixed(position_m: [f64; 3]) -> Self {
        let [x, y, z] = position_m;
        Self::new(vec![Knot {
            t_s: 0.0,
            pose: [x, y, z, 0.0, 0.0, 0.0, 1.0],
            rate: [0.0; 7],
            closed: true,
        }])
    }

    /// The knots.
    pub fn knots(&self) -> &[Knot] {
        &self.knots
    }

    /// Whether the clamp holds at time `t_s`.
    pub fn closed(&self, t_s: f64) -> bool {
        self.knots[self.interval(t_s)].closed
    }

    fn interval(&self, t_s: f64) -> usize {
        self.knots.partition_point(|k| k.t_s <= t_s).saturating_sub(1)
    }

    /// Pose at a time that may carry tangents.
    pub fn pose<T: Real>(&self, t_s: T) -> Pose<T> {
        let i = self.interval(t_s.value());
        let a = &self.knots[i];
        let (before, after) = (t_s.value() < a.t_s, i + 1 == self.knots.len());
        if before || after && a.closed {
            return a.pose.map(T::of);
        }
        if after {
            let since = t_s - T::of(a.t_s);
            return std::array::from_fn(|k| T::of(a.pose[k]) + since.scale(a.rate[k]));
        }
        let b = &self.knots[i + 1];
        let h = b.t_s - a.t_s;
        let u = (t_s - T::of(a.t_s)).scale(1.0 / h);
        let (u2, u3) = (u * u, u * u * u);
        let along = u2.scale(3.0) - u3.scale(2.0);
        let start_rate = (u3 - u2.scale(2.0) + u).scale(h);
        let end_rate = (u3 - u2).scale(h);
        std::array::from_fn(|k| {
            T::of(a.pose[k])
                + along.scale(b.pose[k] - a.pose[k])
                + start_rate.scale(a.rate[k])
                + end_rate.scale(b.rate[k])
        })
    }

    /// Pose where the clamp really is: the recorded pose and what the laws add to it.
    pub fn real_pose<T: Real>(&self, laws: &[Box<dyn PathLaw<T>>], t_s: f64) -> Pose<T> {
        let t = T::of(t_s);
        let mut pose = self.pose(t);
        for law in laws {
            let offset = law.offset(&|time| self.pose(time), t);
            for k in 0..7 {
                pose[k] += offset[k];
            }
        }
        pose
    }
}

/// Slope at the last sample of the parabola through the last three.
fn end_slope(samples: &[(f64, Pose<f64>, bool)], k: usize) -> f64 {
    let slope = |a: usize, b: usize| (samples[b].1[k] - samples[a].1[k]) / (samples[b].0 - samples[a].0);
    match samples.len() {
        0 | 1 => 0.0,
        2 => slope(0, 1),
        n => slope(n - 2, n - 1) + slope(n - 3, n - 1) - slope(n - 3, n - 2),
    }
}

/// Rigid motion of a clamp relative to its first pose.
#[derive(Clone, Copy, Debug)]
pub struct RigidMotion<T> {
    position_m: Vec3<T>,
    rotation: Mat3<T>,
}

impl<T: Real> RigidMotion<T> {
    /// The motion from pose `first` to pose `now`; quaternions are normalised here.
    pub fn between(first: &Pose<f64>, now: &Pose<T>) -> Self {
        let unit = |q: [T; 4]| {
            let square = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
            let inverse = T::one() / square.sqrt();
            q.map(|c| c * inverse)
        };
        let start = unit([first[3], first[4], first[5], first[6]].map(T::of));
        let end = unit([now[3], now[4], now[5], now[6]]);
        Self {
            position_m: [now[0], now[1], now[2]],
            rotation: matmul_transposed(&rotation_of_quaternion(end), &rotation_of_quaternion(start)),
        }
    }

    /// Where a direction of the first pose points now.
    pub fn turn(&self, direction: [f64; 3]) -> Vec3<T> {
        matvec(&self.rotation, direction.map(T::of))
    }

    /// Where a point goes whose offset from the first pose's position was `offset_m`.
    #[inline(always)]
    pub fn place(&self, offset_m: [f64; 3]) -> Vec3<T> {
        let offset = offset_m.map(T::of);
        add(self.position_m, matvec(&self.rotation, offset))
    }
}

/// Force of every grip on the rope in the step that ended in this state, N; zero for an open grip.
///
/// The springs are implicit, so a particle's spring pulls with κ m/dt² times the gap that is left at
/// the end of the step. In `f32` a gap of a fraction of a micrometre is near rounding: read forces
/// from a rollout in `f64`.
pub fn grip_forces_n<T: Real>(
    particles: &[Particle<T>],
    motions: &[Option<RigidMotion<T>>],
    dt_s: f64,
) -> Vec<Vec3<T>> {
    let mut forces = vec![zero3(); motions.len()];
    for p in particles {
        let Some((grip, offset_m)) = p.grip else { continue };
        let Some(motion) = &motions[grip] else { continue };
        let gap = sub(motion.place(offset_m), p.position_m);
        let stiffness = p.mass_kg.scale(STIFFNESS);
        forces[grip] = add(forces[grip], scaled(mul(gap, stiffness), 1.0 / (dt_s * dt_s)));
    }
    forces
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sampled_parabola_is_followed_exactly_inside() {
        let pose = |t: f64| [t * t, -t, 2.0, 0.0, 0.0, 0.0, 1.0];
        let samples: Vec<_> = [0.0, 0.1, 0.25, 0.3, 0.5]
            .iter()
            .map(|&t| (t, pose(t), true))
            .collect();
        let path = ClampPath::from_samples(&samples);
        for t in [0.12_f64, 0.2, 0.26, 0.29, 0.37, 0.48] {
            let got = path.pose(t);
            assert!((got[0] - t * t).abs() < 1e-12, "{t}: {}", got[0]);
            assert!((got[1] + t).abs() < 1e-12);
        }
    }
}
