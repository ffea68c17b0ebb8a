//! The derivative of one number with respect to many: reverse mode over a whole rollout.
//!
//! Forward mode ([`super::Dual`]) pays for every input; this pays once for all: elastic and effect
//! parameters, hundreds of knots of the grippers' paths, a force along rope and time. The simulation
//! runs forward and keeps what `plan.rs` says, the caller looks at the rollout and says how its result
//! changes with it ([`Cotangent`]), and the way back (`reverse.rs`) gives the gradient.
//!
//! | part of a step | its derivative |
//! |---|---|
//! | transfer to the grid and back | linear with constant weights: each is the transpose of the other, so both directions use the functions of `transfer.rs` |
//! | elastic stress | by hand, safe at F = I (`stress.rs`) |
//! | table, friction, clamps | by hand (`nodes.rs`) |
//! | effects' laws, clamp motion, masses | recorded and swept (`var.rs`): an effect needs no code for it |
//!
//! Where a derivative does not exist, the code returns one side: a node that sticks to the table has
//! derivative zero along it, contact that is open has none, and the step at which a clamp opens or a
//! frame is due is not differentiated, nor is the time step (see [`super::Scene::time_step_s`]).
//! Forward mode makes the same choices.
//!
//! What it costs, `cargo bench -p offline --bench adjoint`, f32, 1727 steps of a rope that lies on the
//! table and is lifted at one end, forward included, on a loaded machine: 4.0 forward passes and 75 MB for
//! 4,032 particles (78 against 19 ns per particle and step), 4.4 for 1,032, 3.6 for 384. When nodes under springs,
//! here almost all, went back one by one, and what clamps gave was not compiled for registers, it was 4.3 to 6.4,
//! 5.5 to 5.6 and 6.7 to 7.2 in the same minutes. With drag, whose law is recorded anew for each slice in each step, it
//! is 5.6, 6.2 and 6.0.
//!
//! Laws that change the material or what is seen ([`Physics::changes_material`], observation laws) are
//! refused: the way back would have to undo what they remember. Forward mode has their derivatives.

mod laws;
mod nodes;
mod paths;
mod plan;
mod reverse;
mod seeds;
mod state;
mod stress;
mod var;

pub use paths::{KnotGradient, release_gradient, sample_gradient};
pub use var::Var;

use super::blocks::Body;
use super::error::{Cause, SimError};
#[cfg(target_arch = "x86_64")]
use super::lanes::{Avx2, Avx512};
use super::lanes::{Instructions, Laned, Portable};
use super::physics::Physics;
use super::real::{Float, Real};
use super::rollout::{Recorder, Rollout, Setup};
use super::scene::Scene;
use super::start::Start;
use super::sweep::Sweep;
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

/// `f32` or `f64`, as rollouts compute with them.
pub trait Precision: Float + Laned<Base = Self> {}
impl<F: Float + Laned<Base = F>> Precision for F {}

/// Simulates a scene and differentiates a result: `loss` looks at the rollout and says how the result
/// changes with it.
///
/// # Errors
/// As [`super::simulate`], [`super::Cause::Memory`] where `budget_bytes` is too small, and
/// [`super::Cause::OneWay`] where a law changes the material or what is seen.
///
/// # Panics
/// The cotangent's shape is not that of the rollout's frames.
pub fn differentiate<F: Precision, M: Family>(
    scene: &Scene,
    family: &M,
    theta: &[f64],
    budget_bytes: usize,
    loss: impl FnOnce(&Rollout<F>) -> Cotangent,
) -> Result<Differentiated<F>, SimError> {
    #[cfg(target_arch = "x86_64")]
    {
        if is_x86_feature_detected!("avx512f") {
            // SAFETY: the processor has the instructions that the function was compiled for.
            return unsafe { run_avx512(scene, family, theta, budget_bytes, loss) };
        }
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            // SAFETY: as above.
            return unsafe { run_avx2(scene, family, theta, budget_bytes, loss) };
        }
    }
    run::<F, M, Portable>(scene, family, theta, budget_bytes, loss)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f")]
