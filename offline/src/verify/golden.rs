//! One scene whose result is written down: a lift in double precision, off a table, with friction.
//!
//! The hash is that of [`simulate_one_by_one`], the readable twin, in `f64`. What makes its bits the same
//! on every machine: it uses only additions, products, quotients and square roots, which IEEE 754 rounds
//! exactly; Rust neither reorders nor fuses them; and the section's sines and the settling's exponential
//! come from the crate `libm`. The fast path chooses its registers when it runs, fuses multiply-add and
//! adds in an order that depends on their width, so its bits depend on the processor: it has no golden
//! hash, only a tolerance against the same centreline.
//!
//! A change of the simulator that means to change results changes the numbers below; one that means to
//! be faster only, and reorders sums, changes the hash but not the centreline.

use super::case::{Case, Of};
use super::setup::{DIAMETER_M, SOFT_PA, elastic, knot, rope, scene, start_grip};
use super::{Extent, Findings};
use crate::run_files::Fnv64;
use crate::sim::clamp::ClampPath;
use crate::sim::rollout::simulate_one_by_one;
use crate::sim::scene::Scene;
use crate::sim::tensor::value3;
use crate::sim::{Real, Rollout, SimError, simulate};

const FAMILY: Of = Of("golden");
/// Rounding of two thousand steps, in metres.
const REORDERED_M: f64 = 1e-9;

/// End of the golden lift, s.
const END_S: f64 = 0.2;
/// FNV-1a of the bits of the whole centreline at the end.
const HASH: u64 = 0x6719_1f53_dfeb_6d17;
/// Centre of the last slice at the end, m.
const LAST_M: [f64; 3] = [
    0.132_408_731_860_498_79,
    0.033_653_812_948_767_78,
    0.024_471_012_014_107_733,
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
    let (scene, physics) = (lift(END_S)?, elastic(SOFT_PA));
    let rollout = simulate_one_by_one(&scene, &physics)?;
    let hash = bits(&rollout);
    let last = |rollout: &Rollout<f64>| rollout.frames[0][rollout.arc_m.len() - 1];
    let off = |rollout: &Rollout<f64>| {
        let squares = (0..3).map(|k| (last(rollout)[k] - LAST_M[k]).powi(2));
        squares.sum::<f64>().sqrt()
    };
    let fast = off(&simulate(&scene, &physics)?);
    Ok(vec![
        FAMILY.absolute(
            format!("last slice of a lift at {:?}, off", last(&rollout)),
            "m",
            [0.0, off(&rollout)],
            REORDERED_M,
        ),
        FAMILY.absolute("the same in registers, off", "m", [0.0, fast], REORDERED_M),
        FAMILY.holds(
            format!("hash of a lift, {hash:#018x}, as written down"),
            hash == HASH,
        ),
    ])
}
