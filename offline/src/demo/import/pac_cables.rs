//! `pac_cables`: cables clamped at one end in a vertical plane (Tiburzio et al., arXiv 2402.16114):
//! static poses, free swings and swings driven by the robot.
//!
//! The clamp frame's z axis points against the cable; its angle counts clockwise with x right and z
//! up, which is a right-handed turn about +y. Poses are measured marker positions. Swings hold only
//! the source's affine-curvature fit to the markers, of which middle and end point are taken.

use super::{Source, sample};
use crate::demo::table::Table;
use crate::demo::{
    ClampSample, ClampSpec, Demo, DemoError, MarkerSample, RopeEnd, RopeSpec, SceneKind, StartState,
};
use nalgebra::{UnitQuaternion, Vector3};
use std::path::Path;

/// Cable taken to continue into the clamp, at the same mass per length; it only holds the direction.
const GRIP_M: f64 = 0.02;
/// Standard deviation of a marker seen by the camera: not stated, a guess.
const POSE_NOISE_M: f64 = 0.002;
/// Error of the source's curvature fit at the cable's end, m: 1 to 5 mm, and 12 to 22 mm for the long
/// orange cable (measured against the markers of the poses).
const FIT_NOISE_M: f64 = 0.004;
const FIT_NOISE_LONG_M: f64 = 0.017;
/// The cable that the curvature fit misses.
const LONG: &str = "orange_weighted";

/// A cable of `objects.csv`.
struct Cable {
    name: String,
    mass_kg: f64,
    end_mass_kg: f64,
    free_m: f64,
    diameter_m: f64,
}

/// Per cable its static poses, its free swing and, where there is one, its driven swing.
///
/// # Errors
/// A file is missing or malformed.
pub fn pac_cables(dir: &Path) -> Result<Vec<Demo>, DemoError> {
    let columns = ["object", "cable_mass_kg", "end_mass_kg", "length_m", "diameter_m"];
    let objects = Table::read(&dir.join("objects.csv"), &columns, &[])?;
    let mut demos = Vec::new();
    for row in 0..objects.len() {
        let cable = Cable {
            name: objects.text(row, "object").to_owned(),
            mass_kg: objects.number(row, "cable_mass_kg")?,
            end_mass_kg: objects.number(row, "end_mass_kg")?,
            free_m: objects.number(row, "length_m")?,
            diameter_m: objects.number(row, "diameter_m")?,
        };
        demos.push(poses(dir, &cable)?);
        demos.push(swing(dir, &cable)?);
        let driven_file = dir.join(format!("driven_{}.csv", cable.name));
        if driven_file.exists() {
            demos.push(driven(&driven_file, &cable)?);
        }
    }
    Ok(demos)
}

/// The clamp turned by `angle_rad` at `at_m` (x, z), with the cable leaving it.
struct Base {
    turn: UnitQuaternion<f64>,
    at_m: Vector3<f64>,
}

impl Base {
    fn new(at_m: [f64; 2], angle_rad: f64) -> Self {
        Self {
            turn: UnitQuaternion::from_axis_angle(&Vector3::y_axis(), angle_rad),
            at_m: Vector3::new(at_m[0], 0.0, at_m[1]),
        }
    }

    fn direction(&self) -> Vector3<f64> {
        self.turn * -Vector3::z()
    }

    fn clamp(&self, t_s: f64) -> ClampSample {
        sample(t_s, self.at_m, GRIP_M, self.direction(), self.turn)
    }

    /// A marker at `[x, z]` in the clamp frame, `free_m` along the free cable.
    fn marker(&self, t_s: f64, label: &str, free_m: f64, [x, z]: [f64; 2]) -> MarkerSample {
        MarkerSample {
            t_s,
            marker: label.to_owned(),
            s_m: GRIP_M + free_m,
            position_m: (self.at_m + self.turn * Vector3::new(x, 0.0, z)).into(),
        }
    }

    /// Middle and end of a cable whose tangent angle is θ₀ s + θ₁ s²/2 over the share s of its length.
    fn fitted(&self, t_s: f64, cable: &Cable, theta: [f64; 2]) -> [MarkerSample; 2] {
        let at = |share: f64| affine_point(cable.free_m, theta, share);
        let half = 0.5 * cable.free_m;
        [
            self.marker(t_s, "mid", half, at(0.5)),
            self.marker(t_s, "end", cable.free_m, at(1.0)),
        ]
    }
}

/// (x, z) in the clamp frame at arc share `share`: x = -L ∫ sin, z = -L ∫ cos, by Simpson's rule.
fn affine_point(free_m: f64, theta: [f64; 2], share: f64) -> [f64; 2] {
    const INTERVALS: usize = 200;
    let mut sum = [0.0; 2];
    for k in 0..=INTERVALS {
        let s = share * k as f64 / INTERVALS as f64;
        let weight = match k {
            0 | INTERVALS => 1.0,
            _ if k % 2 == 1 => 4.0,
            _ => 2.0,
        };
        let (sin, cos) = (theta[0] * s + 0.5 * theta[1] * s * s).sin_cos();
        sum[0] += weight * sin;
        sum[1] += weight * cos;
    }
    sum.map(|total| -free_m * total * share / (3.0 * INTERVALS as f64))
}

