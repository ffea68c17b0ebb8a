//! The simulator, its derivatives and its effects, in one program: what is generic in the number type is compiled once for
//! all of them, which takes minutes less than a program for each.

mod cable;
mod effect_physics;
mod effects;
mod examples;
mod gradients;
mod hanging;
mod lanes;
mod rounding;
mod statics;
mod swing;
mod tangents;
mod torsion;
mod verification;
