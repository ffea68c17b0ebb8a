//! A measured demonstration: what was held where, and what the cameras saw. Folder format
//! `genorm-demo/1`; SI units, z up, rope arc length s from its start (0) to its end (length).

mod check;
mod cut;
mod draw;
mod error;
mod export;
pub mod import;
mod pcd;
mod plausible;
mod points;
mod read;
mod recording;
mod rest;
mod ros;
mod straight;
mod summary;
mod table;
mod write;

pub(crate) use check::no_rope;
pub use cut::pose_at;
pub use draw::plot_svg;
pub use error::DemoError;
pub use export::{CLOUD_TOPIC, clamp_topic, closed_topic, export_mcap};
pub use plausible::clock_problem;
pub use read::files;
pub use recording::recording;
pub use summary::{summary, warnings};
pub use write::{refuse_to_replace, refuse_to_replace_file};

use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use std::f64::consts::FRAC_PI_4;

/// Name and version of the folder format.
pub const FORMAT: &str = "genorm-demo/1";

/// Which experiment was made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SceneKind {
    /// Rope straight on the table, one end gripped and lifted.
    Lift,
    /// Rope hangs from a fixed clamp, its bottom end is dragged and released.
    Swing,
    /// Any clamps on given paths.
    Free,
    /// Each frame is a pose in which the rope hangs still. Times only number the poses; every clamp
    /// has one sample per frame, at the frame's time.
    Static,
}

/// What the rope did at the first clamp sample.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum StartState {
    /// It lay straight and at rest along [`RopeSpec::direction`].
    #[default]
    Straight,
    /// It hung still from its clamps.
    Rest,
    /// It moved, or was held by something that then let go: shape and velocity are those of the
    /// first markers.
    Moving,
}

impl StartState {
    fn is_straight(&self) -> bool {
        *self == Self::Straight
    }
}

/// A measure of the rope that can be assumed instead of measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RopeMeasure {
    /// [`RopeSpec::diameter_m`].
    DiameterM,
    /// [`RopeSpec::mass_kg`].
    MassKg,
}

/// An end of the rope.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RopeEnd {
    /// s = 0.
    Start,
    /// s = length.
    End,
}

/// The rope as measured by hand.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RopeSpec {
    /// Length, m.
    pub length_m: f64,
    /// Diameter, m.
    pub diameter_m: f64,
    /// Mass, kg.
    pub mass_kg: f64,
    /// Direction of the straight rope at the first clamp sample, from start to end.
    #[serde(default = "along_x")]
    pub direction: [f64; 3],
    /// Known mass that sits at the rope's end (s = length) besides the rope's own, kg: a weight, a cap.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub end_mass_kg: f64,
    /// By how much the rope is rolled about its own axis against the other demonstrations of the same rope,
    /// right-handed about [`Self::direction`], rad: what its material brings along, such as a bend at rest,
    /// turns with it.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub roll_rad: f64,
    /// Which of the values above nobody measured. Then only ratios are identified: stiffness per mass
    /// where the mass is assumed, bending stiffness and not Young's modulus where the diameter is.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub assumed: Vec<RopeMeasure>,
}

impl RopeSpec {
    /// Mass per volume of the cylinder, kg/m³.
    pub fn density_kg_m3(&self) -> f64 {
        self.mass_kg / (FRAC_PI_4 * self.diameter_m.powi(2) * self.length_m)
    }
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

fn along_x() -> [f64; 3] {
    [1.0, 0.0, 0.0]
}

/// The table under the rope.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TableSpec {
    /// Height of the table's surface, m.
    pub height_m: f64,
    /// Declared Coulomb coefficient between rope and table.
    #[serde(default = "paper_friction")]
    pub friction: f64,
}

fn paper_friction() -> f64 {
    0.5
}

/// One gripped end. Its pose samples stand in `clamp_<index>.csv`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClampSpec {
    /// Which end is gripped.
    pub end: RopeEnd,
    /// Length of rope inside the grip, m.
    pub grip_m: f64,
    /// Direction of the gripped piece at the first clamp sample, from the rope's start to its end;
    /// [`RopeSpec::direction`] where it is left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub direction: Option<[f64; 3]>,
}

/// A depth camera. The optical frame has z forward, x right, y down.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraSpec {
    /// Name for messages.
    pub name: String,
    /// Optical centre in the world, m.
    pub position_m: [f64; 3],
    /// Rotation from the optical frame to the world, (x, y, z, w).
    pub quaternion_xyzw: [f64; 4],
    /// Image width, pixels.
    pub width_px: u32,
    /// Image height, pixels.
    pub height_px: u32,
    /// Focal lengths (fx, fy), pixels.
    pub focal_px: [f64; 2],
    /// Principal point (cx, cy), pixels.
    pub centre_px: [f64; 2],
}

