//! What the material and the world do to the rope: base coefficients, and lists of laws that
//! effects append to. The passes of a step walk these lists and know no effect by name.

use super::clamp::PathShift;
use super::elastic::Lame;
use super::real::Real;
use super::rope::RopeLayout;
use super::tensor::{Mat3, Vec3};

/// Standard acceleration of free fall, m/s² (CGPM 1901, rounded).
pub const GRAVITY_M_S2: f64 = 9.81;

/// A pose as seven numbers: position (m) and quaternion (x, y, z, w).
pub type Pose<T> = [T; 7];

/// State of a particle that a stress law may use.
pub struct StressPoint<'a, T> {
    /// Deformation gradient.
    pub deformation_gradient: &'a Mat3<T>,
    /// Velocity gradient, 1/s.
    pub velocity_gradient: &'a Mat3<T>,
    /// Its determinant J.
    pub volume_ratio: T,
    /// Elastic moduli.
    pub lame: &'a Lame<T>,
}

/// State of a particle that a force law may use.
pub struct ForcePoint<T> {
    /// Position, m.
    pub position_m: Vec3<T>,
    /// Velocity, m/s.
    pub velocity_m_s: Vec3<T>,
    /// Unit tangent of the deformed rope.
    pub tangent: Vec3<T>,
    /// Length of rope that this particle stands for, m.
    pub length_m: f64,
    /// Diameter of the rope, m.
    pub diameter_m: f64,
    /// Mass of the particle, kg.
    pub mass_kg: T,
}

/// A stress besides elasticity.
pub trait StressLaw<T: Real>: Send + Sync {
    /// Additional Kirchhoff stress, Pa.
    fn kirchhoff_pa(&self, point: &StressPoint<T>) -> Mat3<T>;
    /// Largest viscosity, Pa s: explicit viscosity bounds the time step.
    fn viscosity_pa_s(&self, lame: &Lame<T>) -> f64;
}

/// A force on the rope besides weight and contact.
pub trait ForceLaw<T: Real>: Send + Sync {
    /// Force on one particle, N.
    fn force_n(&self, point: &ForcePoint<T>) -> Vec3<T>;
}

/// A change of the distribution of mass.
pub trait MassLaw<T: Real>: Send + Sync {
    /// Changes the particle masses, kg, in place; called once before the first step.
    fn change_masses_kg(&self, layout: &RopeLayout, masses_kg: &mut [T]);
}

/// A difference between the recorded path of a clamp and where the clamp really is.
pub trait PathLaw<T: Real>: Send + Sync {
    /// Real pose minus recorded pose at time `t_s`; `recorded` gives the pose at any time.
    fn offset(&self, recorded: &dyn Fn(T) -> Pose<T>, t_s: T) -> Pose<T>;
}

/// A force on the rope that nobody explains, constant within blocks of time and within slices.
#[derive(Clone, Debug, PartialEq)]
pub struct ForceField<T> {
    /// Length of a block, s; the first starts at zero. After the last block there is no force.
    pub block_s: f64,
    /// Force per length of rope, N/m, by block and slice.
    pub force_n_m: Vec<Vec<Vec3<T>>>,
}

impl<T> ForceField<T> {
    /// The block in which a time lies.
    pub fn block(&self, t_s: f64) -> Option<usize> {
        let block = (t_s / self.block_s) as usize;
        (block < self.force_n_m.len()).then_some(block)
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
    /// Stresses besides elasticity.
    pub stress_laws: Vec<Box<dyn StressLaw<T>>>,
    /// Forces besides weight and contact.
    pub force_laws: Vec<Box<dyn ForceLaw<T>>>,
    /// Changes of mass.
    pub mass_laws: Vec<Box<dyn MassLaw<T>>>,
    /// Errors of the clamp paths.
    pub path_laws: Vec<Box<dyn PathLaw<T>>>,
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
            stress_laws: Vec::new(),
            force_laws: Vec::new(),
            mass_laws: Vec::new(),
            path_laws: Vec::new(),
            path_shifts: Vec::new(),
            force_field: None,
        }
    }

    /// Elastic moduli.
    pub fn lame(&self) -> Lame<T> {
        Lame::new(self.young_pa, self.poisson)
    }
}
