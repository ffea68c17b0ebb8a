//! Fitting θ to demonstrations: Levenberg-Marquardt on the offsets of [`crate::observe`] with the
//! simulator's own tangents, from several starts, with standard errors.

mod problem;
mod sensitivity;
mod solver;
mod uncertainty;

pub use problem::{Evaluation, FitError, FrameShare, Problem, Resolution};
pub use solver::{FitOptions, FitResult, StopReason, fit, fit_from, fit_starts};
pub use uncertainty::{Correlation, covariance, estimates, estimates_within, shift_by};
