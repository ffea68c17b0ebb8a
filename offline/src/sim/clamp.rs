//! A clamp: a path in time, and the particles that follow it through stiff, implicit springs.
//!
//! Each gripped particle is pulled to its place in the rigid motion of the clamp by a spring as stiff as
//! the rope itself ([`STIFFNESS`]), integrated implicitly on the grid. Being tied to particles, hence to the
//! material, the clamp does not depend on how it lies relative to grid nodes; being a spring to a
//! *place*, it neither creeps nor hinges, which velocity constraints do. Pads that give turn these places ([`super::pads`]).
//!
//! A spring acts on what its particle does, and on next to nothing else ([`KEPT`]). The nodes' implicit update
//! alone would ask every node for the velocity gap/dt: it would also hold back nodes whose particles stand
//! still, a dashpot of κ m/dt (κ: stiffness times dt² over the mass) that belongs to no clamp and changes with the
//! time step. With q the share of it that is taken out, measured with springs of κ = 10:
//!
//! | | q = 0 | 0.99 | 1 |
//! |---|---|---|---|
//! | tip of a cantilever sinks in a second (tolerance 1 µm) | 4.9 µm | 0.87 µm | 0.43 µm |
//! | clamped rope moves in a second (tolerance 1 nm) | 4.2 nm | 2.8 nm | 1.3 nm |
//! | reach of the taut release (0.05, 0.30), 0.9 MPa; with half the step | 306, 348 mm | | 357, 355 mm |
//! | settled swings within 0.1 mm of the true approach come to rest | 25 of 33 | 30 of 33 | 30 of 33 |
//! | gradient of a dropped rope against forward mode, f64, worst | 1.4e-10 | < 1e-10 | 1.4e-9 |
//!
//! So 0.36 m is right at the taut release, and 0.31 m was the dashpot; on finer grids it reaches 345 mm (2 cells)
//! and 432 mm (3 cells, where the rope wrinkles at its clamps, bent there by a right angle within its thickness).
//! The price: the dashpot also calmed the rope in the robot's slow approach, which now still swings when it is let
//! go, as a rope with so little loss does: up to 7 mm off its rest's reach, where it was 4.
//! With q = 1 the nodes inside a clamp ring on after a drop, and gradients grow.
//!
//! What did not pay:
//! - *Springs of κ m/dt²*, κ = 10. They were as stiff as these at ν = 0.3, but the step depends on Poisson's ratio and
//!   on every damping: at ν = 0.45 they were 3.7 times stiffer. A fit took that for Poisson's ratio (its tangent,
//!   which knows nothing of the step, was a third of the slope), E of the shipped rope came out 2.4 % low with a tenth
//!   of that as its error, and what was left of its residual was alike from frame to frame (0.34; now 0.08).
//! - *Springs on the nodes* that carry gripped material, with the nodes' places as state: 0.4 µm, but they hold
//!   more than is gripped. The sag of a cantilever is 5 to 16 % too small with κ times the gripped mass; at best
//!   (that times the square of its share of the node's mass, κ = 30) within 3.6 % over four alignments, and
//!   1.1 % here.
//! - *Forgetting more slowly* (`step.rs`), 2 and 4 ms instead of 1, against the 1.3 nm that q = 1 leaves: 2.8 and
//!   3.8 nm.

use super::physics::{PathLaw, Pose};
use super::real::Real;
use super::recorded::Recorded;
use super::step::Particle;
use super::tensor::{
    Mat3, Vec3, add, matmul, matmul_transposed, matvec, mul, rotation_of_quaternion, sub, zero3,
};

