//! One scene whose result is written down: a lift in double precision, off a table, with friction.
//!
//! What makes its bits the same on every machine: the path in `f64` uses only additions, products,
//! quotients and square roots, which IEEE 754 rounds exactly; Rust neither reorders nor fuses them; the
//! section's sines and the settling's exponential come from the crate `libm`; and registers of any
//! width add the same numbers in the same order, so the build for AVX2 gives the bits of the portable
//! one. A path that fuses multiply-add, or adds in an order that depends on the processor, would not; so
//! the fast path in `f32` has no golden hash, only a tolerance against this one.
//!
//! A change of the simulator that means to change results changes the numbers below; one that means to
//! be faster only, and reorders sums, changes the hash but not the centreline.

use super::case::{Case, Of};
use super::setup::{DIAMETER_M, SOFT_PA, elastic, knot, rope, scene, start_grip};
use super::{Extent, Findings};
use crate::run_files::Fnv64;
use crate::sim::clamp::ClampPath;
use crate::sim::scene::Scene;
use crate::sim::tensor::value3;
use crate::sim::{Real, Rollout, SimError, simulate};

const FAMILY: Of = Of("golden");
/// Rounding of two thousand steps, in metres.
const REORDERED_M: f64 = 1e-9;

/// End of the golden lift, s.
const END_S: f64 = 0.2;
/// FNV-1a of the bits of the whole centreline at the end.
const HASH: u64 = 0x8b8f_3cd9_40c8_e95c;
/// Centre of the last slice at the end, m.
const LAST_M: [f64; 3] = [
    0.130_374_995_470_853_07,
    0.033_651_020_405_460_56,
    0.026_382_860_539_852_115,
];

/// The first end of a short rope on a table is lifted to the side.
pub(super) fn lift(end_s: f64) -> Result<Scene, SimError> {
    let path = ClampPath::new(vec![
        knot(0.0, [0.0; 3], [0.0; 3], true),
        knot(0.25, [0.02, 0.03, 0.06], [0.0; 3], true),
    ]);
    let grips = start_grip(0.02, path);
    scene(
        rope(0.12, DIAMETER_M),
        [1.0, 0.0, 0.0],
        grips,
        Some(-0.5 * DIAMETER_M),
        1.5,
        end_s,
    )
}

/// Hash of all recorded points.
pub(super) fn bits<T: Real>(rollout: &Rollout<T>) -> u64 {
    let mut hash = Fnv64::default();
    for point in rollout.frames.iter().flatten() {
        for x in value3(*point) {
            hash.add(&x.to_bits().to_le_bytes());
        }
    }
    hash.value()
}

pub(super) fn verify(_extent: Extent) -> Findings {
    FAMILY.each("golden lift", golden()).into()
}

fn golden() -> Result<Vec<Case>, SimError> {
    let rollout = simulate(&lift(END_S)?, &elastic(SOFT_PA))?;
    let frame = &rollout.frames[0];
    let last = frame[frame.len() - 1];
    let off = (0..3).map(|k| (last[k] - LAST_M[k]).powi(2)).sum::<f64>().sqrt();
    let hash = bits(&rollout);
    Ok(vec![
        FAMILY.absolute(
            format!("last slice of a lift at {last:?}, off"),
            "m",
            [0.0, off],
            REORDERED_M,
        ),
        FAMILY.holds(
            format!("hash of a lift, {hash:#018x}, as written down"),
            hash == HASH,
        ),
    ])
}
