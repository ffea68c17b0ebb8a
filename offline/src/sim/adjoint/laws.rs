//! Derivative of the effects' laws: recorded as they compute, and swept back.

use super::Precision;
use super::state::StateCotangent;
use super::var::{Session, Var};
use crate::sim::axial;
use crate::sim::blocks::Body;
use crate::sim::lanes::{Instructions, Lanes, MOST_LANES};
use crate::sim::physics::{ForcePoint, SliceMotion};
use crate::sim::real::{Arithmetic, Real};
use crate::sim::rollout::Setup;
use crate::sim::tensor::{Mat3, Vec3};

/// One session of the tape, and the rope whose laws it records.
#[derive(Clone, Copy)]
pub(super) struct Tape<'a> {
    pub(super) session: &'a Session,
    pub(super) vars: &'a Setup<'a, Var>,
}

impl Tape<'_> {
    /// Pulls derivatives with respect to the axial stress of one member of a block's slices, P, back to its
    /// deformation gradient, into `bar`, and to the parameters, on the tape's foot.
    pub(super) fn pull_back_axial<F: Precision, I: Instructions>(
        &self,
        block: usize,
        f: &Mat3<F::Plain<I>>,
        stress: &Mat3<F::Plain<I>>,
        bar: &mut StateCotangent<F::Plain<I>>,
    ) {
        let axes = [axial::axis(f).map(values)];
        let seeds = axial::axis(stress).map(values);
        let [of_axis] = self.pulled_back::<F, I, 1>(block, &axes, &seeds, |[axis], _| {
            let context = &self.vars.context;
            match context.physics.cubic_pa(&context.lame) {
                Some(cubic_pa) => axial::piola_column(axis, cubic_pa),
                None => axis,
            }
        });
        for a in 0..3 {
            bar.deformation_gradient[a][0] += register::<F, I>(&of_axis[a], 1.0);
        }
    }

    /// The same for the force on each member of a block's slices, which goes with their mean motion; `bars` are those
    /// of the block.
    pub(super) fn pull_back_force<F: Precision, I: Instructions>(
        &self,
        block: usize,
        bodies: &[Body<F::Plain<I>>],
        force: Vec3<F::Plain<I>>,
        bars: &mut [StateCotangent<F::Plain<I>>],
    ) {
        let mean = Body::mean_motion(bodies).map(values);
        let share = 1.0 / bodies.len() as f64;
        let read = [mean.position_m, mean.velocity_m_s, mean.axis];
        let law = |[position_m, velocity_m_s, axis]: [Vec3<Var>; 3], slice: usize| {
            let members = slice * bodies.len()..(slice + 1) * bodies.len();
            let length_m = self.vars.layout.particle_length_m(members.start);
            // Masses depend on the parameters, so they are on the tape already.
            let masses_kg = self.vars.masses_kg[members].iter();
            let motion = SliceMotion {
                position_m,
                velocity_m_s,
                axis,
                mass_kg: masses_kg.fold(Var::of(0.0), |sum, &m| sum + m).scale(share),
            };
            let point = ForcePoint::new(&motion, length_m, self.vars.context.diameter_m);
            self.vars.context.physics.force_n(&point)
        };
        let of_mean = self.pulled_back::<F, I, 3>(block, &read, &force.map(values), law);
        let [of_position, of_velocity, of_axis] =
            of_mean.map(|bars| bars.map(|bar| register::<F, I>(&bar, share)));
        for bar in bars {
            for a in 0..3 {
                bar.position[a] += of_position[a];
                bar.velocity[a] += of_velocity[a];
                bar.deformation_gradient[a][0] += of_axis[a];
            }
        }
    }

    /// Derivatives with respect to the vectors that a law reads, lane by lane, from those with respect to what it
    /// gives. The law hears the slice, too.
    fn pulled_back<F: Precision, I: Instructions, const N: usize>(
        &self,
        block: usize,
        read: &[Vec3<[f64; MOST_LANES]>; N],
        seeds: &Vec3<[f64; MOST_LANES]>,
        law: impl Fn([Vec3<Var>; N], usize) -> Vec3<Var>,
    ) -> [Vec3<[f64; MOST_LANES]>; N] {
        let count = <F::Plain<I> as Lanes>::COUNT;
        let session = self.session;
        let mut bars = [[[0.0; MOST_LANES]; 3]; N];
        for lane in 0..count.min(self.vars.layout.slices.len() - block * count) {
            let mark = session.mark();
            let inputs = read.map(|vector| vector.map(|lanes| session.input(lanes[lane])));
            let given = law(inputs, block * count + lane);
            for (var, seed) in given.iter().zip(seeds) {
                session.seed(*var, seed[lane]);
            }
            session.sweep(mark);
            for (bar, &input) in bars.iter_mut().flatten().zip(inputs.iter().flatten()) {
                bar[lane] = session.adjoint(input);
            }
            session.rewind(mark);
        }
        bars
    }
}

/// The lanes of a register.
fn values<L: Lanes>(register: L) -> [f64; MOST_LANES] {
    register.to_lanes().map(Real::value)
}

/// A register of lanes.
fn register<F: Precision, I: Instructions>(lanes: &[f64; MOST_LANES], scale: f64) -> F::Plain<I> {
    F::Plain::<I>::from_lanes(|lane| F::of(lanes[lane] * scale))
}