fn poses(dir: &Path, cable: &Cable) -> Result<Demo, DemoError> {
    let columns = ["Gamma", "X_mid", "Z_mid", "X_end", "Z_end", "Theta0", "Theta1"];
    let table = Table::read(&dir.join(format!("equilibria_{}.csv", cable.name)), &columns, &[])?;
    let (mut clamp, mut markers) = (Vec::new(), Vec::new());
    for row in 0..table.len() {
        let t_s = row as f64;
        let base = Base::new([0.0, 0.0], table.number(row, "Gamma")?);
        clamp.push(base.clamp(t_s));
        let seen = |x: &str, z: &str| Ok::<_, DemoError>([table.number(row, x)?, table.number(row, z)?]);
        markers.push(base.marker(t_s, "mid", 0.5 * cable.free_m, seen("X_mid", "Z_mid")?));
        markers.push(base.marker(t_s, "end", cable.free_m, seen("X_end", "Z_end")?));
    }
    let kind = Kind {
        suffix: "poses",
        scene: SceneKind::Static,
        start: StartState::Straight,
        noise_m: POSE_NOISE_M,
        what: "static poses under turned clamps, markers seen by one camera",
    };
    Ok(demo(cable, &kind, clamp, markers))
}

fn swing(dir: &Path, cable: &Cable) -> Result<Demo, DemoError> {
    let columns = ["ts", "X", "Z", "Phi", "Theta0", "Theta1"];
    let table = Table::read(&dir.join(format!("swing_{}.csv", cable.name)), &columns, &[])?;
    // The base stands still; its record only jitters.
    let mean = |column: &str| -> Result<f64, DemoError> {
        let sum: Result<f64, DemoError> = (0..table.len()).map(|row| table.number(row, column)).sum();
        Ok(sum? / table.len() as f64)
    };
    let base = Base::new([mean("X")?, mean("Z")?], mean("Phi")?);
    let mut markers = Vec::new();
    for row in 0..table.len() {
        let theta = [table.number(row, "Theta0")?, table.number(row, "Theta1")?];
        markers.extend(base.fitted(table.number(row, "ts")?, cable, theta));
    }
    let last = markers[markers.len() - 1].t_s;
    let kind = Kind {
        suffix: "swing",
        scene: SceneKind::Free,
        start: StartState::Moving,
        noise_m: fit_noise_m(cable),
        what: "free swing after release, points of the source's curvature fit, base at its mean pose",
    };
    Ok(demo(
        cable,
        &kind,
        vec![base.clamp(0.0), base.clamp(last)],
        markers,
    ))
}

fn driven(file: &Path, cable: &Cable) -> Result<Demo, DemoError> {
    let columns = ["ts", "X", "Z", "Phi", "Theta0", "Theta1", "Fx", "Fz", "Ty"];
    let table = Table::read(file, &columns, &[])?;
    let (mut clamp, mut markers) = (Vec::new(), Vec::new());
    for row in 0..table.len() {
        let t_s = table.number(row, "ts")?;
        let at_m = [table.number(row, "X")?, table.number(row, "Z")?];
        let base = Base::new(at_m, table.number(row, "Phi")?);
        clamp.push(base.clamp(t_s));
        let theta = [table.number(row, "Theta0")?, table.number(row, "Theta1")?];
        markers.extend(base.fitted(t_s, cable, theta));
    }
    let kind = Kind {
        suffix: "driven",
        scene: SceneKind::Free,
        start: StartState::Rest,
        noise_m: fit_noise_m(cable),
        what: "swing driven by the robot, points of the source's curvature fit",
    };
    Ok(demo(cable, &kind, clamp, markers))
}

fn fit_noise_m(cable: &Cable) -> f64 {
    if cable.name == LONG {
        FIT_NOISE_LONG_M
    } else {
        FIT_NOISE_M
    }
}

struct Kind {
    suffix: &'static str,
    scene: SceneKind,
    start: StartState,
    noise_m: f64,
    what: &'static str,
}

fn demo(cable: &Cable, kind: &Kind, clamp: Vec<ClampSample>, markers: Vec<MarkerSample>) -> Demo {
    let turn = clamp[0].turn();
    let length_m = cable.free_m + GRIP_M;
    let grip = ClampSpec {
        end: RopeEnd::Start,
        grip_m: GRIP_M,
        direction: None,
    };
    let source = Source {
        name: format!("{}-{}", cable.name.replace('_', "-"), kind.suffix),
        scene: kind.scene,
        start: kind.start,
        noise_m: kind.noise_m,
        planar: true,
        notes: format!(
            "{}: {} (PAC_model_matlab). Masses, free length {} m and diameter measured by the source; noise_m \
                 and the 20 mm of cable inside the clamp are assumed.",
            cable.name, kind.what, cable.free_m
        ),
        rope: RopeSpec {
            length_m,
            diameter_m: cable.diameter_m,
            mass_kg: cable.mass_kg * length_m / cable.free_m,
            direction: (turn * -Vector3::z()).into(),
            end_mass_kg: cable.end_mass_kg,
            roll_rad: 0.0,
            assumed: Vec::new(),
        },
        clamps: vec![(grip, clamp)],
        markers,
    };
    source.demo()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// θ₁ = 0: an arc of a circle, whose end is known.
    #[test]
    fn a_constant_curvature_gives_an_arc() {
        let [x, z] = affine_point(0.6, [1.2, 0.0], 1.0);
        let radius = 0.6 / 1.2;
        assert!((x + radius * (1.0 - 1.2f64.cos())).abs() < 1e-9);
        assert!((z + radius * 1.2f64.sin()).abs() < 1e-9);
    }

    /// Turned clockwise by 90°, the clamp's straight cable points to -x, seen with x right and z up.
    #[test]
    fn a_positive_angle_turns_clockwise() {
        let base = Base::new([0.0, 0.0], std::f64::consts::FRAC_PI_2);
        let end = base.marker(0.0, "end", 0.4, [0.0, -0.4]);
        assert!((end.position_m[0] + 0.4).abs() < 1e-12 && end.position_m[2].abs() < 1e-12);
    }
}
