//! How the rope is when a scene begins, and the poses of scenes that have no time.

use super::curve::{Curve, turned};
pub use super::in_motion::beginning_s;
use super::in_motion::{first_two, seen};
use super::legs::Placed;
use super::rollout::perpendicular;
use super::rope::RopeShape;
use super::scene::Grip;
use super::statics::{Pin, Pose};
use super::tensor::{Mat3, add, norm, scaled};
use crate::demo::{Demo, MarkerSample, Observations, RopeEnd, SceneKind, StartState};

/// How the rope is at the start.
#[derive(Clone, Debug)]
pub enum Start {
    /// Straight and at rest.
    Straight,
    /// At rest, hanging from its grips.
    Rest(Hang),
    /// In motion: the shape of the first of two poses, with the velocity that leads to the second.
    Moving(Hang),
    /// At rest, each particle where it is said, slice by slice.
    Placed(Vec<Placed>),
    /// Nothing moves at all: each frame is a pose at rest.
    Poses(Hang),
}

/// Poses to be found by [`super::statics`].
#[derive(Clone, Debug)]
pub struct Hang {
    /// Per grip the rope's frame inside it at the first clamp sample: rows are the tangent and two
    /// normals. The rope is taken to be untwisted at the start.
    pub frames: Vec<Mat3<f64>>,
    /// The poses.
    pub poses: Vec<Pose>,
    /// Whether the rope was seen to stay in the plane of x and z.
    pub in_plane: bool,
}

impl Start {
    /// The start of a demonstration with the given grips, at least one.
    pub fn of_demo(demo: &Demo, rope: &RopeShape, grips: &[Grip]) -> Self {
        let spec = &demo.spec;
        let times = demo.times_s();
        let markers: &[MarkerSample] = match &demo.observations {
            Observations::Markers(samples) => samples,
            Observations::Clouds(_) => &[],
        };
        let builder = Builder {
            rope,
            grips,
            directions: spec
                .clamps
                .iter()
                .map(|clamp| clamp.direction.unwrap_or(spec.rope.direction))
                .collect(),
        };
        let hang = |wanted: Vec<(f64, Vec<MarkerSample>)>, stiffness_n_m: Option<f64>| {
            let poses: Vec<Pose> = wanted
                .iter()
                .map(|(t_s, markers)| builder.pose(*t_s, markers, stiffness_n_m))
                .collect();
            Hang {
                frames: builder.frames(&poses[0].guess),
                poses,
                in_plane: spec.stays_in_plane(),
            }
        };
        match (spec.scene, spec.start) {
            (SceneKind::Static, _) => Self::Poses(hang(seen(markers, &times), None)),
            (_, StartState::Straight) => Self::Straight,
            (_, StartState::Rest) => {
                let mut start = hang(seen(markers, &times[..1]), None);
                // The rollout begins at zero, where the clamp may still have been elsewhere than in the first frame: the
                // markers of that are a guess.
                start.poses[0].t_s = 0.0;
                Self::Rest(start)
            }
            (_, StartState::Moving) => {
                // A spring gives by the noise when it carries the whole rope.
                let weight_n = super::physics::GRAVITY_M_S2 * (rope.mass_kg + spec.rope.end_mass_kg);
                Self::Moving(hang(
                    first_two(markers, &times, spec.noise_m),
                    Some(weight_n / spec.noise_m),
                ))
            }
        }
    }

    /// The poses, if the rope hangs.
    pub fn hang(&self) -> Option<&Hang> {
        match self {
            Self::Straight | Self::Placed(_) => None,
            Self::Rest(hang) | Self::Moving(hang) | Self::Poses(hang) => Some(hang),
        }
    }

    /// Lets the search for each pose begin where it does in another scene of the same demonstration.
    pub fn begin_near(&mut self, other: &Self) {
        let (Some(hang), Some(other)) = (self.hang_mut(), other.hang()) else {
            return;
        };
        for (pose, other) in hang.poses.iter_mut().zip(&other.poses) {
            pose.near.clone_from(&other.near);
        }
    }

    /// Moves the springs of poses by what begins elsewhere.
    pub fn amend(&mut self, amends: &[Amends]) {
        for pose in self.hang_mut().into_iter().flat_map(|hang| &mut hang.poses) {
            for pin in &mut pose.pins {
                if let Some(one) = amends.iter().find(|one| one.arc_m == pin.arc_m) {
                    pin.target_m = add(pin.target_m, one.at(pose.t_s));
                }
            }
        }
    }

