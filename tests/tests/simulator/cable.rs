//! A clamped cable, and its poses at rest as the elastica says that they are.

use offline::demo::{
    ClampSample, ClampSpec, Demo, DemoSpec, FORMAT, MarkerSample, Observations, RopeEnd, RopeSpec, SceneKind,
    StartState,
};
use offline::observe::bracket;
use tests::elastica::Elastica;

const G: f64 = 9.81;
/// Length of rope in the clamp, m.
pub const GRIP_M: f64 = 0.02;

/// A rope of which the near end is clamped with each of `tilts` between its tangent and the horizontal.
pub struct Rope {
    pub free_m: f64,
    pub diameter_m: f64,
    pub mass_per_length_kg_m: f64,
    pub end_mass_kg: f64,
    pub young_pa: f64,
}

impl Rope {
    pub fn bending_n_m2(&self) -> f64 {
        self.young_pa * std::f64::consts::PI * self.diameter_m.powi(4) / 64.0
    }

    pub fn elastica(&self, start_angle: f64) -> Elastica {
        Elastica {
            length_m: self.free_m,
            bending_n_m2: self.bending_n_m2(),
            weight_n_m: G * self.mass_per_length_kg_m,
            end_weight_n: G * self.end_mass_kg,
            start_angle,
            far_clamp: None,
        }
    }

    pub fn spec(&self, length_m: f64, clamps: Vec<ClampSpec>, start_angle: f64) -> DemoSpec {
        DemoSpec {
            format: FORMAT.to_owned(),
            scene: SceneKind::Static,
            noise_m: 0.001,
            planar: false,
            notes: String::new(),
            start: StartState::Straight,
            rope: RopeSpec {
                length_m,
                diameter_m: self.diameter_m,
                mass_kg: self.mass_per_length_kg_m * length_m,
                direction: [start_angle.cos(), 0.0, start_angle.sin()],
                end_mass_kg: self.end_mass_kg,
                roll_rad: 0.0,
                assumed: Vec::new(),
            },
            table: None,
            clamps,
            cameras: Vec::new(),
        }
    }

    /// Poses of a rope clamped at its start, one per angle, seen at `seen` shares of the free length.
    pub fn poses(&self, angles: &[f64], seen: &[f64]) -> Demo {
        let (mut clamp, mut markers) = (Vec::new(), Vec::new());
        for (k, &angle) in angles.iter().enumerate() {
            let t_s = k as f64;
            let (sin, cos) = angle.sin_cos();
            let half = 0.5 * (angles[0] - angle);
            clamp.push(ClampSample {
                t_s,
                position_m: [-GRIP_M * cos, 0.0, -GRIP_M * sin],
                quaternion_xyzw: [0.0, half.sin(), 0.0, half.cos()],
                closed: true,
            });
            let points = self.elastica(angle).points_m(|_| angle);
            markers.extend(markers_on(&points, t_s, self.free_m, seen));
        }
        let clamps = vec![ClampSpec {
            end: RopeEnd::Start,
            grip_m: GRIP_M,
            direction: None,
        }];
        Demo {
            name: "poses".into(),
            spec: self.spec(self.free_m + GRIP_M, clamps, angles[0]),
            clamps: vec![clamp],
            commanded: vec![None],
            observations: Observations::Markers(markers),
        }
    }
}

pub fn markers_on(points: &[[f64; 2]], t_s: f64, free_m: f64, seen: &[f64]) -> Vec<MarkerSample> {
    let arcs: Vec<f64> = (0..points.len())
        .map(|i| free_m * i as f64 / (points.len() - 1) as f64)
        .collect();
    seen.iter()
        .map(|share| {
            let s = share * free_m;
            let (low, part) = bracket(&arcs, s);
            let at = |k: usize| points[low][k] * (1.0 - part) + points[low + 1][k] * part;
            MarkerSample {
                t_s,
                marker: format!("{share}"),
                s_m: GRIP_M + s,
                position_m: [at(0), 0.0, at(1)],
            }
        })
        .collect()
}

/// A cable as in `pac_cables`, with a shorter free end to save time.
pub const CABLE: Rope = Rope {
    free_m: 0.3,
    diameter_m: 0.02,
    mass_per_length_kg_m: 1.0,
    end_mass_kg: 0.03,
    young_pa: 2.0e6,
};
