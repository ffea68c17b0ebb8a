//! Depth cameras: cast a ray through every pixel, find the rope, add a sensor's noise, project back.

use nalgebra::{Quaternion, Rotation3, UnitQuaternion, Vector3};
use offline::demo::CameraSpec;
use rand::{Rng, RngExt};
use rand_chacha::ChaCha8Rng;

/// What a depth camera does to a distance, and how much of an image is kept.
#[derive(Clone, Copy, Debug)]
pub struct SensorSpec {
    /// Standard deviation of the distance along the ray, m.
    pub noise_m: f64,
    /// Step of the depth value, m.
    pub quantum_m: f64,
    /// Share of the pixels without a depth.
    pub dropout: f64,
    /// Most points kept in a frame, drawn at random from all cameras' pixels.
    pub most_points: usize,
}

/// A pixel that saw the rope.
#[derive(Clone, Copy, Debug)]
pub struct Hit {
    /// Direction of the pixel's ray in the world, unit length.
    pub ray: Vector3<f64>,
    /// Direction in which the camera looks, unit length.
    pub forward: Vector3<f64>,
    /// Distance from the camera along the ray, m.
    pub range_m: f64,
}

/// What one camera sees of a rope with the axis `nodes` and the given radius, nearest surface first:
/// a round bar along each segment, balls at the joints, flat faces at both ends.
pub fn render(
    camera: &CameraSpec,
    true_position: Vector3<f64>,
    nodes: &[Vector3<f64>],
    radius: f64,
) -> Vec<Hit> {
    let lens = Lens::new(camera, true_position);
    let mut image = vec![f64::INFINITY; (camera.width_px * camera.height_px) as usize];
    for j in 0..nodes.len() - 1 {
        let bar = Bar {
            from: nodes[j],
            to: nodes[j + 1],
            radius,
            closed_from: j == 0,
            closed_to: j + 2 == nodes.len(),
        };
        let Some((columns, rows)) = lens.window(&bar) else {
            continue;
        };
        for row in rows {
            for column in columns.clone() {
                let pixel = &mut image[(row * camera.width_px + column) as usize];
                *pixel = pixel.min(bar.range(&lens.position, &lens.ray(column, row)));
            }
        }
    }
    let seen = image.iter().enumerate().filter(|(_, range)| range.is_finite());
    seen.map(|(index, range_m)| Hit {
        ray: lens.ray(index as u32 % camera.width_px, index as u32 / camera.width_px),
        forward: lens.forward(),
        range_m: *range_m,
    })
    .collect()
}

/// A camera as geometry.
struct Lens<'a> {
    camera: &'a CameraSpec,
    position: Vector3<f64>,
    turn: Rotation3<f64>,
}

impl<'a> Lens<'a> {
    fn new(camera: &'a CameraSpec, position: Vector3<f64>) -> Self {
        let [x, y, z, w] = camera.quaternion_xyzw;
        let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        Self {
            camera,
            position,
            turn: turn.to_rotation_matrix(),
        }
    }

    fn forward(&self) -> Vector3<f64> {
        self.turn * Vector3::z()
    }

    fn ray(&self, column: u32, row: u32) -> Vector3<f64> {
        let [fx, fy] = self.camera.focal_px;
        let [cx, cy] = self.camera.centre_px;
        let optical = Vector3::new((f64::from(column) - cx) / fx, (f64::from(row) - cy) / fy, 1.0);
        self.turn * optical.normalize()
    }

    /// Pixels that may see the bar; none where it is behind the camera or outside the image.
    fn window(&self, bar: &Bar) -> Option<(std::ops::Range<u32>, std::ops::Range<u32>)> {
        let ends = [bar.from, bar.to].map(|p| self.turn.inverse() * (p - self.position));
        let nearest = ends[0].z.min(ends[1].z) - bar.radius;
        if nearest <= 0.0 {
            return None;
        }
        let span = |axis: usize, size: u32| {
            let focal = self.camera.focal_px[axis];
            let centre = self.camera.centre_px[axis];
            let at = ends.map(|p| focal * p[axis] / p.z + centre);
            let margin = focal * bar.radius / nearest + 2.0;
            let low = (at[0].min(at[1]) - margin).max(0.0) as u32;
            let high = (at[0].max(at[1]) + margin).clamp(0.0, f64::from(size)) as u32;
            (low < high).then_some(low..high)
        };
        Some((span(0, self.camera.width_px)?, span(1, self.camera.height_px)?))
    }
}

/// A piece of the rope's surface.
struct Bar {
    from: Vector3<f64>,
    to: Vector3<f64>,
    radius: f64,
    closed_from: bool,
    closed_to: bool,
}

