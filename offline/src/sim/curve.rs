//! A curve in space with frames that do not twist: a guess at the shape of a hanging rope.

use super::tensor::{Mat3, add, cross, direction, dot, norm, scaled, sub};

/// Points at equal steps of arc length with frames whose rows are the tangent and two normals.
#[derive(Clone, Debug)]
pub struct Curve {
    step_m: f64,
    points_m: Vec<[f64; 3]>,
    frames: Vec<Mat3<f64>>,
}

/// Number of steps along a curve.
const STEPS: usize = 240;
/// Directions are averaged over this share of the length, so that chords between noisy points do not
/// fold the rope.
const SMOOTH_SHARE: f64 = 0.1;
/// A chord this much shorter than its piece of rope belongs to a straight piece.
const STRAIGHT: f64 = 1e-3;

impl Curve {
    /// A curve of a given length whose directions follow the chords between `knots` (arc length, m,
    /// and point, m; in the order of the arc length, at least two): a chord's in the middle of its piece, along all
    /// of it where it is straight as in a grip, and turning evenly from one to the next. It passes through the knot
    /// number `anchor`, where its frame has the rows of `frame` as nearly as the direction allows.
    pub fn through(length_m: f64, knots: &[(f64, [f64; 3])], anchor: usize, frame: &Mat3<f64>) -> Self {
        let step_m = length_m / STEPS as f64;
        let course = Course::of(knots);
        let at = |i: usize| (i as f64 + 0.5) * step_m;
        let raw: Vec<[f64; 3]> = (0..STEPS).map(|i| course.direction(at(i))).collect();
        let directions: Vec<[f64; 3]> = (0..STEPS)
            .map(|i| {
                let room = course.to_straight(at(i)).min(0.5 * SMOOTH_SHARE * length_m);
                let reach = (room / step_m) as usize;
                let around = i.saturating_sub(reach)..=(i + reach).min(STEPS - 1);
                unit(raw[around].iter().fold([0.0; 3], |sum, d| add(sum, *d)))
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

/// Where a rope points along its length.
struct Course {
    /// Arc length, m, and direction; in the order of the arc length.
    nodes: Vec<(f64, [f64; 3])>,
    /// Arc lengths between which it is straight, m.
    straight: Vec<[f64; 2]>,
}

impl Course {
    fn of(knots: &[(f64, [f64; 3])]) -> Self {
        let (mut nodes, mut straight) = (Vec::new(), Vec::new());
        for pair in knots.windows(2) {
            let ([from, to], chord) = ([pair[0].0, pair[1].0], sub(pair[1].1, pair[0].1));
            if norm(chord) < (1.0 - STRAIGHT) * (to - from) {
                nodes.push((0.5 * (from + to), unit(chord)));
            } else {
                nodes.extend([from, to].map(|s| (s, unit(chord))));
                straight.push([from, to]);
            }
        }
        Self { nodes, straight }
    }

    fn direction(&self, s: f64) -> [f64; 3] {
        let upper = self.nodes.partition_point(|node| node.0 < s);
        let (before, after) = (upper.saturating_sub(1), upper.min(self.nodes.len() - 1));
        let [(from, a), (to, b)] = [self.nodes[before], self.nodes[after]];
        let share = if to > from { (s - from) / (to - from) } else { 0.0 };
        let angle = norm(cross(a, b)).atan2(dot(a, b));
        if angle.sin() < STRAIGHT {
            // The same direction, or the opposite one: no plane to turn in.
            return if share < 0.5 { a } else { b };
        }
        let turned = |share: f64| (share * angle).sin() / angle.sin();
        unit(add(scaled(a, turned(1.0 - share)), scaled(b, turned(share))))
    }

    /// Distance to the nearest straight piece along the rope, m.
    fn to_straight(&self, s: f64) -> f64 {
        let distance = |&[from, to]: &[f64; 2]| (from - s).max(s - to).max(0.0);
        self.straight.iter().map(distance).fold(f64::INFINITY, f64::min)
    }
}

fn unit(v: [f64; 3]) -> [f64; 3] {
    if norm(v) > 0.0 {
        direction(v)
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

    /// Held upright, seen again far below: the guess leaves the grip as it points and turns over gently.
    #[test]
    fn a_rope_leaves_its_grip_straight_and_turns_evenly_towards_what_was_seen() {
        let length = 0.7;
        let knots = [
            (0.0, [0.0; 3]),
            (0.02, [0.0, 0.0, 0.02]),
            (0.36, [0.2, 0.0, 0.0]),
            (0.7, [0.2, 0.0, -0.34]),
        ];
        let curve = Curve::through(
            length,
            &knots,
            0,
            &[[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]],
        );
        assert!(norm(sub(curve.place([0.02, 0.0, 0.0]), [0.0, 0.0, 0.02])) < 1e-3);
        let turn = |s: f64| {
            let [a, b] = [curve.frame(s)[0], curve.frame(s + 0.01)[0]];
            norm(cross(a, b)).atan2(dot(a, b))
        };
        // From the grip to the middle of the next piece it turns by a right angle and more: 0.17 m.
        let most = (0..60).map(|k| turn(0.01 * f64::from(k))).fold(0.0, f64::max);
        assert!(most < 2.0 * 0.01 * 1.7 / 0.17, "{most}");
    }

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
