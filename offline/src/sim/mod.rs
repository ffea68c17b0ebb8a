//! The simulator: 3-D MLS-MPM of a rope, written once and generic over the number type.
//!
//! Letters, as in the papers (Hu et al. 2018, "A moving least squares material point method";
//! Jiang et al. 2015, "The affine particle-in-cell method"; Stomakhin et al. 2012, "Energetically
//! consistent invertible elasticity"):
//!
//! | letter | meaning | unit |
//! |---|---|---|
//! | x, v | position and velocity of a particle | m, m/s |
//! | Ḟ (`deformation_rate`) | affine velocity field of a particle in undeformed coordinates | 1/s |
//! | F (`deformation_gradient`) | deformation gradient, row-major, dx = F dX | 1 |
//! | J | det F | 1 |
//! | R | rotation of the polar decomposition F = R S | 1 |
//! | τ (`kirchhoff`) | Kirchhoff stress, J times the Cauchy stress | Pa |
//! | μ, λ | Lamé parameters of E (`young_pa`) and ν (`poisson`) | Pa |
//! | s | arc length along the undeformed rope, 0 at its start | m |
//!
//! One step reads clamp targets, scatters particles to the grid, updates the grid, gathers back
//! ([`step`]). Nothing here reads a clock, a file or a random source; the same scene gives the same
//! bits for every thread count, because one rollout runs on one thread.
//!
//! # Speed
//!
//! [`simulate`] steps many particles at a time; [`step`] is its readable twin and the oracle of its test.
//! Figures are ns per particle and step, f32, on one core of an AMD EPYC (Zen 5, AVX-512), processor
//! time, best of 3 to 9 runs on a loaded machine; ropes of 360, 660, 1,044, 3,984 and 15,888 particles.
//!
//! | what | 360 | 660 | 1,044 | 3,984 | 15,888 | 2, 8, 16 tangents at 660 |
//! |---|---|---|---|---|---|---|
//! | weights factorised by slice and member, registers over slices, one pass per step | 15.1 | 15.1 | 14.4 | 17.5 | 22.6 | 158, 525, 954 |
//! | no closures where registers are used: those that are not inlined were compiled without them | 13.4 | 13.6 | 13.5 | 13.1 | 19.8 | 46, 276, 516 |
//! | a block's step compiled once per kind of register, channels counted at run time | 13.7 | 13.5 | 12.7 | 11.8 | 13.2 | 42, 131, 278 |
//!
//! In the last form f64 costs 23 ns, f64 with 16 tangents 518. A tangent costs about as much as a value:
//! the stress without its polar decomposition, the same transfers. So 16 tangents cost 20 plain rollouts,
//! not 6; the aim of 6 was set for a rollout of 50 ns, and in those terms they cost 5.6.
//!
//! What did not pay:
//! - *Longer steps.* At a CFL number of 0.8 all swings that were tried run (E from 0.2 to 4.3 MPa, ν = 0.2
//!   and 0.45), at 1.0 those with ν = 0.45 stop, at 1.2 all. But the reach depends on the step: for
//!   E = 0.9 MPa, ν = 0.2, released at (0.12, 0.12) m, it is 0.4136, 0.4181, 0.4173, 0.4157, 0.4151 m at CFL
//!   0.15, 0.3, 0.6, 0.8, 1.0; for E = 4.3 MPa 0.4212, 0.4222, 0.4342, 0.4358, 0.4369. A longer step is thus
//!   not as accurate to 0.1 mm, nor is a shorter one better; the likely cause, not yet shown, is that
//!   transfers damp by the step, not by the
//!   second. [`scene::CFL`] stays at 0.6.
//! - *Ending a swing early*, once the reach has not grown for 0.1 s and the rope moves back as a whole:
//!   a quarter fewer steps, but of 193 random swings some reached further later, one by 0.32 m.
//!
//! The step depends on the parameters, and tangents hold it fixed. That is not harmless where the wave
//! speed sets the step: 10 % in E are 5 % in the step, and by the figures above that moves the reach by
//! some tenths of a millimetre, against some millimetres that E itself does. A scene can therefore fix its
//! step ([`scene::StepLength`]); tangents are then exact.

pub mod adjoint;
pub mod band;
mod blocks;
pub mod clamp;
pub mod curve;
pub mod dual;
pub mod elastic;
mod engine;
pub mod error;
pub mod grid;
mod hanging;
pub mod kernel;
pub mod lanes;
mod laws;
pub mod material;
mod nodes;
pub mod physics;
pub mod real;
pub mod rollout;
pub mod rope;
pub mod scene;
pub mod start;
pub mod statics;
pub mod step;
mod sweep;
pub mod tensor;
mod transfer;

pub use dual::Dual;
pub use error::{Cause, SimError};
pub use lanes::Laned;
pub use physics::Physics;
pub use real::{Arithmetic, Real};
pub use rollout::{Rollout, simulate};
pub use scene::Scene;