impl Bar {
    /// Distance from `origin` along `ray` to the surface; infinite where the ray misses.
    fn range(&self, origin: &Vector3<f64>, ray: &Vector3<f64>) -> f64 {
        let along = self.to - self.from;
        let length = along.norm();
        let axis = along / length;
        let mut best = self.side(origin, ray, &axis, length);
        for (end, closed) in [(&self.from, self.closed_from), (&self.to, self.closed_to)] {
            let hit = if closed {
                self.face(origin, ray, end, &axis)
            } else {
                self.ball(origin, ray, end)
            };
            best = best.min(hit);
        }
        best
    }

    fn side(&self, origin: &Vector3<f64>, ray: &Vector3<f64>, axis: &Vector3<f64>, length: f64) -> f64 {
        let from = origin - self.from;
        let across_ray = ray - axis * ray.dot(axis);
        let across_from = from - axis * from.dot(axis);
        let range = first_root(&across_ray, &across_from, self.radius);
        let height = (from + ray * range).dot(axis);
        // An infinite range makes the height NaN or infinite, which is not contained either.
        if (0.0..=length).contains(&height) {
            range
        } else {
            f64::INFINITY
        }
    }

    fn ball(&self, origin: &Vector3<f64>, ray: &Vector3<f64>, centre: &Vector3<f64>) -> f64 {
        first_root(ray, &(origin - centre), self.radius)
    }

    fn face(
        &self,
        origin: &Vector3<f64>,
        ray: &Vector3<f64>,
        centre: &Vector3<f64>,
        axis: &Vector3<f64>,
    ) -> f64 {
        let range = (centre - origin).dot(axis) / ray.dot(axis);
        let inside = (origin + ray * range - centre).norm() <= self.radius;
        if range > 0.0 && inside {
            range
        } else {
            f64::INFINITY
        }
    }
}

/// Smallest positive t with |from + t ray| = radius, else infinity.
fn first_root(ray: &Vector3<f64>, from: &Vector3<f64>, radius: f64) -> f64 {
    let a = ray.norm_squared();
    let b = ray.dot(from);
    let c = from.norm_squared() - radius * radius;
    let discriminant = b * b - a * c;
    if discriminant < 0.0 {
        return f64::INFINITY;
    }
    let t = (-b - discriminant.sqrt()) / a;
    if t > 0.0 { t } else { f64::INFINITY }
}

/// The points that the cameras report of one instant, rounded to the single precision of the files.
///
/// `first_offset_m` is the error in the first camera's declared position: it stands there, but its
/// points are projected back from the declared place.
pub fn observe(
    cameras: &[CameraSpec],
    first_offset_m: [f64; 3],
    nodes: &[Vector3<f64>],
    radius: f64,
    sensor: &SensorSpec,
    random: &mut ChaCha8Rng,
) -> Vec<[f64; 3]> {
    let mut points = Vec::new();
    for (index, camera) in cameras.iter().enumerate() {
        let declared = Vector3::from(camera.position_m);
        let offset = if index == 0 {
            Vector3::from(first_offset_m)
        } else {
            Vector3::zeros()
        };
        for hit in render(camera, declared + offset, nodes, radius) {
            let range = hit.range_m + sensor.noise_m * standard_normal(random);
            if random.random::<f64>() < sensor.dropout {
                continue;
            }
            let steepness = hit.ray.dot(&hit.forward);
            let depth = (range * steepness / sensor.quantum_m).round() * sensor.quantum_m;
            let point = declared + hit.ray * (depth / steepness);
            points.push([point.x, point.y, point.z].map(|x| f64::from(x as f32)));
        }
    }
    keep_some(points, sensor.most_points, random)
}

/// A random choice of `most` points in their original order.
fn keep_some(points: Vec<[f64; 3]>, most: usize, random: &mut ChaCha8Rng) -> Vec<[f64; 3]> {
    let mut wanted = most.min(points.len());
    let mut left = points.len();
    let mut kept = Vec::with_capacity(wanted);
    for point in points {
        // Selection sampling (Knuth, The Art of Computer Programming 2, algorithm 3.4.2 S).
        if random.random::<f64>() * (left as f64) < wanted as f64 {
            kept.push(point);
            wanted -= 1;
        }
        left -= 1;
    }
    kept
}

/// Box and Muller (1958).
fn standard_normal(random: &mut impl Rng) -> f64 {
    let radius = (-2.0 * (1.0 - random.random::<f64>()).ln()).sqrt();
    radius * (std::f64::consts::TAU * random.random::<f64>()).cos()
}
