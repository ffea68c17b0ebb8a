//! Grips whose pads give: how far the rope in a grip turns against it with its bending moment at the mouth.
//!
//! A grip's springs pull every particle in it to its place y = c + R r, with c the mouth of the grip and r where the
//! particle belongs from there ([`super::clamp`]). About the mouth they pull with the torque τ = Σ k (R r) × (x − y),
//! which is the rope's moment there: shear at the mouth has no arm. Pads turn the rope's places in the grip by
//! φ = C τ, so that the turn happens at the mouth, as a hinge with a spring there would. As τ depends on φ, both are
//! solved for together; nothing is remembered from step to step. Pads do not let the rope twist.
//!
//! In a step the places are those at its end, and so are the particles' as their velocities say: with the particles
//! where they were at its beginning the springs would brake what turns in the grip, by more the softer the pads are.

use super::clamp::RigidMotion;
use super::physics::Physics;
use super::real::Real;
use super::rope::RopeLayout;
use super::scene::Scene;
use super::tensor::{
    Mat3, Vec3, add, cross, direction, dot, matmul, matmul_transposed, matvec, mul, rotation_of_quaternion,
    scaled, sub, transpose, transpose_inverse, value3, zero3,
};

/// Steps of Newton's method to the turn: without pads' stiffness the error of the first goes with the cube of the turn.
const TURNS: usize = 3;

/// A particle in a grip.
struct Held<T> {
    /// Its slice, and which of its members it is.
    place: [usize; 2],
    /// Where it belongs, from the mouth, in the grip's first pose, m.
    from_mouth_m: [f64; 3],
    /// Stiffness of its spring, N/m.
    spring_n_m: T,
}

/// One grip.
struct Pad<T> {
    /// Its mouth, from the position of its first pose, m.
    mouth_m: [f64; 3],
    /// Direction of the rope in it, in its first pose.
    axis: [f64; 3],
    held: Vec<Held<T>>,
    /// Σ k (r² − r rᵀ), N m.
    stiffness_n_m: Mat3<T>,
}

/// How a closed grip turns with the torque of its springs, to first order.
pub struct Slope<H> {
    /// rad/(N m).
    pub turn_per_torque: Mat3<f64>,
    /// Slice and member of the particles in it, where each belongs from the mouth, m, and the stiffness of its spring, N/m.
    pub held: H,
}

/// The grips of a scene whose pads give.
pub struct Pads<T> {
    compliance_rad_per_n_m: T,
    grips: Vec<Pad<T>>,
}

impl<T: Real> Pads<T> {
    /// Those of a scene; none where pads are rigid. `clamp_per_kg` is the stiffness of the grips' springs over mass, 1/s².
    pub fn new(
        scene: &Scene,
        physics: &Physics<T>,
        (layout, masses_kg): (&RopeLayout, &[T]),
        clamp_per_kg: T,
    ) -> Option<Self> {
        let compliance_rad_per_n_m = physics.grip_compliance?;
        let mut grips: Vec<Pad<T>> = scene.hinges_m().into_iter().map(Pad::new).collect();
        for (p, &mass_kg) in masses_kg.iter().enumerate() {
            if let Some((grip, offset_m)) = scene.grip_offset(layout.material_m(p)) {
                let members = layout.section_m.len();
                grips[grip].hold([p / members, p % members], offset_m, mass_kg * clamp_per_kg);
            }
        }
        Some(Self {
            compliance_rad_per_n_m,
            grips,
        })
    }

    /// Turns the motion of every closed grip. `place_m` says where a member of a slice is, m.
    pub fn turn(&self, motions: &mut [Option<RigidMotion<T>>], place_m: impl Fn([usize; 2]) -> Vec3<T>) {
        for (pad, motion) in self.grips.iter().zip(motions) {
            if let Some(motion) = motion {
                *motion = pad.turned(motion, self.compliance_rad_per_n_m, &place_m);
            }
        }
    }

    /// How closed grips that were turned turn further.
    pub fn slopes<'a>(
        &'a self,
        turned: &'a [Option<RigidMotion<T>>],
    ) -> impl Iterator<Item = Slope<impl Iterator<Item = ([usize; 2], Vec3<f64>, f64)>>> {
        let closed = self.grips.iter().zip(turned);
        closed.filter_map(|(pad, motion)| {
            let rotation = motion.as_ref()?.rotation;
            let rotated = move |held: &Held<T>| {
                let arm_m = matvec(&rotation, held.from_mouth_m.map(T::of));
                (held.place, value3(arm_m), held.spring_n_m.value())
            };
            Some(Slope {
                turn_per_torque: pad
                    .turn_per_torque(&rotation, self.compliance_rad_per_n_m)
                    .map(value3),
                held: pad.held.iter().map(rotated),
            })
        })
    }
}

