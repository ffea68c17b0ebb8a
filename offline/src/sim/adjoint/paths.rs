//! Derivative with respect to the paths of the clamps: from forces on gripped particles to the motion
//! of the clamp, through the laws that disturb it, to the knots.

use super::state::total;
use super::var::{Session, Var};
use crate::sim::clamp::{ClampPath, KnotShift, PathShift, RigidMotion};
use crate::sim::lanes::Lanes;
use crate::sim::physics::{Physics, Pose};
use crate::sim::real::{Arithmetic, Real};
use crate::sim::recorded::Recorded;
use crate::sim::rollout::{Setup, grasp};
use crate::sim::tensor::{Mat3, Vec3};
use std::cell::RefCell;
use std::collections::BTreeMap;

/// Derivative with respect to one knot of a path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct KnotGradient {
    /// With respect to its pose, per m and per unit of the quaternion.
    pub pose: [f64; 7],
    /// With respect to the rate of its pose, s times that.
    pub rate: [f64; 7],
}

/// Derivative with respect to the end of a straight path while its timing stays: for the bottom grip of
/// a swing, with respect to the release point.
pub fn release_gradient(path: &ClampPath, knots: &[KnotGradient]) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for ([share, rate], knot) in path.shares_of_end().into_iter().zip(knots) {
        for k in 0..3 {
            sum[k] += share * knot.pose[k] + rate * knot.rate[k];
        }
    }
    sum
}

/// Derivative with respect to the poses that [`ClampPath::from_samples`] took, one per knot: rates follow
/// from poses, so what they do counts too.
pub fn sample_gradient(path: &ClampPath, knots: &[KnotGradient]) -> Vec<[f64; 7]> {
    let times = path.knots().iter().map(|knot| knot.t_s);
    let mut samples: Vec<(f64, Pose<f64>, bool)> = times.map(|t_s| (t_s, [0.0; 7], true)).collect();
    let mut gradient = Vec::with_capacity(knots.len());
    for (index, knot) in knots.iter().enumerate() {
        // Rates are linear in poses: those of one sample moved by one are its weights.
        samples[index].1[0] = 1.0;
        let moved = ClampPath::from_samples(&samples);
        samples[index].1[0] = 0.0;
        let mut sum = knot.pose;
        for (weight, by) in moved.knots().iter().zip(knots) {
            for k in 0..7 {
                sum[k] += weight.rate[0] * by.rate[k];
            }
        }
        gradient.push(sum);
    }
    gradient
}

/// Derivatives with respect to the motion of a clamp in one step.
#[derive(Clone, Copy, Default)]
pub(super) struct MotionCotangent {
    position: Vec3<f64>,
    rotation: Mat3<f64>,
}

impl MotionCotangent {
    /// Adds those of registers of particles: sums of the derivatives with respect to their places, and of these times
    /// where they lie from the clamp, m.
    #[inline(always)]
    pub(super) fn add<L: Lanes>(&mut self, position: Vec3<L>, rotation: &Mat3<L>) {
        for a in 0..3 {
            self.position[a] += total(position[a]);
            for b in 0..3 {
                self.rotation[a][b] += total(rotation[a][b]);
            }
        }
    }

    /// Hands them to a motion on the tape.
    pub(super) fn seed(&self, session: &Session, motion: &RigidMotion<Var>) {
        for a in 0..3 {
            session.seed(motion.position_m[a], self.position[a]);
            for b in 0..3 {
                session.seed(motion.rotation[a][b], self.rotation[a][b]);
            }
        }
    }

    /// Those that a sweep has brought to a motion on the tape.
    pub(super) fn of(session: &Session, motion: &RigidMotion<Var>) -> Self {
        let adjoint = |x: Var| session.adjoint(x);
        Self {
            position: motion.position_m.map(adjoint),
            rotation: motion.rotation.map(|row| row.map(adjoint)),
        }
    }
}

/// Gradients with respect to all knots, as they grow on the way back.
pub(super) struct PathGradients {
    pub(super) grips: Vec<Vec<KnotGradient>>,
    /// The physics' path shifts as constants.
    shifts: Vec<PathShift<Var>>,
}

impl PathGradients {
    pub(super) fn new(setup: &Setup<Var>) -> Self {
        let constant = |pose: &Pose<Var>| pose.map(|x| Var::of(x.value()));
        let knot = |knot: &KnotShift<Var>| KnotShift {
            pose: constant(&knot.pose),
            rate: constant(&knot.rate),
        };
        let shift = |shift: &PathShift<Var>| PathShift {
            grip: shift.grip,
            knots: shift.knots.iter().map(knot).collect(),
        };
        let paths = setup.scene.grips.iter().map(|grip| &grip.path);
        Self {
            grips: paths
                .map(|p| vec![KnotGradient::default(); p.knots().len()])
                .collect(),
            shifts: setup.context.physics.path_shifts.iter().map(shift).collect(),
        }
    }

    /// Carries the derivative with respect to the motion of grip `index` in step `number` on to the
    /// knots, and to the parameters of the path laws.
    pub(super) fn pull_back(
        &mut self,
        session: &Session,
        setup: &Setup<Var>,
        index: usize,
        number: usize,
        bar: &MotionCotangent,
    ) {
        let path = &setup.scene.grips[index].path;
        let shift = self.shifts.iter().find(|shift| shift.grip == index);
        let mark = session.mark();
        let inputs = || -> Pose<Var> { std::array::from_fn(|_| session.input(0.0)) };
        let plus = |pose: Pose<Var>, by: &Pose<Var>| std::array::from_fn(|k| pose[k] + by[k]);
        // Every knot that is read is an input of its own.
        let read: RefCell<BTreeMap<usize, KnotShift<Var>>> = RefCell::default();
        let knot = |index: usize| {
            let mut read = read.borrow_mut();
            let input = read.entry(index).or_insert_with(|| KnotShift {
                pose: inputs(),
                rate: inputs(),
            });
            shift.map_or(*input, |shift| KnotShift {
                pose: plus(shift.knots[index].pose, &input.pose),
                rate: plus(shift.knots[index].rate, &input.rate),
            })
        };
        let motion = RigidMotion::at(
            &Recorded::new(path, Some(&knot)),
            &grasp(setup.scene, setup.context.physics, index),
            setup.time_s(number) + setup.context.dt_s,
        );
        bar.seed(session, &motion);
        session.sweep(mark);
        let knots = &mut self.grips[index];
        for (index, input) in read.into_inner() {
            for k in 0..7 {
                knots[index].pose[k] += session.adjoint(input.pose[k]);
                knots[index].rate[k] += session.adjoint(input.rate[k]);
            }
        }
        session.rewind(mark);
    }

    /// Hands the gradients on to the path shifts, where these follow from parameters.
    pub(super) fn seed_shifts(&self, session: &Session, physics: &Physics<Var>) {
        for shift in &physics.path_shifts {
            for (knot, bar) in shift.knots.iter().zip(&self.grips[shift.grip]) {
                for k in 0..7 {
                    session.seed(knot.pose[k], bar.pose[k]);
                    session.seed(knot.rate[k], bar.rate[k]);
                }
            }
        }
    }
}
