//! Derivative of the effects' laws at a particle: recorded as they compute, and swept back.

use super::var::{Session, Var};
use super::{Float, State};
use crate::sim::real::Real;
use crate::sim::rollout::Setup;
use crate::sim::step::{Particle, add_stress_laws, force_of_laws};
use crate::sim::tensor::{Mat3, Vec3, det};

/// Derivatives of the result with respect to what the laws gave at a particle.
pub(super) struct LawCotangent<F> {
    /// With respect to the force, 1/N.
    pub(super) force: Vec3<F>,
    /// With respect to the first Piola-Kirchhoff stress, 1/Pa.
    pub(super) stress: Mat3<F>,
}

/// Pulls `wanted` back to the particle's state, into `bar`, and to the parameters, on the tape's foot.
pub(super) fn pull_back_laws<F: Float>(
    session: &Session,
    vars: &Setup<Var>,
    index: usize,
    particle: &Particle<F>,
    wanted: &LawCotangent<F>,
    bar: &mut State<F>,
) {
    let physics = vars.context.physics;
    let mark = session.mark();
    let input = |v: Vec3<F>| v.map(|x| session.input(x.value()));
    let p = Particle {
        position_m: input(particle.position_m),
        velocity_m_s: input(particle.velocity_m_s),
        deformation_rate: particle.deformation_rate.map(input),
        deformation_gradient: particle.deformation_gradient.map(input),
        mass_kg: vars.masses_kg[index],
        volume_m3: particle.volume_m3,
        length_m: particle.length_m,
        grip: None,
    };
    if !physics.stress_laws.is_empty() {
        let mut stress = [[Var::zero(); 3]; 3];
        let j = det(&p.deformation_gradient);
        add_stress_laws(&p, &vars.context, j, &mut stress);
        for (var, bar) in stress.iter().flatten().zip(wanted.stress.iter().flatten()) {
            session.seed(*var, bar.value());
        }
    }
    if !physics.force_laws.is_empty() {
        let force_n = force_of_laws(&p, &vars.context);
        for (var, bar) in force_n.iter().zip(&wanted.force) {
            session.seed(*var, bar.value());
        }
    }
    session.sweep(mark);
    let take = |bar: &mut Vec3<F>, vars: &Vec3<Var>| {
        for (sum, &var) in bar.iter_mut().zip(vars) {
            *sum += F::of(session.adjoint(var));
        }
    };
    take(&mut bar.position_m, &p.position_m);
    take(&mut bar.velocity_m_s, &p.velocity_m_s);
    for a in 0..3 {
        take(&mut bar.deformation_rate[a], &p.deformation_rate[a]);
        take(&mut bar.deformation_gradient[a], &p.deformation_gradient[a]);
    }
    session.rewind(mark);
}
