//! Why a simulation refused to start or stopped: always typed, never a repair, never silence.
//!
//! Nothing can leave the grid, because the grid belongs to the material ([`super::grid`]); what runs
//! away in space is stopped as too fast or as not finite. `offline verify` produces the causes that stop a rollout; what
//! refuses a pose at rest or a gradient has tests of its own.

use thiserror::Error;

/// The reason for a stop.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum Cause {
    /// The material turned inside out.
    #[error(
        "particle {particle} is inverted (det F = {det:.3}): the rope is strained too much; make it stiffer or lighter, move it more slowly, or lower an effect that bends or weakens it (rest curvature, yield, bending ratio)"
    )]
    Inverted {
        /// Index of the particle.
        particle: usize,
        /// Determinant of its deformation gradient.
        det: f64,
    },
    /// A value is NaN or infinite.
    #[error(
        "particle {particle} is not finite: the run is unstable: an effect may be too strong, or a clamp's path jump"
    )]
    NonFinite {
        /// Index of the particle.
        particle: usize,
    },
    /// A particle moved further than half a cell in one step: the CFL condition is violated.
    #[error(
        "particle {particle} moves at {speed_m_s:.1} m/s, more than half a cell per step (CFL): lower the gripper's speed or the time of free fall, and look for jumps in a clamp's path and its times"
    )]
    TooFast {
        /// Index of the particle.
        particle: usize,
        /// Its speed, m/s.
        speed_m_s: f64,
    },
    /// The rope is too thin for the grid.
    #[error("the rope is {cells:.2} cells thick, at least 1.5 are needed: choose a finer grid spacing")]
    TooThin {
        /// Diameter over grid spacing.
        cells: f64,
    },
    /// The clamps are further apart than the rope is long.
    #[error(
        "the grips are {distance_m:.3} m apart at t = {t_s:.2} s, the rope between them is {length_m:.3} m long: unreachable"
    )]
    Unreachable {
        /// Time of the largest distance, s.
        t_s: f64,
        /// Distance of the clamps, m.
        distance_m: f64,
        /// Free length of rope between them, m.
        length_m: f64,
    },
    /// The rope at rest is bent too much to be held straight.
    #[error(
        "at rest the inner side of the bent rope has {volume:.2} of its volume, which nothing straightens: less rest curvature, or a thinner rope"
    )]
    BentAtRest {
        /// Least volume of a piece of its shape at rest over the undeformed one.
        volume: f64,
    },
    /// The weight of a rope held at both ends, one above the other, would compress it to nothing.
    #[error(
        "the rope is too soft to stand between its grips: its weight would shorten its lower half by {strain:.1} times its length; give a larger young_pa, or a shorter or lighter rope"
    )]
    Collapses {
        /// Compressive strain of linear elasticity at the lower grip.
        strain: f64,
    },
    /// A fixed time step is not stable.
    #[error("a time step of {dt_s:.2e} s is not stable here: choose one of at most {longest_s:.2e} s")]
    StepTooLong {
        /// The step, s.
        dt_s: f64,
        /// The longest that is stable, s.
        longest_s: f64,
    },
    /// Newton's method found no pose at rest.
    #[error(
        "no pose at rest was found, the last step moved the rope by {moved_m:.1e} m: it may be too soft or buckle"
    )]
    NoRest {
        /// Size of the last step, m.
        moved_m: f64,
    },
    /// A gradient was asked for where the start depends on the parameters.
    #[error("gradients in reverse need a rope that starts straight: take tangents")]
    HangsAtStart,
    /// A pose at rest was asked of a rope that yields in it.
    #[error(
        "at rest the rope yields at particle {particle}, so where it hangs depends on how it got there: leave out the yield effect, or let the demonstration start from a straight rope"
    )]
    YieldsAtRest {
        /// The particle.
        particle: usize,
    },
    /// The rope would rest on the table, which poses at rest do not know.
    #[error("the rope at rest reaches down to z = {lowest_m:.3} m and would lie on the table")]
    RestsOnTable {
        /// Height of its lowest point, m.
        lowest_m: f64,
    },
    /// A gradient does not fit into the memory that it may use.
    #[error(
        "the gradient needs {needed_bytes} bytes, {budget_bytes} are allowed: allow more or shorten the rollout"
    )]
    Memory {
        /// The least that would do.
        needed_bytes: usize,
        /// What was allowed.
        budget_bytes: usize,
    },
    /// The rollout would not end within reason.
    #[error(
        "{steps:.1e} steps of {particles} particles are too much: choose a coarser grid, a shorter time, or less stiffness or internal damping, which shorten the step"
    )]
    TooLong {
        /// Steps from start to end.
        steps: f64,
        /// Particles.
        particles: usize,
    },
    /// Reverse mode does not know a law.
    #[error("a law changes the material or what is seen, which reverse mode cannot undo: use tangents")]
    OneWay,
    /// A parameter is outside its physical range.
    #[error("{name} = {value} is outside its range: mend it where it comes from")]
    BadParameter {
        /// Name of the parameter.
        name: &'static str,
        /// Its value.
        value: f64,
    },
}

/// A stop at a step.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[error("simulation stopped at step {step} (t = {t_s:.4} s): {cause}")]
pub struct SimError {
    /// Step number; 0 before the first.
    pub step: usize,
    /// Simulated time, s.
    pub t_s: f64,
    /// The reason.
    pub cause: Cause,
}

impl SimError {
    /// A refusal before the first step.
    pub fn at_start(cause: Cause) -> Self {
        Self::of_pose(0.0, cause)
    }

    /// A rest state that was not found, or is refused, with the clamps as they are at a time.
    pub fn of_pose(t_s: f64, cause: Cause) -> Self {
        Self { step: 0, t_s, cause }
    }
}
