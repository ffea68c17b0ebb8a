//! Moves a gripper so that the tip of the rope that hangs from it passes through a point: a hundred
//! knots of a path, and their gradient in one way back per coordinate of the tip.
//!
//! Each round simulates, asks how the tip at the given time changes with every knot, and changes the
//! path by the least (in the sum of squares of the gripper's velocity) that takes the tip there.
//!
//! ```sh
//! cargo run --release -p offline --no-default-features --example aim_gripper
//! ```

use offline::demo::RopeEnd;
use offline::sim::adjoint::{Cotangent, DEFAULT_BUDGET_BYTES, Family, differentiate, sample_gradient};
use offline::sim::clamp::ClampPath;
use offline::sim::rope::RopeShape;
use offline::sim::scene::{Grip, Scene};
use offline::sim::{Physics, Real, SimError};

const KNOTS: usize = 100;
const DURATION_S: f64 = 0.4;
/// Where the tip shall be at the end, (x, z) in m; it hangs at (0, −0.12) at the start.
const TARGET_M: [f64; 2] = [0.10, -0.08];
const ROUNDS: usize = 7;

/// A soft rope without any unknown.
struct Rope;

impl Family for Rope {
    fn physics<T: Real>(&self, _theta: &[T]) -> Physics<T> {
        Physics::base(T::of(0.4e6), T::of(0.3), T::of(0.5))
    }
}

/// The rope hangs from a gripper that goes through these points, (x, z) in m.
fn scene(path_m: &[[f64; 2]]) -> Result<Scene, SimError> {
    let rope = RopeShape::of_density(0.12, 0.014, 1000.0);
    let samples: Vec<_> = path_m
        .iter()
        .enumerate()
        .map(|(k, &[x, z])| {
            let t_s = DURATION_S * k as f64 / (KNOTS - 1) as f64;
            (t_s, [x, 0.0, z, 0.0, 0.0, 0.0, 1.0], true)
        })
        .collect();
    let grips = vec![Grip {
        end: RopeEnd::Start,
        length_m: 0.02,
        path: ClampPath::from_samples(&samples),
    }];
    Scene::new(
        rope,
        [0.0; 3],
        [0.0, 0.0, -1.0],
        grips,
        None,
        1.5,
        vec![DURATION_S],
    )
}

/// The tip's coordinate along `axis` at the end, and its derivative with respect to the points of the
/// path along x and z.
fn tip(scene: &Scene, axis: usize) -> Result<(f64, Vec<[f64; 2]>), SimError> {
    let result = differentiate::<f32, _>(scene, &Rope, &[], DEFAULT_BUDGET_BYTES, |rollout| {
        let mut frame = vec![[0.0; 3]; rollout.frames[0].len()];
        if let Some(last) = frame.last_mut() {
            last[axis] = 1.0;
        }
        Cotangent {
            frames: vec![frame],
            reach: 0.0,
        }
    })?;
    let points = &result.rollout.frames[0];
    let place = f64::from(points[points.len() - 1][axis]);
    let gradient = sample_gradient(&scene.grips[0].path, &result.gradient.paths[0]);
    Ok((place, gradient.into_iter().map(|g| [g[0], g[2]]).collect()))
}

/// The same derivative with respect to the velocity between points: it moves all points that follow.
fn by_velocity(by_point: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let mut sum = [0.0; 2];
    let mut list: Vec<[f64; 2]> = by_point[1..]
        .iter()
        .rev()
        .map(|g| {
            sum = [sum[0] + g[0], sum[1] + g[1]];
            sum
        })
        .collect();
    list.reverse();
    list
}

fn inner(a: &[[f64; 2]], b: &[[f64; 2]]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a[0] * b[0] + a[1] * b[1]).sum()
}

/// Prints how the miss shrinks.
pub fn main() -> Result<(), SimError> {
    aim().map(|_| ())
}

/// By how much the tip misses in the end, m.
pub fn aim() -> Result<f64, SimError> {
    let mut path_m = vec![[0.0; 2]; KNOTS];
    let mut miss_m = f64::INFINITY;
    for round in 0..ROUNDS {
        let scene = scene(&path_m)?;
        let ((x, by_x), (z, by_z)) = (tip(&scene, 0)?, tip(&scene, 2)?);
        let (u, v) = (by_velocity(&by_x), by_velocity(&by_z));
        let (off_x, off_z) = (TARGET_M[0] - x, TARGET_M[1] - z);
        miss_m = f64::hypot(off_x, off_z);
        let end = path_m[KNOTS - 1];
        println!(
            "round {round}: tip at ({x:.4}, {z:.4}) m, misses by {:.3} mm; gripper ends at ({:.3}, {:.3}) m",
            1e3 * miss_m,
            end[0],
            end[1]
        );
        // The least change Jᵀ w with J Jᵀ w = what is missing.
        let (xx, xz, zz) = (inner(&u, &u), inner(&u, &v), inner(&v, &v));
        let det = xx * zz - xz * xz;
        let w = [(zz * off_x - xz * off_z) / det, (xx * off_z - xz * off_x) / det];
        let mut moved = [0.0; 2];
        for (k, point) in path_m.iter_mut().enumerate().skip(1) {
            for c in 0..2 {
                moved[c] += w[0] * u[k - 1][c] + w[1] * v[k - 1][c];
                point[c] += moved[c];
            }
        }
    }
    Ok(miss_m)
}
