//! Whether a rope that is said to lie straight at first does.

use super::plausible::{FEW, sample_at};
use super::rest::has_moved;
use super::summary::Frame;
use super::{CameraSpec, Demo, MarkerSample, RopeEnd, rotation};
use nalgebra::Vector3;

/// Share of the declared length that the first cloud of a straight rope is long at least: its ends may be hidden by the
/// gripper.
const SEEN_LENGTH: f64 = 0.7;
/// Share of a cloud's points at each of its ends that its length is not reckoned from: noise and background reach farther
/// than the rope.
const FARTHEST: f64 = 0.02;

/// Where the start of a rope that lies straight is, m: its first clamp holds one of its ends.
fn straight_from(demo: &Demo) -> Option<Vector3<f64>> {
    let (path, clamp) = (demo.clamps.first()?, demo.spec.clamps.first()?);
    let rope = &demo.spec.rope;
    let back_m = match clamp.end {
        RopeEnd::Start => 0.0,
        RopeEnd::End => rope.length_m,
    };
    Some(Vector3::from(path[0].position_m) - back_m * Vector3::from(rope.direction))
}

/// Whether the first clamp has moved when something is first seen: cameras may begin late.
fn moves_before(demo: &Demo, t_s: f64) -> bool {
    let path = demo.clamps.first();
    path.is_some_and(|path| has_moved(sample_at(path, t_s), &path[0]))
}

/// Markers of the first instant of a rope that lies straight: each where its arc length says.
pub(super) fn straight_markers(demo: &Demo, samples: &[MarkerSample]) -> Option<String> {
    let start = straight_from(demo)?;
    let rope = &demo.spec.rope;
    let allowed = rope.diameter_m + 5.0 * demo.spec.noise_m;
    let first = samples.chunk_by(|a, b| a.t_s == b.t_s).next()?;
    if moves_before(demo, first[0].t_s) {
        return None;
    }
    let off_m = |marker: &MarkerSample| {
        let place = start + marker.s_m * Vector3::from(rope.direction);
        (Vector3::from(marker.position_m) - place).norm()
    };
    let off = first.iter().filter(|marker| off_m(marker) > allowed).count();
    let worst_m = first.iter().map(off_m).fold(0.0, f64::max);
    (off as f64 > FEW * first.len() as f64).then(|| {
        format!(
            "{off} of the first {} markers lie off the straight rope, by up to {:.0} mm; check the rope's direction and the \
             markers' s_m, or declare another start",
            first.len(),
            1e3 * worst_m
        )
    })
}

/// The first cloud of a rope that lies straight: as long as the rope, and on its line.
pub(super) fn straight_start(demo: &Demo, frames: &[Frame<'_>]) -> Vec<String> {
    let (Some(first), Some(start)) = (frames.first(), straight_from(demo)) else {
        return Vec::new();
    };
    if moves_before(demo, first.t_s) {
        return Vec::new();
    }
    let rope = &demo.spec.rope;
    let along = Vector3::from(rope.direction);
    let mut found = Vec::new();
    let shares = first
        .points
        .iter()
        .map(|p| (Vector3::from(**p) - start).dot(&along));
    let mut shares: Vec<f64> = shares.collect();
    shares.sort_by(f64::total_cmp);
    let least = (FARTHEST * shares.len() as f64) as usize;
    let inner_m = match shares[least..shares.len() - least] {
        [low, .., high] => high - low,
        _ => 0.0,
    };
    let inner = 1.0 - 2.0 * FARTHEST;
    let longest_m = rope.length_m + 2.0 * demo.spec.noise_m;
    if !(inner * SEEN_LENGTH * rope.length_m..=longest_m).contains(&inner_m) {
        found.push(format!(
            "{:.0} % of the first cloud are {:.0} mm long, the whole rope that lies straight {:.0} mm; check the scale and length_m",
            100.0 * inner,
            1e3 * inner_m,
            1e3 * rope.length_m
        ));
    }
    let allowed = rope.diameter_m + 5.0 * demo.spec.noise_m;
    let on_line = |p: &Vector3<f64>| {
        let d = p - start;
        let s = d.dot(&along);
        (-allowed..=rope.length_m + allowed).contains(&s) && (d - s * along).norm() <= allowed
    };
    let points = first.points.iter().map(|p| Vector3::from(**p));
    let off: Vec<Vector3<f64>> = points.filter(|p| !on_line(p)).collect();
    if off.len() as f64 <= FEW * first.points.len() as f64 {
        return found;
    }
    let turned = demo.spec.cameras.iter().find(|camera| {
        let back = off.iter().filter(|p| on_line(&upside_down(camera, p)));
        back.count() as f64 > (1.0 - 2.0 * FEW) * off.len() as f64
    });
    let cause = turned.map_or(
        "look for background, a wrong camera pose or a rope that does not lie straight".to_owned(),
        |camera| format!("turned by half about its optical axis, camera '{}' would see them on it: it stands upside down", camera.name),
    );
    found.push(format!(
        "{:.0} % of the first cloud lie off the straight rope; {cause}",
        100.0 * off.len() as f64 / first.points.len() as f64
    ));
    found
}

/// Where a point would be if the camera that saw it were turned by half about its optical axis.
pub(super) fn upside_down(camera: &CameraSpec, point: &Vector3<f64>) -> Vector3<f64> {
    let turn = rotation(camera.quaternion_xyzw);
    let at = Vector3::from(camera.position_m);
    let seen = turn.inverse() * (point - at);
    at + turn * Vector3::new(-seen.x, -seen.y, seen.z)
}