/// Stiffness of the clamps' springs over the mass of their particles, as a multiple of E/(ρ dx²): of the rope and the
/// grid, not of the time step, so that the clamp stays what it is when the step changes, with Poisson's ratio, damping
/// or by choice. On an elastic foundation of this stiffness a beam's clamped end gives by a length (4 E I / k)^¼, a
/// third of a cell; the kernel's smoothing shortens the rope by as much. Sag of a cantilever of ten diameters at three
/// alignments along it, least and most over 1.5, 2.1, 3 and 4.2 cells, %:
///
/// | 10 | 20 | 28 | 40 |
/// |---|---|---|---|
/// | 2.0 to 5.4 | 0.9 to 3.0 | 0.4 to 2.1 | −0.6 to 1.2 |
///
/// These grids of 2 cells and more had rings of particles 0.5 cells apart; with 0.375, as now, it is −0.8 to 0.9 at 40 on 1.5
/// to 3 cells and four alignments, −0.3 to 0.5 on 3.
///
/// Much stiffer springs lock the nodes at the clamp's edge, and which nodes these are depends on the place: with 160,
/// half a cell changes the bending stiffness that a lift shows by 4.7 % (40: 1.7 %, 10: 0.4 %).
pub const STIFFNESS: f64 = 40.0;

/// q: share of its own velocity that a node in a clamp keeps where its particles do not see it. The rest damps
/// what rings in there.
pub const KEPT: f64 = 0.99;

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

impl Knot {
    /// Itself, as a change of a knot at the origin that stands still.
    pub(super) fn as_shift(&self) -> KnotShift<f64> {
        KnotShift {
            pose: self.pose,
            rate: self.rate,
        }
    }
}

