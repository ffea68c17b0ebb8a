//! The derivative of one number with respect to many: reverse mode over a whole rollout.
//!
//! Forward mode ([`super::Dual`]) pays for every input; this pays once for all: elastic and effect
//! parameters, hundreds of knots of the grippers' paths, a force along rope and time. The simulation
//! runs forward and keeps what [`plan`] says, the caller looks at the rollout and says how its result
//! changes with it ([`Cotangent`]), and the way back ([`reverse`]) gives the gradient.
//!
//! | part of a step | its derivative |
//! |---|---|
//! | transfer to the grid and back | linear with constant weights: each is the transpose of the other, so both directions use the functions of [`super::step`] |
//! | elastic stress | by hand, safe at F = I ([`stress`]) |
//! | table, friction, clamps | by hand ([`nodes`]) |
//! | effects' laws, clamp motion, masses | recorded and swept ([`var`]): an effect needs no code for it |
//!
//! Where a derivative does not exist, the code returns one side: a node that sticks to the table has
//! derivative zero along it, contact that is open has none, and the step at which a clamp opens or a
//! frame is due is not differentiated, nor is the time step (see [`super::Scene::time_step_s`]).
//! Forward mode makes the same choices.

mod laws;
mod nodes;
mod paths;
mod plan;
mod reverse;
mod seeds;
mod stress;
mod var;

pub use super::dual::Float;
pub use paths::{KnotGradient, release_gradient};
pub use var::Var;

use super::error::SimError;
use super::grid::Grid;
use super::physics::Physics;
use super::real::Real;
use super::rollout::{Recorder, Rollout, Setup};
use super::scene::Scene;
use super::step::Particle;
use super::tensor::Vec3;
use plan::Plan;
use seeds::Seeds;

/// Memory that a gradient may use unless told otherwise, bytes.
pub const DEFAULT_BUDGET_BYTES: usize = 256 << 20;

/// A physics for every value of a parameter vector θ, over any number type.
pub trait Family {
    /// Coefficients and laws at θ.
    fn physics<T: Real>(&self, theta: &[T]) -> Physics<T>;
}

/// How a result changes with a rollout.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cotangent {
    /// Derivative with respect to every point of every frame, 1/m; empty for none.
    pub frames: Vec<Vec<Vec3<f64>>>,
    /// Derivative with respect to [`Rollout::reach_m`], 1/m.
    pub reach: f64,
}

/// The derivative of a result with respect to everything that a rollout is made of.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gradient {
    /// With respect to θ.
    pub theta: Vec<f64>,
    /// With respect to the knots of each grip's path.
    pub paths: Vec<Vec<KnotGradient>>,
    /// With respect to the force per length (1/(N/m)), by block and slice; empty without a force
    /// field.
    pub force_field: Vec<Vec<Vec3<f64>>>,
}

/// A rollout with the gradient of a result.
#[derive(Clone, Debug)]
pub struct Differentiated<F> {
    /// The rollout.
    pub rollout: Rollout<F>,
    /// The gradient.
    pub gradient: Gradient,
    /// Memory that checkpoints and node velocities took, bytes.
    pub memory_bytes: usize,
    /// Steps that were simulated twice because the budget did not hold them.
    pub repeated_steps: usize,
}

/// Simulates a scene and differentiates a result: `loss` looks at the rollout and says how the result
/// changes with it.
///
/// # Errors
/// As [`super::simulate`], and [`super::Cause::Memory`] where `budget_bytes` is too small.
///
/// # Panics
/// The cotangent's shape is not that of the rollout's frames.
pub fn differentiate<F: Float, M: Family>(
    scene: &Scene,
    family: &M,
    theta: &[f64],
    budget_bytes: usize,
    loss: impl FnOnce(&Rollout<F>) -> Cotangent,
) -> Result<Differentiated<F>, SimError> {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") {
        // SAFETY: the processor has the instructions that the function was compiled for.
        return unsafe { run_avx2(scene, family, theta, budget_bytes, loss) };
    }
    run(scene, family, theta, budget_bytes, loss)
}

