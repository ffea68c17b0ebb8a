//! What the laws make of the rope's material: its stress-free shape, which plastic flow changes, and
//! the bending stiffness of its slices.
//!
//! **Stress-free shape.** A particle at the offset y from the axis of a rope whose natural curvature is
//! k is stress-free under G = diag(1 − k·y, 1, 1) in (s, side, up), up to a rotation: that is the exact
//! gradient of a twist-free rod of this curvature (Bishop 1975). The energy density is then ψ(F A) with
//! A = G⁻¹ per stress-free volume, so P = det(A)⁻¹ P_e(F A) Aᵀ. Plastic flow multiplies A (Lee 1969).
//!
//! **Bending stiffness.** The axial stretches λ = |F A e_s| of a slice's particles give its curvature
//! κ = −Σ y λ / Σ y² as a least-squares slope, whatever their mean is, so axial stiffness does not change. A
//! stiffness c E I in place of E I adds the energy (c − 1) E I κ²/2 per length. Both are functions of
//! the stretches alone, hence invariant to rotation.

use super::elastic::{Lame, piola_stress};
use super::physics::{BendingPoint, Mouth, Physics, StressPoint};
use super::real::Real;
use super::rope::RopeLayout;
use super::tensor::{
    Mat3, Vec3, add, det, dot, identity, matmul, matmul_transposed, mul, transpose_inverse,
};

/// State of the material, particle by particle and slice by slice. Lists are empty where nothing needs
/// them.
#[derive(Clone, Debug)]
pub struct Material<T> {
    /// A = G⁻¹ per particle.
    natural_inverse: Vec<Mat3<T>>,
    /// (c − 1) E per slice, Pa.
    bending_excess_pa: Vec<T>,
    /// Curvature κ per slice at the present step, 1/m.
    curvature: Vec<[T; 2]>,
    section_m: Vec<[f64; 2]>,
    /// Σ y² over a section's particles, along every axis, m².
    second_moment_m2: f64,
}

impl<T: Real> Material<T> {
    /// The material before the first step.
    pub fn new(physics: &Physics<T>, layout: &RopeLayout, mouths: &[Mouth]) -> Self {
        let mut material = Self {
            natural_inverse: Vec::new(),
            bending_excess_pa: Vec::new(),
            curvature: Vec::new(),
            section_m: layout.section_m.clone(),
            second_moment_m2: layout.section_m.iter().map(|y| y[0] * y[0]).sum(),
        };
        if !(physics.shape_laws.is_empty() && physics.flow_laws.is_empty()) {
            material.natural_inverse = natural_inverse(physics, layout);
        }
        if !physics.bending_laws.is_empty() {
            let radius = 0.5 * layout.shape.diameter_m;
            let point = BendingPoint {
                layout,
                mouths,
                solid_n_m2: physics.young_pa.scale(std::f64::consts::FRAC_PI_4 * radius.powi(4)),
            };
            let mut stiffness = vec![T::one(); layout.slices.len()];
            for law in &physics.bending_laws {
                law.change_stiffness(&point, &mut stiffness);
            }
            material.bending_excess_pa = stiffness
                .iter()
                .map(|&c| (c - T::one()) * physics.young_pa)
                .collect();
            material.curvature = vec![[T::zero(); 2]; layout.slices.len()];
        }
        material
    }

    /// Largest modulus that the bending stiffness adds, Pa: it bounds the time step.
    pub fn modulus_pa(&self) -> f64 {
        self.bending_excess_pa.iter().map(|x| x.value()).fold(0.0, f64::max)
    }