impl CameraSpec {
    /// A camera of 320 x 240 pixels with a RealSense D435's focal length (385 pixels for an image 640
    /// wide), looking from `position_m` at `target_m` with the image's x axis level.
    pub fn looking_at(name: &str, position_m: [f64; 3], target_m: [f64; 3]) -> Self {
        let forward = (Vector3::from(target_m) - Vector3::from(position_m)).normalize();
        let right = forward.cross(&Vector3::z()).normalize();
        let down = forward.cross(&right);
        let basis = Matrix3::from_columns(&[right, down, forward]);
        let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(basis));
        Self {
            name: name.to_owned(),
            position_m,
            quaternion_xyzw: turn.coords.into(),
            width_px: 320,
            height_px: 240,
            focal_px: [385.0, 385.0],
            centre_px: [159.5, 119.5],
        }
    }
}

/// The file `demo.toml`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DemoSpec {
    /// Must be [`FORMAT`].
    pub format: String,
    /// Which experiment.
    pub scene: SceneKind,
    /// Declared standard deviation of one measured point, m: along the rays of the cameras where these are declared, else
    /// along each axis.
    pub noise_m: f64,
    /// Whether only x and z were measured: the motion is planar, y is the plane's and says nothing.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub planar: bool,
    /// Free text.
    #[serde(default)]
    pub notes: String,
    /// What the rope did at the first clamp sample.
    #[serde(default, skip_serializing_if = "StartState::is_straight")]
    pub start: StartState,
    /// The rope.
    pub rope: RopeSpec,
    /// The table; none where the rope hangs far from anything.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub table: Option<TableSpec>,
    /// Gripped ends, in the order of the clamp files.
    #[serde(default)]
    pub clamps: Vec<ClampSpec>,
    /// Cameras that made the clouds.
    #[serde(default)]
    pub cameras: Vec<CameraSpec>,
}

impl DemoSpec {
    /// Declared friction on the table, zero without a table.
    pub fn friction(&self) -> f64 {
        self.table.as_ref().map_or(0.0, |table| table.friction)
    }

    /// Whether the demonstration is poses at rest, without time.
    pub fn is_static(&self) -> bool {
        self.scene == SceneKind::Static
    }

    /// Whether the rope stays in the plane in which it was seen. One that was rolled bends in other planes.
    pub fn stays_in_plane(&self) -> bool {
        self.planar && self.rope.roll_rad == 0.0
    }
}

/// One sample of a clamp path: the pose of the rope's end point on its axis (s = 0 or s = length).
/// The gripped piece moves rigidly with the pose, relative to the first sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClampSample {
    /// Time, s.
    pub t_s: f64,
    /// Position, m.
    pub position_m: [f64; 3],
    /// Orientation (x, y, z, w); identity where the file has no quaternion columns.
    pub quaternion_xyzw: [f64; 4],
    /// Whether the clamp holds the rope.
    pub closed: bool,
}

/// Takes of each orientation the quaternion, q or -q, that is nearer to the one before: interpolation
/// between neighbours then never turns the long way round.
fn make_continuous(path: &mut [ClampSample]) {
    for k in 1..path.len() {
        let (before, now) = (path[k - 1].quaternion_xyzw, path[k].quaternion_xyzw);
        if (0..4).map(|c| before[c] * now[c]).sum::<f64>() < 0.0 {
            path[k].quaternion_xyzw = now.map(|c| -c);
        }
    }
}

impl ClampSample {
    /// Orientation.
    pub fn turn(&self) -> UnitQuaternion<f64> {
        rotation(self.quaternion_xyzw)
    }
}

/// The rotation that a quaternion (x, y, z, w) of a demonstration stands for.
fn rotation([x, y, z, w]: [f64; 4]) -> UnitQuaternion<f64> {
    UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z))
}

/// What the cameras saw at one instant.
#[derive(Clone, Debug, PartialEq)]
pub struct CloudFrame {
    /// Time, s.
    pub t_s: f64,
    /// Points on the rope's visible surface, m.
    pub points_m: Vec<[f64; 3]>,
}

/// A labelled point on the rope's axis at one instant.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkerSample {
    /// Time, s.
    pub t_s: f64,
    /// Label.
    pub marker: String,
    /// Arc length, m.
    pub s_m: f64,
    /// Position, m.
    pub position_m: [f64; 3],
}

/// Measurements of the rope.
#[derive(Clone, Debug, PartialEq)]
pub enum Observations {
    /// Point clouds in time order.
    Clouds(Vec<CloudFrame>),
    /// Labelled points in time order.
    Markers(Vec<MarkerSample>),
}

/// A demonstration, checked.
#[derive(Clone, Debug, PartialEq)]
pub struct Demo {
    /// Name: the folder's last component.
    pub name: String,
    /// `demo.toml`.
    pub spec: DemoSpec,
    /// Measured (else commanded) path of each clamp.
    pub clamps: Vec<Vec<ClampSample>>,
    /// Commanded path of each clamp where both were recorded.
    pub commanded: Vec<Option<Vec<ClampSample>>>,
    /// What was seen.
    pub observations: Observations,
}

impl Demo {
    /// Times at which the rope was seen, s, increasing.
    pub fn times_s(&self) -> Vec<f64> {
        let mut times: Vec<f64> = match &self.observations {
            Observations::Clouds(frames) => frames.iter().map(|f| f.t_s).collect(),
            Observations::Markers(samples) => samples.iter().map(|m| m.t_s).collect(),
        };
        times.dedup();
        times
    }
}
