//! Closing the loop: score every effect of the library on the residual from one pass of tangents,
//! refit the best in full, accept one only where it passes every gate, repeat, and give a verdict. Where none passes
//! alone, the best pairs and triples of the scores are refitted, because two causes can hide each other. Where something
//! is left in the end, the loop begins again with what passed second. What explains must be the same in every part of what
//! was fitted (`score/invariance.rs`); that is asked of the final model alone, because a cause beside which another is
//! still missing need not be.
//!
//! The statistics follow the score test for freeing a fixed parameter (Rao 1948; modification index
//! and expected parameter change in structural equation modelling, Saris et al. 2009). Significance
//! is calibrated by pseudo-data: the difference between the model on two grids, scaled up to the
//! error that is left, plus noise. So discretisation cannot pass for physics.
//!
//! Every model predicts as a finer grid does (`bench.rs`): near a model in hand by the fit's own grid and the difference of
//! the two there, and once a model is found it is followed to where that difference, taken anew, has it. What is accepted has
//! the same size on both grids, or on the finer one and one finer still (`refinement.rs`).

/// Goes up with every change of what is measured, fitted or concluded: answers on disk are then made anew.
pub const REVISION: u32 = 26;

mod accounted;
mod added;
mod again;
mod against;
mod batch;
mod bench;
mod choice;
mod conclude;
mod force;
mod gates;
mod leaner;
mod memory;
mod next;
mod noise;
mod refinement;
mod refits;
mod revise;
mod rivals;
mod round;
mod rounds;
mod score;
mod starts;
mod verdict;
mod ways;

pub use bench::{problems, problems_at};
pub use force::terms::{STABLE, TermShare};
pub use force::{DemoForce, ResidualForce, residual_force};
pub use gates::Gate;
pub use memory::{KeptModel, Memory};
pub use next::swing_risk::{Allowed, SwingRisk, SwingRisks, Unseen};
pub use next::{
    Advice, MotionProspect, NextDemonstration, Question, advise, proposed_demo, separating, still_alike,
};
pub use noise::{LEAST_NOISE_SCALE, Noise, NoiseSource};
pub use round::{Refit, Round};
pub use rounds::{BaseFit, LoopOptions, Outcome, Part, base_scores, close_loop, fit_only, resume_loop};
pub use score::{Invariance, PartValue, Score, ScoreTable, Subset, Untested};
pub use verdict::{ReasonCode, Verdict, size_in_words};
