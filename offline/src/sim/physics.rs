//! What the material and the world do to the rope: base coefficients, and lists of laws that
//! effects append to. The passes of a step walk these lists and know no effect by name.

use super::clamp::PathShift;
use super::elastic::Lame;
use super::real::{Arithmetic, Real};
use super::recorded::Recorded;
use super::rope::{RopeLayout, RopeShape};
use super::tensor::{Mat3, Vec3, add, direction, scaled, zero3};

/// Standard acceleration of free fall, m/s² (CGPM 1901, rounded).
pub const GRAVITY_M_S2: f64 = 9.81;

/// Loss of a rope's material where nothing else is said: see [`Physics::loss`]. A rope of 1 MPa that is
/// 14 mm thick has a retardation time of 0.1 ms; its first swings lose a thousandth per period by it.
pub const LOSS: f64 = 0.2;

/// A pose as seven numbers: position (m) and quaternion (x, y, z, w).
pub type Pose<T> = [T; 7];

/// State of a piece of rope that a force law may use: the mean over the particles of a slice. Such laws know the
/// slender rope, not the places in its section.
pub struct ForcePoint<T> {
    /// Position, m.
    pub position_m: Vec3<T>,
    /// Velocity, m/s.
    pub velocity_m_s: Vec3<T>,
    /// Unit tangent of the deformed rope.
    pub tangent: Vec3<T>,
    /// Length of the piece, m.
    pub length_m: f64,
    /// Diameter of the rope, m.
    pub diameter_m: f64,
    /// Mass of the piece, kg.
    pub mass_kg: T,
}

/// Mean motion of the particles of a slice, which is what the laws of a slender rope know of it; or that of one.
#[derive(Clone, Copy, Debug)]
pub struct SliceMotion<T> {
    /// Position, m.
    pub position_m: Vec3<T>,
    /// Velocity, m/s.
    pub velocity_m_s: Vec3<T>,
    /// F e_s, the first column of the deformation gradient.
    pub axis: Vec3<T>,
    /// Mass, kg.
    pub mass_kg: T,
}

impl<T> SliceMotion<T> {
    /// The same with every number replaced.
    pub fn map<U>(self, mut number: impl FnMut(T) -> U) -> SliceMotion<U> {
        SliceMotion {
            position_m: self.position_m.map(&mut number),
            velocity_m_s: self.velocity_m_s.map(&mut number),
            axis: self.axis.map(&mut number),
            mass_kg: number(self.mass_kg),
        }
    }
}

// Loops, not closures: see `elastic.rs`.
impl<T: Arithmetic> SliceMotion<T> {
    /// No mass, at the origin.
    #[inline(always)]
    pub fn zero() -> Self {
        Self {
            position_m: zero3(),
            velocity_m_s: zero3(),
            axis: zero3(),
            mass_kg: T::zero(),
        }
    }

    /// The mean of some.
    #[inline(always)]
    pub fn mean(members: impl ExactSizeIterator<Item = Self>) -> Self {
        let share = 1.0 / members.len() as f64;
        let mut sum = Self::zero();
        for member in members {
            sum.position_m = add(sum.position_m, member.position_m);
            sum.velocity_m_s = add(sum.velocity_m_s, member.velocity_m_s);
            sum.axis = add(sum.axis, member.axis);
            sum.mass_kg += member.mass_kg;
        }
        Self {
            position_m: scaled(sum.position_m, share),
            velocity_m_s: scaled(sum.velocity_m_s, share),
            axis: scaled(sum.axis, share),
            mass_kg: sum.mass_kg.scale(share),
        }
    }
}

impl<T: Real> ForcePoint<T> {
    /// A piece of rope, `length_m` long, that moves like its slice.
    pub fn new(motion: &SliceMotion<T>, length_m: f64, diameter_m: f64) -> Self {
        Self {
            position_m: motion.position_m,
            velocity_m_s: motion.velocity_m_s,
            tangent: direction(motion.axis),
            length_m,
            diameter_m,
            mass_kg: motion.mass_kg,
        }
    }
}

/// A stress along the rope's axis that grows with the cube of the strain: see [`super::axial`].
pub trait AxialLaw<T: Real>: Send + Sync {
    /// Its coefficient k, Pa.
    fn cubic_pa(&self, lame: &Lame<T>) -> T;
}

/// A spring and a dashpot in series beside the elastic solid, with its elastic constants (Maxwell): a stress that follows
/// the rate of strain with a delay, S = 2 μ' E' + λ' tr(E') I, where E' follows the rate of the Green strain with the
/// delay. It is zero at the start.
pub struct Maxwell<T> {
    /// Modulus of the spring over the solid's.
    pub share: T,
    /// Relaxation time, s: the delay.
    pub time_s: T,
}

impl<T: Real> Maxwell<T> {
    /// Viscosities μ' and λ' while the strain changes slowly against the delay, Pa s.
    pub fn viscosity(&self, lame: &Lame<T>) -> Lame<T> {
        lame.times(self.share * self.time_s)
    }

