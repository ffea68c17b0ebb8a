//! Stress along the rope's axis besides elasticity, cubic in the strain: the energy density k ε⁴/4 of the stretch
//! λ = 1 + ε = |F e_s| of the axis alone, so that P e_s = k ε³/λ F e_s, and P is zero across.

use super::lanes::Lanes;
use super::real::{Arithmetic, Real};
use super::tensor::{Mat3, Vec3, add, dot, mul};

/// Strain up to which the time step provides for the growing stiffness.
const DESIGN_STRAIN: f64 = 0.1;

/// Modulus that bounds the time step, Pa: the slope 3 k ε² at the largest strain that is provided for.
pub fn modulus_pa<T: Real>(cubic_pa: T) -> T {
    cubic_pa.scale(3.0 * DESIGN_STRAIN * DESIGN_STRAIN)
}

/// Energy density, J/m³; `axis` is F e_s.
pub fn energy_j_m3<T: Real>(axis: Vec3<T>, cubic_pa: T) -> T {
    let strain = dot(axis, axis).sqrt() - T::one();
    let square = strain * strain;
    (cubic_pa * square * square).scale(0.25)
}

/// First column of the first Piola-Kirchhoff stress, Pa; `axis` is F e_s.
pub fn piola_column<T: Arithmetic>(axis: Vec3<T>, cubic_pa: T) -> Vec3<T> {
    Stretched::new(axis).column(cubic_pa)
}

/// F e_s.
#[inline(always)]
pub fn axis<T: Arithmetic>(f: &Mat3<T>) -> Vec3<T> {
    [f[0][0], f[1][0], f[2][0]]
}

/// Adds to the first column of a matrix.
#[inline(always)]
pub fn add_column<T: Arithmetic>(m: &mut Mat3<T>, column: Vec3<T>) {
    for a in 0..3 {
        m[a][0] += column[a];
    }
}

/// What the stress at a stretch and its differential have in common.
#[derive(Clone, Copy)]
pub struct Stretched<T> {
    axis: Vec3<T>,
    /// ε³/λ.
    scale: T,
    /// Its slope over λ: (3 ε² − ε³/λ)/λ².
    slope: T,
}

impl<T: Arithmetic> Stretched<T> {
    /// At F e_s.
    #[inline(always)]
    pub fn new(axis: Vec3<T>) -> Self {
        let square = dot(axis, axis);
        let stretch = square.sqrt();
        let strain = stretch - T::one();
        let (inverse, strain_square) = (T::one() / stretch, strain * strain);
        let scale = strain_square * strain * inverse;
        Self {
            axis,
            scale,
            slope: (strain_square.scale(3.0) - scale) * inverse * inverse,
        }
    }

    /// First column of the first Piola-Kirchhoff stress, Pa.
    #[inline(always)]
    pub fn column(&self, cubic_pa: T) -> Vec3<T> {
        mul(self.axis, cubic_pa * self.scale)
    }
}

impl<L: Lanes> Stretched<L> {
    /// Its differential; the coefficient k comes with its own.
    #[inline(always)]
    pub fn change(&self, change: Vec3<L>, [cubic_pa, cubic_change_pa]: [L; 2]) -> Vec3<L> {
        let longer = dot(self.axis, change) * self.slope;
        let along = longer.times_plus(cubic_pa, cubic_change_pa * self.scale);
        add(mul(self.axis, along), mul(change, cubic_pa * self.scale))
    }
}
