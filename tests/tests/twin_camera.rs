//! The simulated depth cameras: what they see lies on the rope, facing them, with the stated noise.

use nalgebra::Vector3;
use offline::demo::CameraSpec;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use tests::camera::{SensorSpec, observe, render};
use tests::effects::WorldEffects;
use tests::sample_rope::{shipped_specs, two_cameras};
use tests::world::{TruthFrame, simulate};

const RADIUS: f64 = 0.007;

fn truth() -> Vec<TruthFrame> {
    let (spec, _) = shipped_specs().remove(2);
    simulate(&spec, &WorldEffects::default())
}

/// Distance of a point from a chain of straight pieces, m.
fn distance(point: &Vector3<f64>, nodes: &[Vector3<f64>]) -> f64 {
    let to_piece = |pair: &[Vector3<f64>]| {
        let along = pair[1] - pair[0];
        let share = ((point - pair[0]).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
        (point - pair[0] - along * share).norm()
    };
    nodes.windows(2).map(to_piece).fold(f64::INFINITY, f64::min)
}

/// Every hit lies on the surface (or on an end's flat face, nearer to the axis), and none at its back. At the ends,
/// where a ray that meets the face may have come from over the axis, only the first is asked.
#[test]
fn hits_lie_on_the_visible_surface() {
    let frames = truth();
    for frame in frames.iter().step_by(20) {
        for camera in two_cameras() {
            let position = Vector3::from(camera.position_m);
            let hits = render(&camera, position, &frame.nodes_m, RADIUS);
            assert!(hits.len() > 300, "only {} pixels see the rope", hits.len());
            let mut on_faces = 0;
            for hit in &hits {
                let point = position + hit.ray * hit.range_m;
                let off = distance(&point, &frame.nodes_m) - RADIUS;
                let ends = [frame.nodes_m.first(), frame.nodes_m.last()];
                let at_end = ends
                    .into_iter()
                    .flatten()
                    .any(|end| (point - end).norm() < 1.5 * RADIUS);
                assert!(off < 1e-4, "{off} m above the surface");
                on_faces += usize::from(off < -1e-4);
                // A little nearer to the camera there is no rope any more.
                let before = distance(&(position + hit.ray * (hit.range_m - 1e-3)), &frame.nodes_m);
                assert!(at_end || before > RADIUS, "the ray has entered the rope before");
            }
            assert!(
                10 * on_faces < hits.len(),
                "{on_faces} of {} hits lie inside",
                hits.len()
            );
        }
    }
}

#[test]
fn a_nearer_rope_hides_a_farther_one() {
    let camera = CameraSpec::looking_at("above", [0.0, -0.001, 1.0], [0.0, 0.0, 0.0]);
    let position = Vector3::from(camera.position_m);
    // A loop that crosses over itself: the second strand is 0.1 m above the first.
    let at = |x: f64, y: f64, z: f64| Vector3::new(x, y, z);
    let nodes = [
        at(-0.1, 0.0, 0.0),
        at(0.1, 0.0, 0.0),
        at(0.1, 0.1, 0.1),
        at(0.0, 0.1, 0.1),
        at(0.0, -0.1, 0.1),
    ];
    for hit in render(&camera, position, &nodes, RADIUS) {
        let point = position + hit.ray * hit.range_m;
        if point.x.abs() < 0.5 * RADIUS && point.y.abs() < 0.5 * RADIUS {
            assert!(point.z > 0.1, "the upper strand hides {point:?}");
        }
    }
}

#[test]
fn the_cameras_see_the_whole_rope_in_every_frame() {
    for frame in truth() {
        for camera in two_cameras() {
            let position = Vector3::from(camera.position_m);
            let hits = render(&camera, position, &frame.nodes_m, RADIUS);
            let points: Vec<_> = hits.iter().map(|hit| position + hit.ray * hit.range_m).collect();
            for node in frame.nodes_m.iter().step_by(5) {
                let nearest = points
                    .iter()
                    .map(|p| (p - node).norm())
                    .fold(f64::INFINITY, f64::min);
                assert!(
                    nearest < 2.0 * RADIUS,
                    "'{}' misses a node at {} s",
                    camera.name,
                    frame.t_s
                );
            }
        }
    }
}

#[test]
fn the_noise_along_the_ray_has_the_stated_size() {
    let nodes: Vec<_> = (0..=25)
        .map(|i| Vector3::new(0.01 * f64::from(i), 0.0, 0.007))
        .collect();
    let sensor = SensorSpec {
        noise_m: 0.001,
        quantum_m: 0.001,
        dropout: 0.0,
        most_points: usize::MAX,
    };
    let camera = two_cameras().remove(0);
    let position = Vector3::from(camera.position_m);
    let hits = render(&camera, position, &nodes, RADIUS);
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let points = observe(
        std::slice::from_ref(&camera),
        [0.0; 3],
        &nodes,
        RADIUS,
        &sensor,
        &mut random,
    );
    assert_eq!(points.len(), hits.len());
    let errors: Vec<f64> = points
        .iter()
        .zip(&hits)
        .map(|(point, hit)| (Vector3::from(*point) - position).dot(&hit.ray) - hit.range_m)
        .collect();
    let count = errors.len() as f64;
    let mean = errors.iter().sum::<f64>() / count;
    let spread = (errors.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / count).sqrt();
    // Rounding to a step q adds q²/12 to the variance.
    let expected = (1.0f64 + 1.0 / 12.0).sqrt() * 1e-3;
    assert!(mean.abs() < 4.0 * expected / count.sqrt(), "{mean}");
    assert!((spread / expected - 1.0).abs() < 0.1, "{spread}");
}

#[test]
fn dropout_and_the_limit_on_points_hold() {
    let nodes = [Vector3::new(0.0, 0.0, 0.007), Vector3::new(0.25, 0.0, 0.007)];
    let count = |dropout: f64, most_points: usize| {
        let sensor = SensorSpec {
            noise_m: 0.001,
            quantum_m: 0.001,
            dropout,
            most_points,
        };
        let mut random = ChaCha8Rng::seed_from_u64(3);
        observe(&two_cameras(), [0.0; 3], &nodes, RADIUS, &sensor, &mut random).len()
    };
    let all = count(0.0, usize::MAX);
    let kept = count(0.25, usize::MAX) as f64 / all as f64;
    assert!((kept - 0.75).abs() < 0.05, "{kept}");
    assert_eq!(count(0.25, 250), 250);
    assert_eq!(count(1.0, 250), 0);
}