/// The same code compiled for wider registers, as in [`super::simulate`].
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
unsafe fn run_avx2<F: Float, M: Family>(
    scene: &Scene,
    family: &M,
    theta: &[f64],
    budget_bytes: usize,
    loss: impl FnOnce(&Rollout<F>) -> Cotangent,
) -> Result<Differentiated<F>, SimError> {
    run(scene, family, theta, budget_bytes, loss)
}

#[inline(always)]
fn run<F: Float, M: Family>(
    scene: &Scene,
    family: &M,
    theta: &[f64],
    budget_bytes: usize,
    loss: impl FnOnce(&Rollout<F>) -> Cotangent,
) -> Result<Differentiated<F>, SimError> {
    let values: Vec<F> = theta.iter().map(|&x| F::of(x)).collect();
    let physics = family.physics(&values);
    let setup = Setup::new(scene, &physics)?;
    let mut grid = setup.grid();
    let plan = Plan::new(
        setup.steps,
        setup.layout.particles() * size_of::<State<F>>(),
        grid.nodes.len() * size_of::<Vec3<F>>(),
        budget_bytes,
    )
    .map_err(SimError::at_start)?;
    let mut recorder = Recorder::new(scene, &setup.layout);
    let mut particles = setup.particles();
    let mut record = Record::new(plan);
    recorder.record(&particles, 0, 0.0);
    for segment in 0..plan.segments {
        record.checkpoints.push(particles.iter().map(State::of).collect());
        let kept = segment >= plan.kept_from;
        let mut nodes = Vec::new();
        for number in plan.range(segment, setup.steps) {
            setup.advance(&mut particles, &mut grid, number)?;
            if kept {
                keep_nodes(&grid, &mut nodes);
            }
            recorder.record(&particles, number + 1, setup.time_s(number + 1));
        }
        if kept {
            record.nodes.push(nodes);
        }
    }
    let rollout = recorder.finish(&setup);
    let cotangent = loss(&rollout);
    let seeds = Seeds::new(cotangent, &recorder, &rollout);
    let gradient = reverse::gradient(&setup, (grid, particles), record, seeds, family, theta)?;
    Ok(Differentiated {
        rollout,
        gradient,
        memory_bytes: plan.bytes,
        repeated_steps: plan.range(0, setup.steps).len() * plan.kept_from,
    })
}

/// What moves with a particle.
#[derive(Clone, Copy)]
struct State<F> {
    position_m: Vec3<F>,
    velocity_m_s: Vec3<F>,
    deformation_rate: [Vec3<F>; 3],
    deformation_gradient: [Vec3<F>; 3],
}

impl<F: Float> State<F> {
    fn zero() -> Self {
        let zero = [F::zero(); 3];
        Self {
            position_m: zero,
            velocity_m_s: zero,
            deformation_rate: [zero; 3],
            deformation_gradient: [zero; 3],
        }
    }

    fn of(particle: &Particle<F>) -> Self {
        Self {
            position_m: particle.position_m,
            velocity_m_s: particle.velocity_m_s,
            deformation_rate: particle.deformation_rate,
            deformation_gradient: particle.deformation_gradient,
        }
    }

    fn restore(&self, particle: &mut Particle<F>) {
        particle.position_m = self.position_m;
        particle.velocity_m_s = self.velocity_m_s;
        particle.deformation_rate = self.deformation_rate;
        particle.deformation_gradient = self.deformation_gradient;
    }
}

/// What the way forward left for the way back.
struct Record<F> {
    plan: Plan,
    /// The state at the start of every segment.
    checkpoints: Vec<Vec<State<F>>>,
    /// Node velocities of the kept segments, step after step.
    nodes: Vec<Vec<Vec3<F>>>,
}

impl<F: Float> Record<F> {
    fn new(plan: Plan) -> Self {
        Self {
            plan,
            checkpoints: Vec::with_capacity(plan.segments),
            nodes: Vec::with_capacity(plan.segments - plan.kept_from),
        }
    }
}

fn keep_nodes<F: Float>(grid: &Grid<F>, nodes: &mut Vec<Vec3<F>>) {
    nodes.extend(grid.nodes.iter().map(|&packed| F::unpack(packed)));
}