    /// Moduli while it changes quickly, Pa. The law is stable in a step that is stable for either.
    pub fn quick(&self, lame: &Lame<T>) -> Lame<T> {
        lame.times(self.share)
    }
}

/// A stress-free shape other than straight.
pub trait ShapeLaw<T: Real>: Send + Sync {
    /// Curvature of the stress-free rope at an arc length toward the (side, up) of its first frame, 1/m.
    fn curvature_per_m(&self, arc_m: f64) -> [T; 2];
}

/// The stress-free shape of a rope that was rolled about its axis.
struct Rolled<T> {
    rope: Box<dyn ShapeLaw<T>>,
    sin: f64,
    cos: f64,
}

impl<T: Real> ShapeLaw<T> for Rolled<T> {
    fn curvature_per_m(&self, arc_m: f64) -> [T; 2] {
        let [side, up] = self.rope.curvature_per_m(arc_m);
        [
            side.scale(self.cos) - up.scale(self.sin),
            side.scale(self.sin) + up.scale(self.cos),
        ]
    }
}

/// A bending stiffness other than that of the solid section.
pub trait BendingLaw<T: Real>: Send + Sync {
    /// Changes the bending stiffness of every slice, as a multiple of the solid section's, in place;
    /// called once before the first step.
    fn change_stiffness(&self, layout: &RopeLayout, stiffness: &mut [T]);
}

/// A permanent change of the stress-free shape.
pub trait FlowLaw<T: Real>: Send + Sync {
    /// Frobenius norm of FᵀF − I, of an elastic deformation gradient F, below which nothing flows: cheap to tell.
    fn onset(&self) -> f64;
    /// The factor Y that brings an elastic deformation gradient F back to an admissible one, F Y;
    /// none where F is admissible.
    fn relaxation(&self, elastic: &Mat3<T>) -> Option<Mat3<T>>;
}

/// A force on the rope besides weight and contact.
pub trait ForceLaw<T: Real>: Send + Sync {
    /// Force on a piece of rope, N, in proportion to its length and mass.
    fn force_n(&self, point: &ForcePoint<T>) -> Vec3<T>;
}

/// A change of the distribution of mass.
pub trait MassLaw<T: Real>: Send + Sync {
    /// Changes the particle masses, kg, in place; called once before the first step.
    fn change_masses_kg(&self, layout: &RopeLayout, masses_kg: &mut [T]);
}

/// A difference between the recorded path of a clamp and where the clamp really is.
pub trait PathLaw<T: Real>: Send + Sync {
    /// Real pose minus recorded pose at time `t_s`.
    fn offset(&self, recorded: &Recorded<T>, t_s: f64) -> Pose<T>;
}

/// A difference between the rope and what the cameras report of it.
pub trait ObservationLaw<T: Real>: Send + Sync {
    /// What the cameras' clock shows above the robot's, s.
    fn clock_offset_s(&self) -> T {
        T::zero()
    }
    /// Where a point seems to be minus where it is, m; `pivot_m` is where the rope's start was first.
    fn displacement_m(&self, _point_m: Vec3<T>, _pivot_m: [f64; 3]) -> Vec3<T> {
        zero3()
    }
}

/// A force on the rope that nobody explains, constant within blocks of time and within slices.
#[derive(Clone, Debug, PartialEq)]
pub struct ForceField<T> {
    /// Length of a block, s; the first starts at zero. After the last block there is no force.
    pub block_s: f64,
    /// Force per length of rope, N/m, by block and slice; without slices there is none in a block.
    pub force_n_m: Vec<Vec<Vec3<T>>>,
}

impl<T> ForceField<T> {
    /// The block in which a time lies, if there is a force in it.
    pub fn block(&self, t_s: f64) -> Option<usize> {
        let block = (t_s / self.block_s) as usize;
        self.force_n_m
            .get(block)
            .filter(|force| !force.is_empty())
            .map(|_| block)
    }
}

