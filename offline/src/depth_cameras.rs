//! What two depth cameras see of a round rope whose centreline is known: clouds for data whose truth is known.

use crate::collect::{standard_normal, stream};
use crate::demo::CameraSpec;
use crate::observe::{dot, normals};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Where the two cameras stand: in front to the left and to the right, looking down at the lift.
const CAMERAS_M: [[f64; 3]; 2] = [[0.57, 0.42, 0.48], [0.57, -0.42, 0.48]];
const NAMES: [&str; 2] = ["front-left", "front-right"];
/// What both look at, m.
const LOOKED_AT_M: [f64; 3] = [0.12, 0.0, 0.08];

/// The two cameras as a demonstration declares them.
pub fn cameras() -> Vec<CameraSpec> {
    let camera = |k: usize| CameraSpec::looking_at(NAMES[k], CAMERAS_M[k], LOOKED_AT_M);
    [0, 1].map(camera).into()
}

/// What the two do to distances, and how much of their images is kept.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthSensor {
    /// Standard deviation of the distance along the ray, m.
    pub noise_m: f64,
    /// Step in which distances are told, m; 0: as they are.
    pub quantum_m: f64,
    /// Points that both together keep of a frame.
    pub points: usize,
}

impl DepthSensor {
    /// Clouds of a rope of `radius_m` around each of `lines_m`: points of the rope's side that face a camera. The rope is
    /// round, one piece's frame is that of its chord; one part of the rope hiding another is not modelled, and does not
    /// happen in a lift.
    pub fn clouds(&self, lines_m: &[Vec<[f64; 3]>], radius_m: f64, seed: u64) -> Vec<Vec<[f64; 3]>> {
        let mut rng = stream(seed, 0);
        lines_m
            .iter()
            .map(|line| self.cloud(line, radius_m, &mut rng))
            .collect()
    }

    fn cloud(&self, line: &[[f64; 3]], radius_m: f64, rng: &mut ChaCha8Rng) -> Vec<[f64; 3]> {
        let mut points = Vec::with_capacity(self.points);
        while points.len() < self.points {
            let camera = CAMERAS_M[points.len() % 2];
            let (point, normal) = surface_point(line, radius_m, rng);
            let ray: [f64; 3] = std::array::from_fn(|k| point[k] - camera[k]);
            let range_m = dot(ray, ray).sqrt();
            // Visible area shrinks with the angle between ray and normal; so do pixels.
            if rng.random::<f64>() < -dot(ray, normal) / range_m {
                let error = self.error_m(range_m, rng) / range_m;
                points.push(std::array::from_fn(|k| point[k] + error * ray[k]));
            }
        }
        points
    }

    /// By how much a distance is told too large, m.
    fn error_m(&self, range_m: f64, rng: &mut ChaCha8Rng) -> f64 {
        let noise_m = self.noise_m * standard_normal(rng);
        if self.quantum_m == 0.0 {
            return noise_m;
        }
        ((range_m + noise_m) / self.quantum_m).round() * self.quantum_m - range_m
    }
}

/// A random point of the side of a tube around `line`, and its outward normal.
fn surface_point(line: &[[f64; 3]], radius_m: f64, rng: &mut ChaCha8Rng) -> ([f64; 3], [f64; 3]) {
    let along = rng.random::<f64>() * (line.len() - 1) as f64;
    let low = (along as usize).min(line.len() - 2);
    let share = along - low as f64;
    let (a, b) = (line[low], line[low + 1]);
    let chord: [f64; 3] = std::array::from_fn(|k| b[k] - a[k]);
    let length = dot(chord, chord).sqrt();
    let [up, across] = normals(chord.map(|c| c / length));
    let (sin, cos) = libm::sincos(std::f64::consts::TAU * rng.random::<f64>());
    let normal = std::array::from_fn(|k| cos * up[k] + sin * across[k]);
    let point = std::array::from_fn(|k| a[k] + share * chord[k] + radius_m * normal[k]);
    (point, normal)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points lie on the tube, off along the rays only, on sides that face a camera.
    #[test]
    fn cameras_see_the_sides_that_face_them_and_err_along_their_rays() {
        const RADIUS_M: f64 = 0.007;
        for ends in [
            [[0.0, 0.0, 0.1], [0.2, 0.0, 0.1]],
            [[0.1, -0.1, 0.1], [0.1, 0.1, 0.13]],
        ] {
            let lines = vec![ends.to_vec()];
            let sensor = |noise_m: f64, quantum_m: f64| {
                let sensor = DepthSensor {
                    noise_m,
                    quantum_m,
                    points: 400,
                };
                sensor.clouds(&lines, RADIUS_M, 3).remove(0)
            };
            let [up, across] = normals({
                let chord: [f64; 3] = std::array::from_fn(|k| ends[1][k] - ends[0][k]);
                chord.map(|c| c / dot(chord, chord).sqrt())
            });
            for (index, (clean, stepped)) in sensor(0.0, 0.0).iter().zip(&sensor(0.0, 0.001)).enumerate() {
                let from: [f64; 3] = std::array::from_fn(|k| clean[k] - ends[0][k]);
                let off = [dot(from, across), dot(from, up)];
                assert!((off[0].hypot(off[1]) - RADIUS_M).abs() < 1e-12, "{off:?}");
                let camera = CAMERAS_M[index % 2];
                let range = |p: &[f64; 3]| (0..3).map(|k| (p[k] - camera[k]).powi(2)).sum::<f64>().sqrt();
                let facing: f64 = (0..3)
                    .map(|k| (camera[k] - clean[k]) * (off[0] * across[k] + off[1] * up[k]))
                    .sum();
                assert!(facing > 0.0);
                let told = range(stepped) / 0.001;
                assert!(
                    (told - told.round()).abs() < 1e-6 && (range(stepped) - range(clean)).abs() < 0.00051
                );
            }
        }
    }
}
