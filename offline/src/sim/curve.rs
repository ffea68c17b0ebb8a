//! A curve in space with frames that do not twist: a guess at the shape of a hanging rope.

use super::tensor::{Mat3, add, cross, dot, norm, scaled, sub};

/// Points at equal steps of arc length with frames whose rows are the tangent and two normals.
#[derive(Clone, Debug)]
pub struct Curve {
    step_m: f64,
    points_m: Vec<[f64; 3]>,
    frames: Vec<Mat3<f64>>,
}

/// Number of steps along a curve.
const STEPS: usize = 240;
/// Directions are averaged over this share of the length, so that chords between few points do not
/// fold the rope.
const SMOOTH_SHARE: f64 = 0.1;

impl Curve {
    /// A curve of a given length whose directions follow the chords between `knots` (arc length, m,
    /// and point, m; in the order of the arc length, at least two). It passes through the knot
    /// number `anchor`, where its frame has the rows of `frame` as nearly as the direction allows.
    pub fn through(length_m: f64, knots: &[(f64, [f64; 3])], anchor: usize, frame: &Mat3<f64>) -> Self {
        let step_m = length_m / STEPS as f64;
        let chord = |s: f64| {
            let upper = knots.partition_point(|k| k.0 < s).clamp(1, knots.len() - 1);
            sub(knots[upper].1, knots[upper - 1].1)
        };
        let reach = (0.5 * SMOOTH_SHARE * STEPS as f64) as i64;
        let raw: Vec<[f64; 3]> = (0..STEPS)
            .map(|i| unit(chord((i as f64 + 0.5) * step_m)))
            .collect();
        let directions: Vec<[f64; 3]> = (0..STEPS as i64)
            .map(|i| {
                let around = (i - reach).max(0)..=(i + reach).min(STEPS as i64 - 1);
                unit(around.fold([0.0; 3], |sum, k| add(sum, raw[k as usize])))
            })
            .collect();
        let mut points_m = vec![[0.0; 3]];
        for (i, d) in directions.iter().enumerate() {
            points_m.push(add(points_m[i], scaled(*d, step_m)));
        }
        let at = ((knots[anchor].0 / step_m).round() as usize).min(STEPS);
        let shift = sub(knots[anchor].1, points_m[at]);
        for point in &mut points_m {
            *point = add(*point, shift);
        }
        let tangent = |i: usize| directions[i.min(STEPS - 1)];
        let mut frames = vec![*frame; STEPS + 1];
        frames[at] = turned(frame, tangent(at));
        for i in at + 1..=STEPS {
            frames[i] = turned(&frames[i - 1], tangent(i));
        }
        for i in (0..at).rev() {
            frames[i] = turned(&frames[i + 1], tangent(i));
        }
        Self {
            step_m,
            points_m,
            frames,
        }
    }

    /// Where the point with undeformed coordinates (s, side, up) lies, m; straight beyond the ends.
    pub fn place(&self, [s, a, b]: [f64; 3]) -> [f64; 3] {
        let i = ((s / self.step_m).floor().max(0.0) as usize).min(STEPS - 1);
        let along = s - i as f64 * self.step_m;
        let tangent = scaled(sub(self.points_m[i + 1], self.points_m[i]), 1.0 / self.step_m);
        let frame = self.frame(s);
        let across = add(scaled(frame[1], a), scaled(frame[2], b));
        add(add(self.points_m[i], scaled(tangent, along)), across)
    }

    /// The frame at an arc length: rows are the tangent and the two normals.
    pub fn frame(&self, s_m: f64) -> Mat3<f64> {
        self.frames[((s_m / self.step_m).round().max(0.0) as usize).min(STEPS)]
    }
}

fn unit(v: [f64; 3]) -> [f64; 3] {
    let length = norm(v);
    if length > 0.0 {
        scaled(v, 1.0 / length)
    } else {
        [0.0, 0.0, -1.0]
    }
}

/// A frame turned by the smallest rotation that brings its tangent (row 0) onto `tangent`.
pub fn turned(frame: &Mat3<f64>, tangent: [f64; 3]) -> Mat3<f64> {
    let axis = cross(frame[0], tangent);
    let cosine = dot(frame[0], tangent);
    if cosine < -0.999_999 {
        return [tangent, frame[1], scaled(frame[2], -1.0)];
    }
    // Rodrigues' formula for the rotation by the angle between two unit vectors, and what rounding
    // left of the tangent taken out: it would double with every turn.
    let side = frame[1];
    let share = dot(axis, side) / (1.0 + cosine);
    let side = add(add(scaled(side, cosine), cross(axis, side)), scaled(axis, share));
    let side = unit(sub(side, scaled(tangent, dot(side, tangent))));
    [tangent, side, cross(tangent, side)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quarter_circle_is_followed_and_the_frame_does_not_twist() {
        let radius = 0.3;
        let length = radius * std::f64::consts::FRAC_PI_2;
        let knots: Vec<_> = (0..=40)
            .map(|k| {
                let angle = std::f64::consts::FRAC_PI_2 * f64::from(k) / 40.0;
                (
                    radius * angle,
                    [radius * angle.sin(), 0.0, radius * (angle.cos() - 1.0)],
                )
            })
            .collect();
        let frame = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let curve = Curve::through(length, &knots, 0, &frame);
        let end = curve.place([length, 0.0, 0.0]);
        assert!(norm(sub(end, [radius, 0.0, -radius])) < 0.02 * length, "{end:?}");
        let last = curve.frame(length);
        assert!(
            (last[1][1] - 1.0).abs() < 1e-9,
            "the normal out of the plane stays"
        );
        assert!(last[2][0] > 0.98, "{last:?}");
    }
}
