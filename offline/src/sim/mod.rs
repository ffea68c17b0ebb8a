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
//! One step reads clamp targets, sums up at the nodes what particles, clamps and table push, changes the
//! nodes' velocities by it, and moves the particles with them ([`step`]). Nothing here reads a clock, a file
//! or a random source; the same scene gives the same bits for every thread count, because one rollout runs
//! on one thread.
//!
//! # Damping
//!
//! The grid belongs to the material ([`grid`]), so velocities stay on its nodes. MLS-MPM carries them through
//! the particles in every step, and so it was here at first: what of a velocity field is not affine within a
//! cell was dropped once per *step*. The first bending mode of a rope 1.5 cells thick lost 7.6 % of its energy
//! per period, the reach of a swing changed by 4 mm with the step, and finer steps did not converge. With
//! velocities on the nodes alone it keeps its energy to 2e-9, and damping is what is asked for, per second,
//! whatever the step:
//! - a loss of the material ([`Physics::loss`]), Kelvin-Voigt with a tenth of a millisecond; without any
//!   loss a swing whips so wildly that its reach changes by up to a centimetre with the step;
//! - nodes forget within a millisecond what their particles do not carry (`step.rs`), which takes 2.7 % of
//!   that mode's energy per period; without it, finer grids creep under compression.
//!
//! Seven swings on 1.5 cells (E from 0.2 to 4.3 MPa, three release points) reach within 0.9 mm of the same
//! with a quarter of the step.
//!
//! # Rounding
//!
//! Rollouts run in single precision. A particle that creeps moves by less in a step than half the last digit of its place:
//! summed up as they came, such steps were lost, the clamps' springs made up for it, and that bent the rope. The farther from
//! the origin of the room, the more: a replay of the sample moved by 0.06 m lay 0.10 mm (rms) off, by 0.3 m 0.86 mm, by 1 m
//! 2.4 mm, and the fit to it gave 0.61 for 0.56 MPa. What rounding leaves of each step is now carried on
//! ([`real::Arithmetic::carry_to`]): two sample recordings lie 1 to 3 µm (rms) from double precision up to 1 m off, 4 µm
//! at 3 m, on 1.5 and 2.5 cells. It costs what two runs of one bench differ by (16.9 and 16.3 ns, 15.8 and 17.7). The
//! deformation gradient, which has no place in the room, needs none.
//!
//! # Inertia of a section
//!
//! Masses on nodes turn more slowly than what they stand for. The second moment of quadratic splines, h apart, about a
//! particle is h²/4 along each axis; so a section of radius r has, per mass, a rotary inertia of r²/4 + h²/4 about a
//! diameter and twice that about the axis: 2.8 times its own on 1.5 cells, 1.3 times on 3.5. Whatever hangs still is not
//! touched, bending hardly. Twist rings 1.7 times too slowly on 1.5 cells, as that says to 2 %
//! (`tests/tests/simulator/torsion.rs`), and a stiff rope that is let go where it has buckled out of the plane unwinds too
//! slowly: of 4.3 MPa from (0.15, 0.15) it reaches 0.429 m, where the independent rod reaches 0.447 m, and 0.426 m with
//! its own inertia 2.78 times as large.
//!
//! Not mended; a way was tried on the readable twin. The excess is a constant matrix, the same for every component and
//! channel: with B the mean rates of a slice's two directors across the rope and D their excess, slice mass times h²/4,
//! (M − Bᵀ D B) v̇ = f is the node's update and a solution for two numbers per slice; what is left of M is positive. On
//! 1.5 cells twist then rings at 0.0486 s, of 0.0469 right and 0.0798 before, and the swings above reach, from 4.3, 3 and
//! 0.9 MPa, 0.451, 0.456 and 0.434 m; the rod with the same loss reaches 0.443, 0.453 and 0.444 m, and with 80 segments
//! in place of 50 the last 0.443 m. But a whole time step is unstable with it, half of one is not: it would cost twice
//! the time.
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
//! | velocities on the nodes, a loss in the stress; quiet machine | 15.5 | 15.4 | 13.8 | 12.1 | 12.1 | 51, 160, 291 |
//! | the table's spring and damper, clamps that act on particles; loaded machine | 13.2 | 13.2 | 12.7 | 11.0 | 11.5 | 43, 143, 271 |
//!
//! f64 costs 23 ns (27 at the last row but one). A tangent costs about as much as a value: the stress without its
//! polar decomposition, the same transfers. So 16 tangents cost 20 plain rollouts,
//! not 6; the aim of 6 was set for a rollout of 50 ns, and in those terms they cost 5.6.
//!
//! A swing looks at its tip in every step and for its fastest particle in every sixteenth; both read single
//! lanes from memory, not through the registers' instructions in code that was not compiled for them: an eighth
//! less time. Most of a swing's time was its settling: ropes that fall out of the plane need up to two seconds and
//! double precision to come to rest, 0.20 s of one core at 0.9 MPa. Now half a second in single precision brings the
//! rope near its rest, whose nodes are then solved for ([`rest`]): 0.09 s (`swing.rs`; both figures on a loaded machine,
//! by turns, 1.5 cells). Almost all of that half second is spent on a grid of one cell across the rope, which leaves the
//! reach where it was (48 swings on 1.5 and 1.79 cells over the range of E: at most 0.035 mm, mostly 0.002 mm).
//!
//! With that and with sums that stay in registers, 24 swings over the range of E took 131 ms of one core each instead
//! of 177 on 1.5 cells, 156 instead of 228 on the paper's 1.79; on a slow machine, a quarter of each the rest and its
//! matrices. Two such cores make 12.8 per second of the latter, before 8.8 (on a faster one 14); the aim is 25.
//!
//! Laws that change the material run in registers too (`block_material.rs`). Beside a plain rollout's 12 to 24, ns per
//! particle and step of a rope of 564 particles with one law at a twentieth of its range, against one by one (loaded
//! machine, by turns): rest curvature and bending ratio 13 against 113 to 121, internal damping 17
//! against 142; with four tangents 82 to 97 against 740 to 940. A diagnosis that refits them (a curved rope, one
//! thread) went from 120 to 28 s. Drag and wind, asked once per slice, cost 34 against 141, stiffening 31 against 142,
//! where a plain rollout cost 28 (AVX2); with four tangents 164 to 179 against 780 to 800, plain 152. Plastic flow
//! (`flow.rs`) takes the particles that flow out of their lanes: 34 against 204 where few do, 122 against 270 where
//! the rope yields at 1 %; with four tangents 196 against 1183, and 600 against 1429.
//!
//! The step follows the fastest oscillation of the grid ([`time_step::fastest_pa`]), not the P-wave's crossing time
//! of a cell: for ν = 0.2 that is 1.4 times longer, for ν = 0.45 hardly more; the loss takes a quarter of it
//! back.
//!
//! A quarter of a step was the sums at the nodes going through memory: those of three planes now stay in registers from
//! slice to slice, and those of members that meet the same nodes from member to member; the clamps' motion is spread over
//! registers where they are used. Blocks of sixteen registers are turned where they lie: copying one was a call, and a
//! step took 18.9 ns in place of 17.3 (672 particles, loaded machine, by turns).
//!
//! Ropes at rest are a system of equations ([`statics`]), whose matrix and its factor were more than half of a fit of measured
//! cables. The factor was made row by row, by products of rows that each end in a sum over a register; now tiles of sixteen
//! rows of four columns stay in registers ([`band`]): 0.4 ms in place of 1.3 for 1,701 rows in a band of 80, 2.3 in place of
//! 5.0 for 3,024 in one of 143 (AVX2 0.5 and 2.6). Particles that meet the same nodes add up their stiffness before it goes
//! to the matrix (`block.rs`). A fit to 23 poses and a swing of a cable took 97 s of one core and takes 71, a swing 145 ms
//! and 138 (by turns, quiet machine). Tiles of eight columns took a quarter to four fifths longer.
//!
//! What did not pay:
//! - *Slices where the gradient is exact.* What MLS-MPM makes of a velocity that goes with the square of s is off by
//!   (f − 4 f³) dx/2 times its second derivative, f cells from a node plane: a bent rope seems to shear. Averaged over
//!   a cell that is 16 G/E (dx/D)² · 0.0048 of the bending stiffness, 1.3 % at 1.5 cells; with two-point Gauss rules
//!   (f = ±0.29) twice as much, with Simpson's (on node planes and in the middle between them) nothing. Sag of a
//!   cantilever at 1.5 cells over three alignments, against the exact one: Gauss -4.2 to -2.6 %, twice as many slices
//!   -2.9 to -1.4 %, Simpson -1.2 to -0.1 %. The slices that are used cost a sixth less and have the clamps' stiffness
//!   chosen for them, with which the sag is as near. But thinner slices are no better ones.
//! - *The B-splines' own gradient* in place of MLS-MPM's, along and across the rope, which is exact for every velocity
//!   that goes with a square. The spurious shear above is gone, and with it what had hidden an error of the other sign:
//!   masses lumped at nodes are too slow by (k dx)²/4 of the squared frequency of a wave number k, 2.5 and 6.9 % for the
//!   first two bending modes of a free rope at 1.5 cells. Their stiffness comes out 3.1 and 6.3 % low, now 1.3 and 3.9;
//!   cantilevers sag 2 to 6 % too far (now within 1 %), which stiffer clamps would mend. Without forgetting it keeps its
//!   energy to 1e-10 per period and a held rope moves by 0.03 nm within a second, now 0.8; but then nodes that see little
//!   of the rope go astray, and an elastica of 2.1 cells misses by a fifth at two of four alignments. Masses that are
//!   not lumped were not tried.
//! - *Clamps that stiffen with the square of the cells across the rope*, so that they give by a third of a cell on every
//!   grid: on 3 cells with three rings of particles a cantilever then sags 3.0 % too little, else from 0.2 % too little to
//!   1.1 % too far.
//! - *Ending a swing early*, once the reach has not grown for 0.1 s and the rope moves back as a whole:
//!   a quarter fewer steps, but of 193 random swings some reached further later, one by 0.32 m.
//! - *Settling in single precision* with only its end in double: a fifth less time than in double, 8 of 33 swings
//!   more than 0.1 mm off, because half a second of double does not undo what single left over.
//! - *A rod* instead of the settling: most releases are out of its plane.
//!
//! The step depends on the parameters, and tangents hold it fixed. A scene can therefore fix its step
//! ([`scene::StepLength`]); differences of rollouts then mean what tangents mean.

/// Raised with every change that moves what simulations give: rollouts and fits on disk are then made anew.
pub const REVISION: u32 = 9;

pub mod adjoint;
pub mod axial;
pub mod band;
mod block;
mod block_material;
mod blocks;
pub mod clamp;
mod contact;
pub mod curve;
pub mod dual;
pub mod elastic;
mod engine;
pub mod error;
mod flow;
pub mod grid;
mod hanging;
mod in_motion;
pub mod kernel;
mod lanes;
mod laws;
pub mod legs;
pub mod material;
mod nodes;
pub mod pads;
pub mod physics;
mod props;
pub mod real;
pub mod recorded;
pub mod rest;
pub mod rollout;
pub mod rope;
pub mod scene;
pub mod softness;
pub mod start;
pub mod statics;
pub mod step;
mod stiffness;
mod sweep;
pub mod tensor;
pub mod time_step;
mod track;
mod transfer;
mod widest;

pub use dual::Dual;
pub use error::{Cause, SimError};
pub use hanging::{Hung, initial_particles};
pub use lanes::Laned;
pub use physics::Physics;
pub use real::{Arithmetic, Real};
pub use rollout::{Rollout, poses, simulate, simulate_hung};
pub use scene::Scene;
pub use track::Track;