impl<T: Real> Pad<T> {
    /// Without particles.
    fn new([mouth_m, outer_m]: [[f64; 3]; 2]) -> Self {
        Self {
            mouth_m,
            axis: direction(sub(mouth_m, outer_m)),
            held: Vec::new(),
            stiffness_n_m: [zero3(); 3],
        }
    }

    fn hold(&mut self, place: [usize; 2], offset_m: [f64; 3], spring_n_m: T) {
        let r = sub(offset_m, self.mouth_m);
        for a in 0..3 {
            for b in 0..3 {
                let same = if a == b { dot(r, r) } else { 0.0 };
                self.stiffness_n_m[a][b] += spring_n_m.scale(same - r[a] * r[b]);
            }
        }
        self.held.push(Held {
            place,
            from_mouth_m: r,
            spring_n_m,
        });
    }

    /// (1 + C J)⁻¹ C with J the stiffness of the springs against a turn, about axes across the rope.
    fn turn_per_torque(&self, rotation: &Mat3<T>, compliance: T) -> Mat3<T> {
        let axis = matvec(rotation, self.axis.map(T::of));
        let columns = self.share_columns(rotation, compliance);
        transpose(&columns.map(|column| across(&axis, mul(column, compliance))))
    }

    /// Columns of (1 + C J)⁻¹.
    fn share_columns(&self, rotation: &Mat3<T>, compliance: T) -> Mat3<T> {
        let stiffness = matmul_transposed(&matmul(rotation, &self.stiffness_n_m), rotation);
        let mut slope = stiffness.map(|row| mul(row, compliance));
        for a in 0..3 {
            slope[a][a] += T::one();
        }
        transpose_inverse(&slope)
    }

    fn turned(
        &self,
        motion: &RigidMotion<T>,
        compliance: T,
        place_m: &impl Fn([usize; 2]) -> Vec3<T>,
    ) -> RigidMotion<T> {
        let mouth_m = motion.place(self.mouth_m);
        let axis = motion.turn(self.axis);
        // Σ k r (x − c)ᵀ: all that the torque needs of the particles.
        let mut pull: Mat3<T> = [zero3(); 3];
        for held in &self.held {
            let away = mul(sub(place_m(held.place), mouth_m), held.spring_n_m);
            for a in 0..3 {
                pull[a] = add(pull[a], scaled(away, held.from_mouth_m[a]));
            }
        }
        let mut turn = [T::zero(), T::zero(), T::zero(), T::one()];
        let mut rotation = motion.rotation;
        for _ in 0..TURNS {
            let p = matmul(&rotation, &pull);
            let torque = [p[1][2] - p[2][1], p[2][0] - p[0][2], p[0][1] - p[1][0]];
            let missing = sub(mul(torque, compliance), rotation_vector(turn));
            let share = transpose(&self.share_columns(&rotation, compliance));
            let change = matvec(&share, missing);
            turn = turned_by(turn, across(&axis, change));
            rotation = matmul(&rotation_of_quaternion(turn), &motion.rotation);
        }
        // The mouth stays; nothing changes, to the last bit, where nothing turns.
        let difference = std::array::from_fn(|a| sub(motion.rotation[a], rotation[a]));
        let back = matvec(&difference, self.mouth_m.map(T::of));
        RigidMotion {
            position_m: add(motion.position_m, back),
            rotation,
        }
    }
}

/// What of a vector is across an axis.
fn across<T: Real>(axis: &Vec3<T>, vector: Vec3<T>) -> Vec3<T> {
    sub(vector, mul(*axis, dot(*axis, vector)))
}

/// The turn of a unit quaternion (x, y, z, w), rad; to 0.2 % up to 1.5 rad.
fn rotation_vector<T: Real>([x, y, z, _]: [T; 4]) -> Vec3<T> {
    let v = [x, y, z];
    let s = dot(v, v);
    let series = T::one() + s.scale(1.0 / 6.0) + (s * s).scale(3.0 / 40.0) + (s * s * s).scale(15.0 / 336.0);
    mul(v, series.scale(2.0))
}

/// A unit quaternion turned further by a small vector, rad.
fn turned_by<T: Real>([x, y, z, w]: [T; 4], change: Vec3<T>) -> [T; 4] {
    let half = scaled(change, 0.5);
    let own = T::one() / (T::one() + dot(half, half)).sqrt();
    let (half, v) = (mul(half, own), [x, y, z]);
    let [a, b, c] = add(add(mul(half, w), mul(v, own)), cross(half, v));
    [a, b, c, own * w - dot(half, v)]
}
