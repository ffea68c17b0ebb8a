//! Derivative of the effects' laws at the particles: recorded as they compute, and swept back.

use super::Precision;
use super::state::StateCotangent;
use super::var::{Session, Var};
use crate::sim::lanes::{Instructions, Lanes, MOST_LANES};
use crate::sim::physics::Physics;
use crate::sim::real::{Arithmetic, Real};
use crate::sim::rollout::Setup;
use crate::sim::step::{Particle, add_stress_laws, force_of_laws};
use crate::sim::sweep::Body;
use crate::sim::tensor::{Mat3, Vec3, det};

/// Derivatives of the result with respect to what the laws gave.
pub(super) struct LawCotangent<L> {
    /// With respect to the force, 1/N.
    pub(super) force: Vec3<L>,
    /// With respect to the first Piola-Kirchhoff stress, 1/Pa.
    pub(super) stress: Mat3<L>,
}

/// Numbers of a particle's state: deformation gradient, rate, position, velocity.
const NUMBERS: usize = 24;

/// Whether a physics has laws that act on particles.
pub(super) fn has_laws<T>(physics: &Physics<T>) -> bool {
    !(physics.stress_laws.is_empty() && physics.force_laws.is_empty())
}

/// Pulls `wanted` back to the state of one member of a block's slices, into `bar`, and to the
/// parameters, on the tape's foot. `rate` is dx Ḟ.
pub(super) fn pull_back_laws<F: Precision, I: Instructions>(
    session: &Session,
    vars: &Setup<Var>,
    (block, member): (usize, usize),
    (body, rate): (&Body<F::Plain<I>>, &Mat3<F::Plain<I>>),
    wanted: &LawCotangent<F::Plain<I>>,
    bar: &mut StateCotangent<F::Plain<I>>,
) {
    let dx = vars.scene.grid.spacing_m;
    let count = <F::Plain<I> as Lanes>::COUNT;
    let (slices, members) = (vars.layout.slices.len(), vars.layout.section_m.len());
    let matrix = |m: &Mat3<F::Plain<I>>, n: usize| m[n / 3][n % 3].to_lanes().map(Real::value);
    let numbers: [[f64; MOST_LANES]; NUMBERS] = std::array::from_fn(|n| match n {
        0..9 => matrix(&body.deformation_gradient, n),
        9..18 => matrix(rate, n - 9).map(|x| x / dx),
        18..21 => body.position_m[n - 18].to_lanes().map(Real::value),
        _ => body.velocity_m_s[n - 21].to_lanes().map(Real::value),
    });
    let force = wanted.force.map(|x| x.to_lanes().map(Real::value));
    let stress: [[f64; MOST_LANES]; 9] = std::array::from_fn(|n| matrix(&wanted.stress, n));
    let mut bars = [[0.0; MOST_LANES]; NUMBERS];
    for lane in 0..count.min(slices - block * count) {
        let mark = session.mark();
        let inputs: [Var; NUMBERS] = std::array::from_fn(|n| session.input(numbers[n][lane]));
        let vector = |first: usize| -> Vec3<Var> { std::array::from_fn(|k| inputs[first + k]) };
        let index = (block * count + lane) * members + member;
        let particle = Particle {
            position_m: vector(18),
            velocity_m_s: vector(21),
            deformation_rate: [vector(9), vector(12), vector(15)],
            deformation_gradient: [vector(0), vector(3), vector(6)],
            mass_kg: vars.masses_kg[index],
            volume_m3: vars.layout.particle_volume_m3(index),
            length_m: vars.layout.particle_length_m(index),
            grip: None,
        };
        let seeds = (force.map(|f| f[lane]), stress.map(|s| s[lane]));
        record(session, vars, &particle, &seeds);
        session.sweep(mark);
        for (bar, &input) in bars.iter_mut().zip(&inputs) {
            bar[lane] = session.adjoint(input);
        }
        session.rewind(mark);
    }
    let register = |n: usize, scale: f64| F::Plain::<I>::from_lanes(|lane| F::of(bars[n][lane] * scale));
    for a in 0..3 {
        bar.position[a] += register(18 + a, 1.0);
        bar.velocity[a] += register(21 + a, 1.0);
        for b in 0..3 {
            bar.deformation_gradient[a][b] += register(3 * a + b, 1.0);
            bar.rate[a][b] += register(9 + 3 * a + b, 1.0 / dx);
        }
    }
}

/// Lets the laws compute and seeds their results.
fn record(session: &Session, vars: &Setup<Var>, particle: &Particle<Var>, seeds: &([f64; 3], [f64; 9])) {
    let physics = vars.context.physics;
    if !physics.stress_laws.is_empty() {
        let mut stress = [[Var::zero(); 3]; 3];
        let j = det(&particle.deformation_gradient);
        add_stress_laws(particle, &vars.context, j, &mut stress);
        for (var, bar) in stress.iter().flatten().zip(&seeds.1) {
            session.seed(*var, *bar);
        }
    }
    if !physics.force_laws.is_empty() {
        let force_n = force_of_laws(particle, &vars.context);
        for (var, bar) in force_n.iter().zip(&seeds.0) {
            session.seed(*var, *bar);
        }
    }
}