/// A sampled pose: time in s, pose, whether the clamp holds from here on.
pub type Sample = (f64, Pose<f64>, bool);

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
    pub fn from_samples(samples: &[Sample]) -> Self {
        Self::through(samples, [0.0; 7])
    }

    /// The same for a rope that moves at the first sample: the first parabola holds from there on.
    pub fn from_samples_in_motion(samples: &[Sample]) -> Self {
        let inwards: Vec<&Sample> = samples.iter().collect();
        Self::through(samples, std::array::from_fn(|k| edge_slope(&inwards, k)))
    }

    fn through(samples: &[Sample], first_rate: Pose<f64>) -> Self {
        let n = samples.len();
        let inwards: Vec<&Sample> = samples.iter().rev().collect();
        let knots = (0..n)
            .map(|i| {
                let rate = |k| {
                    if i + 1 == n {
                        return edge_slope(&inwards, k);
                    }
                    let [before, here, after] = [&samples[i - 1], &samples[i], &samples[i + 1]];
                    let spans = [here.0 - before.0, after.0 - here.0];
                    (spans[1] * slope(before, here, k) + spans[0] * slope(here, after, k))
                        / (spans[0] + spans[1])
                };
                Knot {
                    t_s: samples[i].0,
                    pose: samples[i].1,
                    rate: if i == 0 {
                        first_rate
                    } else {
                        std::array::from_fn(rate)
                    },
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

    /// Motion of the clamp since its first pose, as recorded.
    pub fn motion(&self, t_s: f64) -> RigidMotion<f64> {
        RigidMotion::at(&Recorded::new(self, None), &Grasp::AS_RECORDED, t_s)
    }

    /// Whether the clamp holds at time `t_s`.
    pub fn closed(&self, t_s: f64) -> bool {
        self.knots[self.interval(t_s)].closed
    }

    fn interval(&self, t_s: f64) -> usize {
        self.knots.partition_point(|k| k.t_s <= t_s).saturating_sub(1)
    }

    /// Where a time lies between the knots.
    pub fn span<T: Real>(&self, t_s: T) -> Span<T> {
        let i = self.interval(t_s.value());
        let a = &self.knots[i];
        let (before, after) = (t_s.value() < a.t_s, i + 1 == self.knots.len());
        if before || after && a.closed {
            return Span::At(i);
        }
        if after {
            return Span::Beyond(i, t_s - T::of(a.t_s));
        }
        let h = self.knots[i + 1].t_s - a.t_s;
        let u = (t_s - T::of(a.t_s)).scale(1.0 / h);
        Span::After(i, Hermite::at(u, h))
    }

    /// Pose at a time that may carry tangents.
    pub fn pose<T: Real>(&self, t_s: T) -> Pose<T> {
        let (i, w) = match self.span(t_s) {
            Span::At(i) => return self.knots[i].pose.map(T::of),
            Span::Beyond(i, since) => {
                let a = &self.knots[i];
                return std::array::from_fn(|k| T::of(a.pose[k]) + since.scale(a.rate[k]));
            }
            Span::After(i, w) => (i, w),
        };
        let (a, b) = (&self.knots[i], &self.knots[i + 1]);
        std::array::from_fn(|k| {
            T::of(a.pose[k])
                + w.along.scale(b.pose[k] - a.pose[k])
                + w.start_rate.scale(a.rate[k])
                + w.end_rate.scale(b.rate[k])
        })
    }

    /// The same path with the values of a shift added to its knots.
    pub fn moved<T: Real>(&self, shift: &PathShift<T>) -> Self {
        let moved = |knot: &Knot, by: &KnotShift<T>| Knot {
            pose: std::array::from_fn(|k| knot.pose[k] + by.pose[k].value()),
            rate: std::array::from_fn(|k| knot.rate[k] + by.rate[k].value()),
            ..*knot
        };
        Self::new(
            self.knots
                .iter()
                .zip(&shift.knots)
                .map(|(a, b)| moved(a, b))
                .collect(),
        )
    }

    /// How each knot follows when the end of a straight path is moved and the timing stays: the share
    /// s of the way done at the knot, and its rate, 1/s. Zero on a path of no length.
    pub fn shares_of_end(&self) -> Vec<[f64; 2]> {
        let (first, last) = (&self.knots[0].pose, &self.knots[self.knots.len() - 1].pose);
        let way: [f64; 3] = std::array::from_fn(|k| last[k] - first[k]);
        let square: f64 = way.iter().map(|c| c * c).sum();
        let share = |v: [f64; 3]| {
            let along: f64 = v.iter().zip(&way).map(|(a, b)| a * b).sum();
            if square > 0.0 { along / square } else { 0.0 }
        };
        self.knots
            .iter()
            .map(|knot| {
                let done = std::array::from_fn(|k| knot.pose[k] - first[k]);
                [share(done), share([knot.rate[0], knot.rate[1], knot.rate[2]])]
            })
            .collect()
    }
}

/// Pose where the clamp really is at time `t_s`: the recorded pose, and what the laws add to it.
fn real_pose<T: Real>(recorded: &Recorded<T>, laws: &[Box<dyn PathLaw<T>>], t_s: f64) -> Pose<T> {
    let mut pose = recorded.pose(t_s);
    for law in laws {
        let offset = law.offset(recorded, t_s);
        for k in 0..7 {
            pose[k] += offset[k];
        }
    }
    pose
}

/// What a grip does besides following its recorded path.
#[derive(Clone, Copy)]
pub struct Grasp<'a, T> {
    /// Errors of the path.
    pub laws: &'a [Box<dyn PathLaw<T>>],
    /// Turn of the rope in it against the recorded direction, about its position, as it stands at first.
    pub turn: Option<Mat3<T>>,
}

impl<T> Grasp<'_, T> {
    /// As recorded.
    pub const AS_RECORDED: Self = Self {
        laws: &[],
        turn: None,
    };
}

/// Where a time lies between the knots of a path.
pub enum Span<T> {
    /// Beyond the ends: the path stands still at this knot.
    At(usize),
    /// This long after the last knot, s, and open: the path goes on at that knot's rate.
    Beyond(usize, T),
    /// Between this knot and the next.
    After(usize, Hermite<T>),
}

/// Weights of cubic Hermite interpolation between two knots.
pub struct Hermite<T> {
    /// Weight of the second pose; the first has the rest to one.
    pub along: T,
    /// Weight of the first rate, s.
    pub start_rate: T,
    /// Weight of the second rate, s.
    pub end_rate: T,
}

impl<T: Real> Hermite<T> {
    /// At share `u` of the way from one knot to another that is `h` further.
    pub fn at(u: T, h: f64) -> Self {
        let (u2, u3) = (u * u, u * u * u);
        Self {
            along: u2.scale(3.0) - u3.scale(2.0),
            start_rate: (u3 - u2.scale(2.0) + u).scale(h),
            end_rate: (u3 - u2).scale(h),
        }
    }
}

/// A change of one knot of a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnotShift<T> {
    /// Of its pose.
    pub pose: Pose<T>,
    /// Of its rate, 1/s.
    pub rate: Pose<T>,
}