unsafe fn run_avx512<F: Precision, M: Family>(
    scene: &Scene,
    family: &M,
    theta: &[f64],
    budget_bytes: usize,
    loss: impl FnOnce(&Rollout<F>) -> Cotangent,
) -> Result<Differentiated<F>, SimError> {
    run::<F, M, Avx512>(scene, family, theta, budget_bytes, loss)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
unsafe fn run_avx2<F: Precision, M: Family>(
    scene: &Scene,
    family: &M,
    theta: &[f64],
    budget_bytes: usize,
    loss: impl FnOnce(&Rollout<F>) -> Cotangent,
) -> Result<Differentiated<F>, SimError> {
    run::<F, M, Avx2>(scene, family, theta, budget_bytes, loss)
}

#[inline(always)]
fn run<F: Precision, M: Family, I: Instructions>(
    scene: &Scene,
    family: &M,
    theta: &[f64],
    budget_bytes: usize,
    loss: impl FnOnce(&Rollout<F>) -> Cotangent,
) -> Result<Differentiated<F>, SimError> {
    let values: Vec<F> = theta.iter().map(|&x| F::of(x)).collect();
    let physics = family.physics(&values);
    if physics.changes_material() || !physics.observation_laws.is_empty() {
        return Err(SimError::at_start(Cause::OneWay));
    }
    let setup = Setup::new(scene, &physics)?;
    if !matches!(scene.start, Start::Straight) {
        // The start itself would depend on the parameters.
        return Err(SimError::at_start(super::Cause::HangsAtStart));
    }
    let mut engine: Sweep<F, I> = setup.engine();
    let nodes_bytes = size_of_val(engine.blocks.velocity.channel(0));
    let state_bytes = size_of_val(&engine.blocks.bodies[..]) + nodes_bytes;
    let plan = Plan::new(setup.steps, state_bytes, nodes_bytes, budget_bytes).map_err(SimError::at_start)?;
    let mut record = Record::new(plan);
    let mut recorder = Recorder::new(scene);
    for state in 0..=setup.steps {
        record.begin(&engine, state);
        let mut motions = setup.motions(state);
        setup.sweep(&mut engine, state, &mut motions)?;
        recorder.record(&engine, state, &setup);
        if state < setup.steps {
            setup.update_nodes(&mut engine, state);
            record.keep(&engine, state);
        }
        recorder.motions = motions;
    }
    let rollout = recorder.finish(&setup);
    let cotangent = loss(&rollout);
    let seeds = Seeds::new(cotangent, &recorder, &rollout, &setup.layout);
    let gradient = reverse::gradient(&setup, engine, record, seeds, family, theta)?;
    Ok(Differentiated {
        rollout,
        gradient,
        memory_bytes: plan.bytes,
        repeated_steps: plan.range(0, setup.steps).len() * plan.kept_from,
    })
}

/// The rope at the end of a step's update of the nodes, before the particles have moved with them.
struct Checkpoint<F: Laned, I: Instructions> {
    bodies: Vec<Body<F::Plain<I>>>,
    /// Velocities of the nodes.
    nodes: Vec<F>,
}

/// What the way forward left for the way back.
struct Record<F: Laned, I: Instructions> {
    plan: Plan,
    /// The state at the start of every segment.
    checkpoints: Vec<Checkpoint<F, I>>,
    /// Node velocities of the kept segments, step after step.
    nodes: Vec<Vec<F>>,
}

impl<F: Precision, I: Instructions> Record<F, I> {
    fn new(plan: Plan) -> Self {
        Self {
            plan,
            checkpoints: Vec::with_capacity(plan.segments),
            nodes: Vec::with_capacity(plan.segments - plan.kept_from),
        }
    }

    /// Takes a checkpoint where a segment starts.
    fn begin(&mut self, engine: &Sweep<F, I>, state: usize) {
        let (segment, within) = (state / self.plan.segment, state % self.plan.segment);
        if within > 0 || segment == self.plan.segments {
            return;
        }
        self.checkpoints.push(Checkpoint {
            bodies: engine.blocks.bodies.clone(),
            nodes: engine.blocks.velocity.channel(0).to_vec(),
        });
        if segment >= self.plan.kept_from {
            self.nodes.push(Vec::new());
        }
    }

    /// Keeps the velocities of the nodes where the plan says so.
    fn keep(&mut self, engine: &Sweep<F, I>, step: usize) {
        if step / self.plan.segment >= self.plan.kept_from
            && let Some(nodes) = self.nodes.last_mut()
        {
            nodes.extend_from_slice(engine.blocks.velocity.channel(0));
        }
    }
}