/// All coefficients and laws of one simulation.
pub struct Physics<T> {
    /// Young's modulus, Pa.
    pub young_pa: T,
    /// Poisson's ratio.
    pub poisson: T,
    /// Acceleration of free fall, m/s².
    pub gravity_m_s2: Vec3<T>,
    /// Coulomb coefficient between rope and table.
    pub friction: T,
    /// How much later than recorded grips open, s.
    pub release_delay_s: T,
    /// How far off its recorded direction the first grip holds a rope that hangs, toward (side, up) of the rope's first
    /// frame in it: tangents of half the angles. Nothing where no effect says so.
    pub grip_tilt: Option<[T; 2]>,
    /// By how much the pads of every grip let the rope turn with its moment, rad/(N m).
    pub grip_compliance: Option<T>,
    /// Retardation time of the material over the time that a pressure wave takes across the rope. It
    /// damps every rope alike, whatever its stiffness and its grid, and hardly what cameras see.
    pub loss: f64,
    /// Stresses along the axis besides elasticity.
    pub axial_laws: Vec<Box<dyn AxialLaw<T>>>,
    /// Stresses with a memory.
    pub memory_laws: Vec<Maxwell<T>>,
    /// Forces besides weight and contact.
    pub force_laws: Vec<Box<dyn ForceLaw<T>>>,
    /// Changes of mass.
    pub mass_laws: Vec<Box<dyn MassLaw<T>>>,
    /// Errors of the clamp paths.
    pub path_laws: Vec<Box<dyn PathLaw<T>>>,
    /// Stress-free shapes; their curvatures add.
    pub shape_laws: Vec<Box<dyn ShapeLaw<T>>>,
    /// Changes of the bending stiffness.
    pub bending_laws: Vec<Box<dyn BendingLaw<T>>>,
    /// Permanent changes of shape.
    pub flow_laws: Vec<Box<dyn FlowLaw<T>>>,
    /// Errors of the cameras.
    pub observation_laws: Vec<Box<dyn ObservationLaw<T>>>,
    /// Changes of the scene's recorded paths, at most one per grip.
    pub path_shifts: Vec<PathShift<T>>,
    /// A force given along rope and time.
    pub force_field: Option<ForceField<T>>,
}

impl<T: Real> Physics<T> {
    /// An elastic rope in gravity on a table, without any effect.
    pub fn base(young_pa: T, poisson: T, friction: T) -> Self {
        Self {
            young_pa,
            poisson,
            gravity_m_s2: [T::zero(), T::zero(), T::of(-GRAVITY_M_S2)],
            friction,
            release_delay_s: T::zero(),
            grip_tilt: None,
            grip_compliance: None,
            loss: LOSS,
            axial_laws: Vec::new(),
            memory_laws: Vec::new(),
            force_laws: Vec::new(),
            mass_laws: Vec::new(),
            path_laws: Vec::new(),
            shape_laws: Vec::new(),
            bending_laws: Vec::new(),
            flow_laws: Vec::new(),
            observation_laws: Vec::new(),
            path_shifts: Vec::new(),
            force_field: None,
        }
    }

    /// Whether a law knows more than the state of one particle: slices, a shape at rest or the past.
    pub fn changes_material(&self) -> bool {
        !(self.shape_laws.is_empty()
            && self.flow_laws.is_empty()
            && self.bending_laws.is_empty()
            && self.memory_laws.is_empty())
    }

    /// Whether the material remembers how it came to where it is.
    pub fn remembers(&self) -> bool {
        !(self.memory_laws.is_empty() && self.flow_laws.is_empty())
    }

    /// Whether it still does at rest, `rest_s` after it came there: what flowed for good, and what relaxes so slowly that
    /// more than e⁻¹⁰ of it is left.
    pub fn remembers_after(&self, rest_s: f64) -> bool {
        let slow = |law: &Maxwell<T>| law.share.value() != 0.0 && 10.0 * law.time_s.value() > rest_s;
        !self.flow_laws.is_empty() || self.memory_laws.iter().any(slow)
    }

    /// Rolls the rope about its axis before it is gripped, right-handed: what its material brings along
    /// turns with it.
    pub fn roll(&mut self, roll_rad: f64) {
        if roll_rad == 0.0 {
            return;
        }
        let (sin, cos) = libm::sincos(roll_rad);
        let laws = std::mem::take(&mut self.shape_laws).into_iter();
        let rolled = |rope| -> Box<dyn ShapeLaw<T>> { Box::new(Rolled { rope, sin, cos }) };
        self.shape_laws = laws.map(rolled).collect();
    }

    /// What the cameras' clock shows above the robot's, s.
    pub fn clock_offset_s(&self) -> T {
        let mut sum = T::zero();
        for law in &self.observation_laws {
            sum += law.clock_offset_s();
        }
        sum
    }

    /// Sum of the force laws at a piece of rope, N.
    pub fn force_n(&self, point: &ForcePoint<T>) -> Vec3<T> {
        let laws = self.force_laws.iter();
        laws.fold(zero3(), |sum, law| add(sum, law.force_n(point)))
    }

    /// Sum of the axial laws' coefficients, Pa; none where there is no law.
    pub fn cubic_pa(&self, lame: &Lame<T>) -> Option<T> {
        let coefficients = self.axial_laws.iter().map(|law| law.cubic_pa(lame));
        coefficients.reduce(|sum, k| sum + k)
    }

    /// Elastic moduli.
    pub fn lame(&self) -> Lame<T> {
        Lame::new(self.young_pa, self.poisson)
    }

    /// Retardation time of a rope's material, s.
    pub fn retardation_s(&self, rope: &RopeShape) -> T {
        let slowness = (T::of(rope.density_kg_m3()) / self.lame().p_wave_modulus()).sqrt();
        slowness.scale(self.loss * rope.diameter_m)
    }

    /// Viscosities of a rope's material, Pa s: the moduli times its retardation time.
    pub fn viscosity(&self, rope: &RopeShape) -> Lame<T> {
        self.lame().times(self.retardation_s(rope))
    }
}