    /// The poses, to be changed.
    pub(super) fn hang_mut(&mut self) -> Option<&mut Hang> {
        match self {
            Self::Straight | Self::Placed(_) => None,
            Self::Rest(hang) | Self::Moving(hang) | Self::Poses(hang) => Some(hang),
        }
    }
}

/// By how much a rope that is first seen in motion begins elsewhere at a marker, and faster.
#[derive(Clone, Copy, Debug)]
pub struct Amends {
    /// Arc length of the marker, m.
    pub arc_m: f64,
    /// At time zero, m.
    pub offset_m: [f64; 3],
    /// m/s.
    pub velocity_m_s: [f64; 3],
}

impl Amends {
    fn at(&self, t_s: f64) -> [f64; 3] {
        add(self.offset_m, scaled(self.velocity_m_s, t_s))
    }

    /// The largest it comes to until a time, m.
    pub fn farthest_m(&self, until_s: f64) -> f64 {
        norm(self.at(0.0)).max(norm(self.at(until_s)))
    }
}

struct Builder<'a> {
    rope: &'a RopeShape,
    grips: &'a [Grip],
    /// Directions of the gripped pieces at their first samples.
    directions: Vec<[f64; 3]>,
}

impl Builder<'_> {
    fn pose(&self, t_s: f64, markers: &[MarkerSample], stiffness_n_m: Option<f64>) -> Pose {
        let length_m = self.rope.length_m;
        let mut knots: Vec<(f64, [f64; 3])> = Vec::new();
        for (index, grip) in self.grips.iter().enumerate() {
            let motion = grip.path.motion(t_s);
            let inwards = if grip.end == RopeEnd::Start { 1.0 } else { -1.0 };
            let outer_m = if grip.end == RopeEnd::Start { 0.0 } else { length_m };
            let inner = scaled(self.directions[index], inwards * grip.length_m);
            knots.push((outer_m, motion.place([0.0; 3])));
            knots.push((outer_m + inwards * grip.length_m, motion.place(inner)));
        }
        // Markers at a knot of a grip say what the grip says better.
        let near = |s: f64| knots.iter().any(|k| (k.0 - s).abs() < 0.005 * length_m);
        let seen: Vec<_> = markers.iter().filter(|m| !near(m.s_m)).collect();
        let outer = knots[0];
        knots.extend(seen.iter().map(|m| (m.s_m, m.position_m)));
        knots.sort_by(|a, b| a.0.total_cmp(&b.0));
        let anchor = knots.iter().position(|k| *k == outer).unwrap_or(0);
        let motion = self.grips[0].path.motion(t_s);
        let frame = self.first_frame().map(|v| motion.turn(v));
        Pose {
            t_s,
            guess: Curve::through(length_m, &knots, anchor, &frame),
            pins: match stiffness_n_m {
                Some(stiffness_n_m) => markers
                    .iter()
                    .map(|m| Pin {
                        arc_m: m.s_m,
                        target_m: m.position_m,
                        stiffness_n_m,
                    })
                    .collect(),
                None => Vec::new(),
            },
            near: None,
        }
    }

    fn first_frame(&self) -> Mat3<f64> {
        let direction = self.directions[0];
        let (side, up) = perpendicular(direction);
        [direction, side, up]
    }

    /// The frames inside the grips, carried along the rope from the first grip without twist.
    fn frames(&self, guess: &Curve) -> Vec<Mat3<f64>> {
        let length_m = self.rope.length_m;
        (0..self.grips.len())
            .map(|index| {
                if index == 0 {
                    return self.first_frame();
                }
                let grip = &self.grips[index];
                let middle = match grip.end {
                    RopeEnd::Start => 0.5 * grip.length_m,
                    RopeEnd::End => length_m - 0.5 * grip.length_m,
                };
                turned(&guess.frame(middle), self.directions[index])
            })
            .collect()
    }
}

impl Hang {
    /// Where a point with undeformed coordinates (s, side, up) lies relative to the first pose of the
    /// grip's end point, m.
    pub fn grip_offset(&self, index: usize, grip: &Grip, length_m: f64, [s, a, b]: [f64; 3]) -> [f64; 3] {
        let from_end = match grip.end {
            RopeEnd::Start => s,
            RopeEnd::End => s - length_m,
        };
        let [along, side, up] = self.frames[index];
        add(scaled(along, from_end), add(scaled(side, a), scaled(up, b)))
    }
}
