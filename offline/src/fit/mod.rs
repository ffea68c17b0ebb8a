//! Fitting θ to demonstrations: Levenberg-Marquardt on the offsets of [`crate::observe`] with the
//! simulator's own tangents, from several starts, with standard errors that hold the noise's part and the grid's.

mod broyden;
mod correlation;
mod cost;
mod descent;
mod in_motion;
mod kinds;
mod numerical;
mod passes;
mod problem;
mod profile;
mod push;
mod sensitivity;
mod share;
mod solver;
mod step;
mod uncertainty;

pub use correlation::Correlation;
pub use descent::{Budget, Descent, FitResult, StopReason};
pub use kinds::{flows, turns_in_grip};
pub use numerical::{FINER, grid_shift};
pub use problem::{Evaluation, FitError, Library, Problem, Resolution};
pub use profile::{LEVEL, Profile, profiles};
pub use push::{KNOTS, Pushes};
pub use share::FrameShare;
pub use solver::{FitOptions, fit, fit_and_tell, fit_from, fit_starts};
pub use step::moved;
pub use uncertainty::{STIFFNESS_ACCURACY, YOUNG, covariance, estimates, estimates_within, shift_by, tells};
