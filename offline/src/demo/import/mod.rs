//! Recordings that others made, as demonstrations: one file per source. What a source does not say
//! is marked as assumed in the demonstration, never made up in silence.

mod deform;
mod mcap;
mod noodle;
mod npy;
mod pac_cables;
mod wires;

pub use self::mcap::{FromMcap, McapTopics, mcap};
pub use deform::deform;
pub use noodle::noodle;
pub use pac_cables::pac_cables;
pub use wires::wires;

use super::{
    ClampSample, ClampSpec, Demo, DemoSpec, FORMAT, MarkerSample, Observations, RopeMeasure, RopeSpec,
    SceneKind, StartState,
};
use nalgebra::{Unit, UnitQuaternion, Vector3};

/// Both measures that can be assumed.
const MASS_AND_DIAMETER: [RopeMeasure; 2] = [RopeMeasure::DiameterM, RopeMeasure::MassKg];

/// Mass of a round rod of an assumed density, kg.
fn assumed_mass_kg(length_m: f64, diameter_m: f64, density_kg_m3: f64) -> f64 {
    density_kg_m3 * std::f64::consts::FRAC_PI_4 * diameter_m * diameter_m * length_m
}

/// What a source of labelled points says, as far as sources differ.
struct Source {
    name: String,
    scene: SceneKind,
    start: StartState,
    noise_m: f64,
    planar: bool,
    notes: String,
    rope: RopeSpec,
    clamps: Vec<(ClampSpec, Vec<ClampSample>)>,
    markers: Vec<MarkerSample>,
}

impl Source {
    /// The demonstration: without table and cameras.
    fn demo(self) -> Demo {
        let (specs, samples): (Vec<ClampSpec>, Vec<Vec<ClampSample>>) = self.clamps.into_iter().unzip();
        Demo {
            name: self.name,
            spec: DemoSpec {
                format: FORMAT.to_owned(),
                scene: self.scene,
                noise_m: self.noise_m,
                planar: self.planar,
                notes: self.notes,
                start: self.start,
                rope: self.rope,
                table: None,
                clamps: specs,
                cameras: Vec::new(),
            },
            commanded: vec![None; samples.len()],
            clamps: samples,
            observations: Observations::Markers(self.markers),
        }
    }
}

/// A closed clamp. The rope's end lies `behind_m` behind the point `at_m` against `direction`.
fn sample(t_s: f64, at_m: Vector3<f64>, behind_m: f64, direction: Vector3<f64>, turn: Turn) -> ClampSample {
    ClampSample {
        t_s,
        position_m: (at_m - behind_m * direction).into(),
        quaternion_xyzw: turn.coords.into(),
        closed: true,
    }
}

type Turn = UnitQuaternion<f64>;

/// Every `stride`-th frame of a recording at `recorded_hz`, so that about `wanted_hz` are left.
/// Frames are left out, never averaged.
fn stride(recorded_hz: f64, wanted_hz: f64) -> usize {
    (recorded_hz / wanted_hz).round().max(1.0) as usize
}

/// Follows a direction in time by the smallest turn from one instant to the next: the orientation of
/// a clamp of which only the tangent is known. Its roll about the tangent is a guess: none.
struct Follower {
    turn: Turn,
    direction: Vector3<f64>,
}

impl Follower {
    fn new(direction: Vector3<f64>) -> Self {
        Self {
            turn: Turn::identity(),
            direction: direction.normalize(),
        }
    }

    /// The turn since the first direction.
    fn follow(&mut self, direction: Vector3<f64>) -> Turn {
        let next = direction.normalize();
        if let Some(step) = Turn::rotation_between(&self.direction, &next) {
            self.turn = Unit::new_normalize(*(step * self.turn).quaternion());
        }
        self.direction = next;
        self.turn
    }
}

#[cfg(test)]
mod tests {
    use super::super::make_continuous;
    use super::*;

    #[test]
    fn a_quaternion_that_changes_its_sign_is_turned_back() {
        let mut path: Vec<ClampSample> = [0.1, 0.2, 0.3]
            .map(|angle| {
                let turn = Turn::from_axis_angle(&Vector3::z_axis(), angle);
                sample(angle, Vector3::zeros(), 0.0, Vector3::x(), turn)
            })
            .to_vec();
        let good = path.clone();
        path[1].quaternion_xyzw = path[1].quaternion_xyzw.map(|c| -c);
        make_continuous(&mut path);
        assert_eq!(path, good);
    }

    /// A direction that goes around once comes back without roll if it stays in a plane.
    #[test]
    fn a_followed_direction_is_reached_by_the_turn() {
        let mut follower = Follower::new(Vector3::x());
        for k in 1..=90 {
            let angle = f64::from(k) * std::f64::consts::TAU / 90.0;
            let direction = Vector3::new(angle.cos(), 0.0, angle.sin());
            let turn = follower.follow(direction);
            assert!((turn * Vector3::x() - direction).norm() < 1e-9);
            assert!((turn * Vector3::y() - Vector3::y()).norm() < 1e-9);
        }
    }
}