/// A change of the path of one grip, knot by knot: how derivatives with respect to a path enter. The
/// simulation is the one of the scene with that path, the rope's own start unchanged.
#[derive(Clone, Debug, PartialEq)]
pub struct PathShift<T> {
    /// Which grip of the scene.
    pub grip: usize,
    /// One per knot of its path.
    pub knots: Vec<KnotShift<T>>,
}

impl<T: Real> PathShift<T> {
    /// The end of a straight path (the release point of a swing) moved by `by_m` while the timing
    /// stays: every knot moves by its share of the way.
    pub fn of_end(grip: usize, path: &ClampPath, by_m: Vec3<T>) -> Self {
        let [x, y, z] = by_m;
        let zero = T::zero();
        let moved = |share: f64| {
            [
                x.scale(share),
                y.scale(share),
                z.scale(share),
                zero,
                zero,
                zero,
                zero,
            ]
        };
        let shift = |[pose, rate]: [f64; 2]| KnotShift {
            pose: moved(pose),
            rate: moved(rate),
        };
        let knots = path.shares_of_end().into_iter().map(shift).collect();
        Self { grip, knots }
    }
}

/// Slope of entry `k` between two samples.
fn slope(a: &Sample, b: &Sample, k: usize) -> f64 {
    (b.1[k] - a.1[k]) / (b.0 - a.0)
}

/// Slope of entry `k` at the first of samples that lead away from an end of a path: that of the parabola through
/// the first three.
fn edge_slope(inwards: &[&Sample], k: usize) -> f64 {
    match inwards {
        [] | [_] => 0.0,
        [a, b] => slope(a, b, k),
        [a, b, c, ..] => slope(a, b, k) + slope(a, c, k) - slope(b, c, k),
    }
}

/// Rigid motion of a clamp relative to its first pose.
#[derive(Clone, Copy, Debug)]
pub struct RigidMotion<T> {
    /// Position of the clamp, m.
    pub position_m: Vec3<T>,
    /// Rotation since the first pose.
    pub rotation: Mat3<T>,
}

impl<T: Real> RigidMotion<T> {
    /// Motion at time `t_s` of a clamp that follows `recorded`, changed by the grasp. Offsets of [`Self::place`] are
    /// measured from the position which its first pose has without tangents and shifts. Quaternions are normalised here.
    pub fn at(recorded: &Recorded<T>, grasp: &Grasp<T>, t_s: f64) -> Self {
        let (held, first) = recorded.first();
        let now = real_pose(recorded, grasp.laws, t_s);
        let unit = |pose: &Pose<T>| {
            let q = [pose[3], pose[4], pose[5], pose[6]];
            let square = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
            let inverse = T::one() / square.sqrt();
            q.map(|c| c * inverse)
        };
        let [start, end] = [&first, &now].map(|pose| rotation_of_quaternion(unit(pose)));
        let mut rotation = matmul_transposed(&end, &start);
        if let Some(turn) = &grasp.turn {
            rotation = matmul(&rotation, turn);
        }
        let moved = std::array::from_fn(|k| first[k] - T::of(held[k]));
        Self {
            position_m: sub([now[0], now[1], now[2]], matvec(&rotation, moved)),
            rotation,
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
    clamp_per_kg: T,
) -> Vec<Vec3<T>> {
    let mut forces = vec![zero3(); motions.len()];
    for p in particles {
        let Some((grip, offset_m)) = p.grip else { continue };
        let Some(motion) = &motions[grip] else { continue };
        let gap = sub(motion.place(offset_m), p.position_m);
        forces[grip] = add(forces[grip], mul(gap, p.mass_kg * clamp_per_kg));
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

    #[test]
    fn a_sampled_parabola_in_motion_is_followed_exactly_from_its_first_sample_on() {
        let pose = |t: f64| [0.7 * t - t * t, 1.0, -3.0 * t, 0.0, 0.0, 0.0, 1.0];
        let samples = [0.0, 0.1, 0.25, 0.3].map(|t| (t, pose(t), true));
        let path = ClampPath::from_samples_in_motion(&samples);
        for step in 0..=30 {
            let t = 0.01 * f64::from(step);
            let got = path.pose(t);
            for (got, wanted) in got.iter().zip(pose(t)) {
                assert!((got - wanted).abs() < 1e-12, "{t}: {got}, not {wanted}");
            }
        }
    }
}