    /// Lets the material flow and takes down the slices' curvatures; called at the start of a step with
    /// the particles' deformation gradients in order.
    #[inline(always)]
    pub fn prepare<'a>(&mut self, physics: &Physics<T>, gradients: impl Fn(usize) -> &'a Mat3<T>) {
        if !physics.flow_laws.is_empty() {
            for (index, inverse) in self.natural_inverse.iter_mut().enumerate() {
                for law in &physics.flow_laws {
                    if let Some(relaxed) = law.relaxation(&matmul(gradients(index), inverse)) {
                        *inverse = matmul(inverse, &relaxed);
                    }
                }
            }
        }
        for slice in 0..self.curvature.len() {
            let first = slice * self.section_m.len();
            let mut slope = [T::zero(); 2];
            for (member, y) in self.section_m.iter().enumerate() {
                let axis = self.axis(first + member, gradients(first + member));
                let stretch = dot(axis, axis).sqrt();
                slope[0] += stretch.scale(y[0]);
                slope[1] += stretch.scale(y[1]);
            }
            self.curvature[slice] = slope.map(|x| x.scale(-1.0 / self.second_moment_m2));
        }
    }

    /// F A e_s.
    #[inline(always)]
    fn axis(&self, index: usize, f: &Mat3<T>) -> Vec3<T> {
        match self.natural_inverse.get(index) {
            Some(a) => {
                let along = [a[0][0], a[1][0], a[2][0]];
                [dot(f[0], along), dot(f[1], along), dot(f[2], along)]
            }
            None => [f[0][0], f[1][0], f[2][0]],
        }
    }

    /// First Piola-Kirchhoff stress of a particle with the deformation gradient `f` and its rate, and
    /// the determinant of its elastic part.
    #[inline(always)]
    pub fn piola(
        &self,
        index: usize,
        f: &Mat3<T>,
        rate: &Mat3<T>,
        physics: &Physics<T>,
        lame: &Lame<T>,
    ) -> (Mat3<T>, T) {
        let (mut pk1, j) = match self.natural_inverse.get(index) {
            None => elastic_piola(f, rate, physics, lame),
            Some(a) => {
                let (stress, j) = elastic_piola(&matmul(f, a), &matmul(rate, a), physics, lame);
                let volume = T::one() / det(a);
                (matmul_transposed(&stress, a).map(|row| mul(row, volume)), j)
            }
        };
        if !self.bending_excess_pa.is_empty() {
            self.add_bending(index, f, &mut pk1);
        }
        (pk1, j)
    }

    /// Adds −(c − 1) E (κ·y) t ⊗ A e_s, the derivative of the slice's energy per particle volume.
    fn add_bending(&self, index: usize, f: &Mat3<T>, pk1: &mut Mat3<T>) {
        let (slice, member) = (index / self.section_m.len(), index % self.section_m.len());
        let (kappa, y) = (&self.curvature[slice], self.section_m[member]);
        let strain = -(kappa[0].scale(y[0]) + kappa[1].scale(y[1]));
        let axis = self.axis(index, f);
        let pull = mul(
            axis,
            self.bending_excess_pa[slice] * strain / dot(axis, axis).sqrt(),
        );
        match self.natural_inverse.get(index) {
            Some(a) => {
                for k in 0..3 {
                    pk1[k] = add(pk1[k], [pull[k] * a[0][0], pull[k] * a[1][0], pull[k] * a[2][0]]);
                }
            }
            None => (0..3).for_each(|k| pk1[k][0] += pull[k]),
        }
    }

    /// Stored energy of the rope, J: elasticity, the energies of stress laws and of bending. The
    /// particles' deformation gradients and volumes come in order; κ is that of the last `prepare`.
    pub fn energy_j<'a>(
        &self,
        physics: &Physics<T>,
        particles: impl Iterator<Item = (&'a Mat3<T>, f64)>,
    ) -> T {
        let lame = physics.lame();
        let mut sum = T::zero();
        for (index, (f, volume_m3)) in particles.enumerate() {
            let (elastic, share) = match self.natural_inverse.get(index) {
                Some(a) => (matmul(f, a), T::one() / det(a)),
                None => (*f, T::one()),
            };
            let mut density = super::elastic::energy_density(&elastic, &lame);
            let point = StressPoint {
                deformation_gradient: &elastic,
                velocity_gradient: &[[T::zero(); 3]; 3],
                volume_ratio: det(&elastic),
                lame: &lame,
            };
            for law in &physics.stress_laws {
                density += law.energy_j_m3(&point).unwrap_or(T::zero());
            }
            density = density * share;
            let slice = index / self.section_m.len();
            if let (Some(&excess), Some(kappa)) =
                (self.bending_excess_pa.get(slice), self.curvature.get(slice))
            {
                let square = kappa[0] * kappa[0] + kappa[1] * kappa[1];
                let gyration_m2 = self.second_moment_m2 / self.section_m.len() as f64;
                density += (excess * square).scale(0.5 * gyration_m2);
            }
            sum += density.scale(volume_m3);
        }
        sum
    }
}

/// A = G⁻¹ of every particle for the curvatures of the shape laws.
fn natural_inverse<T: Real>(physics: &Physics<T>, layout: &RopeLayout) -> Vec<Mat3<T>> {
    (0..layout.particles())
        .map(|index| {
            let y = layout.section_m[index % layout.section_m.len()];
            let mut stretch = T::one();
            for law in &physics.shape_laws {
                let k = law.curvature_per_m(layout.slice_of(index).arc_m);
                stretch -= k[0].scale(y[0]) + k[1].scale(y[1]);
            }
            let mut inverse = identity();
            inverse[0][0] = T::one() / stretch;
            inverse
        })
        .collect()
}

/// Elasticity and the stress laws: P + τ F⁻ᵀ, and det F.
#[inline(always)]
fn elastic_piola<T: Real>(
    f: &Mat3<T>,
    rate: &Mat3<T>,
    physics: &Physics<T>,
    lame: &Lame<T>,
) -> (Mat3<T>, T) {
    let (mut pk1, j) = piola_stress(f, lame);
    if !physics.stress_laws.is_empty() {
        add_stress_laws(f, rate, physics, lame, j, &mut pk1);
    }
    (pk1, j)
}

/// Adds the Kirchhoff stresses τ of the laws as P = τ F⁻ᵀ.
fn add_stress_laws<T: Real>(
    f: &Mat3<T>,
    rate: &Mat3<T>,
    physics: &Physics<T>,
    lame: &Lame<T>,
    j: T,
    pk1: &mut Mat3<T>,
) {
    let inverse_transposed = transpose_inverse(f);
    // L = Ḟ F⁻¹.
    let velocity_gradient = matmul_transposed(rate, &inverse_transposed);
    for law in &physics.stress_laws {
        let kirchhoff = law.kirchhoff_pa(&StressPoint {
            deformation_gradient: f,
            velocity_gradient: &velocity_gradient,
            volume_ratio: j,
            lame,
        });
        let extra = matmul(&kirchhoff, &inverse_transposed);
        for a in 0..3 {
            pk1[a] = add(pk1[a], extra[a]);
        }
    }
}
