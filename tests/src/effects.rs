//! What a world may do beyond what is declared about it: each effect is off at zero.

use nalgebra::{Rotation3, Unit, Vector3};

/// Density of air at 20 °C, kg/m³.
const AIR_KG_M3: f64 = 1.204;

/// Undeclared physics of a world; the default has none.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WorldEffects {
    /// Mass of a thing fixed to the rope's end (s = length), kg.
    pub tip_mass_kg: f64,
    /// Tilt of the table and the robot against gravity, about world y and then about x, rad.
    /// Positive values make gravity pull towards −x and +y.
    pub tilt_rad: [f64; 2],
    /// Quadratic air drag, coefficient across the rope (a cylinder has about 1.1).
    pub drag_normal: f64,
    /// Quadratic air drag, coefficient along the rope.
    pub drag_tangential: f64,
    /// Linear drag: force is −rate · mass · velocity, 1/s.
    pub drag_linear_per_s: f64,
    /// Steady wind, seen by the drag terms, m/s.
    pub wind_m_s: [f64; 3],
    /// Retardation time of the material (Kelvin-Voigt), s.
    pub damping_s: f64,
    /// What is added to the table's declared friction coefficient.
    pub friction_change: f64,
    /// Relative slope of the mass per length: (1 + slope (s/L − 1/2)).
    pub density_slope: f64,
    /// The clamps follow their commanded path with a first-order lag, s; the command is recorded.
    pub gripper_lag_s: f64,
    /// What the camera's clock shows above the robot's, s.
    pub clock_offset_s: f64,
    /// Error in the declared position of the first camera, m.
    pub camera_offset_m: [f64; 3],
    /// Error of all cameras together about the rope's first place: what they see is shifted, m.
    pub rig_shift_m: [f64; 3],
    /// And turned, rotation vector, rad.
    pub rig_turn_rad: [f64; 3],
    /// Natural curvature in the plane of x and z, 1/m; upwards for a rope along x.
    pub rest_curvature_per_m: f64,
    /// By how much that grows along the rope, 1/m².
    pub curvature_growth_per_m2: f64,
    /// Bending stiffness beyond what E says, as a share of it; stretching stays.
    pub bending_change: f64,
    /// Coefficient c of a stress E ε (1 + c ε²).
    pub stiffening: f64,
    /// Clamps open so much later than recorded, s.
    pub release_delay_s: f64,
    /// Clamps turn with the bending moment at their mouth, rad per N m.
    pub clamp_compliance: f64,
    /// A fan: air moves only inside a ball.
    pub air_jet: Option<AirJet>,
    /// The rope slides out of the first clamp, once.
    pub grip_slip: Option<GripSlip>,
    /// A piece of the rope is stiffer.
    pub stiff_piece: Option<StiffPiece>,
}

/// A local jet of air with a Gaussian profile; it drags the rope with coefficient 1.1 across.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AirJet {
    /// Centre, m.
    pub centre_m: [f64; 3],
    /// Standard deviation of the profile, m.
    pub radius_m: f64,
    /// Velocity at the centre, m/s.
    pub velocity_m_s: [f64; 3],
}

/// Rope slides out of the first clamp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GripSlip {
    /// When it starts, s.
    pub at_s: f64,
    /// How long it lasts, s.
    pub for_s: f64,
    /// How far the gripped piece moves, out of the clamp towards the free rope, m.
    pub by_m: f64,
}

/// A piece that bends less (tape, a knot).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StiffPiece {
    /// Where it starts, m.
    pub from_m: f64,
    /// Where it ends, m.
    pub to_m: f64,
    /// Bending stiffness as a multiple of the rope's.
    pub factor: f64,
}

impl WorldEffects {
    /// Gravity in the frame of the table, m/s².
    pub fn gravity(&self) -> Vector3<f64> {
        let about_y = Rotation3::from_axis_angle(&Unit::new_unchecked(Vector3::y()), self.tilt_rad[0]);
        let about_x = Rotation3::from_axis_angle(&Unit::new_unchecked(Vector3::x()), self.tilt_rad[1]);
        about_x * (about_y * Vector3::new(0.0, 0.0, -9.81))
    }

    /// Where the cameras, as a whole, make a point appear; `pivot_m` is the rope's first place.
    pub fn seen_at(&self, point_m: [f64; 3], pivot_m: [f64; 3]) -> [f64; 3] {
        // Bit for bit where nothing is wrong with the cameras.
        if self.rig_turn_rad == [0.0; 3] && self.rig_shift_m == [0.0; 3] {
            return point_m;
        }
        let pivot = Vector3::from(pivot_m);
        let turned = Rotation3::new(Vector3::from(self.rig_turn_rad)) * (Vector3::from(point_m) - pivot);
        (pivot + turned + Vector3::from(self.rig_shift_m)).into()
    }

    /// Whether anything acts on the rope through the air.
    pub fn has_air(&self) -> bool {
        let coefficients = [self.drag_normal, self.drag_tangential, self.drag_linear_per_s];
        coefficients.iter().any(|c| *c != 0.0) || self.air_jet.is_some()
    }

    /// Force of the air on a piece of rope, N.
    ///
    /// Quadratic drag per length is ρ/2 d C |u| u across and ρ/2 π d C |u| u along (Taylor 1952),
    /// with u the air's velocity against the rope's.
    pub fn air_force(&self, piece: &Piece) -> Vector3<f64> {
        let wind = Vector3::from(self.wind_m_s);
        let still = quadratic(
            piece,
            &(wind - piece.velocity),
            self.drag_normal,
            self.drag_tangential,
        );
        let linear = (wind - piece.velocity) * (self.drag_linear_per_s * piece.mass_kg);
        let jet = self.air_jet.map_or(Vector3::zeros(), |jet| {
            let away = (piece.position - Vector3::from(jet.centre_m)).norm() / jet.radius_m;
            let air = Vector3::from(jet.velocity_m_s) * (-0.5 * away * away).exp();
            let with_jet = quadratic(piece, &(air - piece.velocity), 1.1, 0.0);
            with_jet - quadratic(piece, &-piece.velocity, 1.1, 0.0)
        });
        still + linear + jet
    }
}

/// A short piece of rope in the air.
#[derive(Clone, Copy, Debug)]
pub struct Piece {
    /// Where it is, m.
    pub position: Vector3<f64>,
    /// How it moves, m/s.
    pub velocity: Vector3<f64>,
    /// Unit tangent.
    pub tangent: Vector3<f64>,
    /// Length, m.
    pub length_m: f64,
    /// Diameter, m.
    pub diameter_m: f64,
    /// Mass, kg.
    pub mass_kg: f64,
}

fn quadratic(piece: &Piece, air: &Vector3<f64>, normal: f64, tangential: f64) -> Vector3<f64> {
    let along = piece.tangent * piece.tangent.dot(air);
    let across = air - along;
    let scale = 0.5 * AIR_KG_M3 * piece.diameter_m * piece.length_m;
    across * (scale * normal * across.norm())
        + along * (scale * std::f64::consts::PI * tangential * along.norm())
}
