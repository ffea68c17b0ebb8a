//! What the laws make of the rope's material: its stress-free shape, which plastic flow changes, and
//! the bending stiffness of its slices.
//!
//! **Stress-free shape.** A particle at the offset y from the axis of a rope whose natural curvature is
//! k is stress-free under G = diag(1 − k·y, 1, 1) in (s, side, up), up to a rotation: that is the exact
//! gradient of a twist-free rod of this curvature (Bishop 1975). The energy density is then ψ(F A) with
//! A = G⁻¹ per stress-free volume, so P = det(A)⁻¹ P_e(F A) Aᵀ. Plastic flow multiplies A (Lee 1969).
//!
//! **Bending stiffness.** With F̄ the mean of F A over a slice's particles, the slice's energy becomes the mean
//! of c ψ(F A) + (1 − c) ψ(F̄): what the particles have in common, stretch and shear, keeps its
//! stiffness, and what differs over the section, bending and twist, has c times as much. It scales
//! what the grid makes of bending, error included, which adding (c − 1) E I κ²/2 does not. F̄ turns with the
//! rope, so it is invariant.
//!
//! **Memory.** Laws whose stress follows the rate of strain with a delay keep a tensor per particle in
//! material coordinates.

use super::axial;
use super::elastic::{Lame, energy_density, isotropic, piola_stress, strain_rate_twice};
use super::physics::Physics;
use super::real::Real;
use super::rope::RopeLayout;
use super::tensor::{Mat3, det, identity, matadd, matmul, matmul_transposed, mul, zero3};

/// State of the material, particle by particle and slice by slice. Lists are empty where nothing needs
/// them.
#[derive(Clone, Debug)]
pub struct Material<T> {
    /// A = G⁻¹ per particle.
    natural_inverse: Vec<Mat3<T>>,
    /// Bending stiffness c per slice, as a multiple of the solid section's.
    bending: Vec<T>,
    /// (1 − c) P(F̄) per slice at the present step, Pa.
    common_pa: Vec<Mat3<T>>,
    /// What each memory law remembers of twice the rate of the Green strain, by law and particle, 1/s.
    memories: Vec<Vec<Mat3<T>>>,
    /// Particles per slice.
    section: usize,
}

/// Deformation gradient of a particle and its rate.
pub type Motion<'a, T> = (&'a Mat3<T>, &'a Mat3<T>);

impl<T: Real> Material<T> {
    /// The material before the first step.
    pub fn new(physics: &Physics<T>, layout: &RopeLayout) -> Self {
        let count = layout.particles();
        let blank = || vec![[zero3(); 3]; count];
        let mut material = Self {
            natural_inverse: Vec::new(),
            bending: Vec::new(),
            common_pa: Vec::new(),
            memories: physics.memory_laws.iter().map(|_| blank()).collect(),
            section: layout.section_m.len(),
        };
        if !(physics.shape_laws.is_empty() && physics.flow_laws.is_empty()) {
            material.natural_inverse = natural_inverse(physics, layout);
        }
        if !physics.bending_laws.is_empty() {
            material.bending = vec![T::one(); layout.slices.len()];
            for law in &physics.bending_laws {
                law.change_stiffness(layout, &mut material.bending);
            }
            material.common_pa = vec![[zero3(); 3]; layout.slices.len()];
        }
        material
    }

    /// Least volume of a particle's shape at rest over its undeformed one: not positive where the shape at
    /// rest is bent so much that the inner side of the rope would turn inside out.
    pub fn least_rest_volume(&self) -> f64 {
        let volumes = self.natural_inverse.iter().map(|a| 1.0 / det(a).value());
        volumes.fold(f64::INFINITY, f64::min)
    }

    /// Largest bending stiffness, at least one: it bounds the time step as the modulus does.
    pub fn largest_bending(&self) -> T {
        let larger = |most: T, &c: &T| T::select(c.exceeds(most), c, most);
        self.bending.iter().fold(T::one(), larger)
    }

    /// Lets the material flow and remember, and takes down what the slices' particles have in common;
    /// called at the start of a step of `dt_s` with the particles' motion.
    #[inline(always)]
    pub fn advance<'a>(&mut self, physics: &Physics<T>, dt_s: f64, motion: impl Fn(usize) -> Motion<'a, T>) {
        if !physics.flow_laws.is_empty() {
            for (index, inverse) in self.natural_inverse.iter_mut().enumerate() {
                for law in &physics.flow_laws {
                    if let Some(relaxed) = law.relaxation(&matmul(motion(index).0, inverse)) {
                        *inverse = matmul(inverse, &relaxed);
                    }
                }
            }
        }
        for (law, memories) in physics.memory_laws.iter().zip(&mut self.memories) {
            let [keep, take] = remembered(law.time_s, dt_s);
            for (index, memory) in memories.iter_mut().enumerate() {
                let (f, rate) = motion(index);
                let rate = strain_rate_twice(f, rate);
                for a in 0..3 {
                    for b in 0..3 {
                        memory[a][b] = keep * memory[a][b] + take * rate[a][b];
                    }
                }
            }
        }
        self.rest(physics, |index| motion(index).0);
    }

    /// Takes down what the slices' particles have in common. Where nothing moves that is all there is to do:
    /// what laws remember of strain has died out.
    #[inline(always)]
    pub fn rest<'a>(&mut self, physics: &Physics<T>, gradients: impl Fn(usize) -> &'a Mat3<T>) {
        for slice in 0..self.common_pa.len() {
            let mean = self.mean(slice, &gradients);
            let (stress, _) = piola_stress(&mean, &physics.lame());
            let share = T::one() - self.bending[slice];
            self.common_pa[slice] = stress.map(|row| mul(row, share));
        }
    }

    /// Whether a particle would yield.
    pub fn yields(&self, index: usize, f: &Mat3<T>, physics: &Physics<T>) -> bool {
        let elastic = self.elastic(index, f);
        physics
            .flow_laws
            .iter()
            .any(|law| law.relaxation(&elastic).is_some())
    }

    /// The stress-free shape's A of a particle, and the bending stiffness c of its slice.
    pub fn shape_and_bending(&self, index: usize) -> (Mat3<f64>, f64) {
        let shape = match self.natural_inverse.get(index) {
            Some(a) => a.map(|row| row.map(T::value)),
            None => identity(),
        };
        let bending = self.bending.get(index / self.section);
        (shape, bending.map_or(1.0, |c| c.value()))
    }

    /// The stress-free shape's A of a particle; none where it is straight and nothing flows.
    pub(super) fn natural_inverse(&self, index: usize) -> Option<&Mat3<T>> {
        self.natural_inverse.get(index)
    }

    /// Bending stiffness c of a slice; none where no law changes any.
    pub(super) fn bending(&self, slice: usize) -> Option<T> {
        self.bending.get(slice).copied()
    }

    /// F A of a particle.
    #[inline(always)]
    fn elastic(&self, index: usize, f: &Mat3<T>) -> Mat3<T> {
        match self.natural_inverse.get(index) {
            Some(a) => matmul(f, a),
            None => *f,
        }
    }

    /// F̄ of a slice.
    fn mean<'a>(&self, slice: usize, gradients: impl Fn(usize) -> &'a Mat3<T>) -> Mat3<T> {
        let mut sum: Mat3<T> = [zero3(); 3];
        for index in slice * self.section..(slice + 1) * self.section {
            let f = self.elastic(index, gradients(index));
            sum = matadd(&sum, &f);
        }
        sum.map(|row| row.map(|x| x.scale(1.0 / self.section as f64)))
    }

    /// First Piola-Kirchhoff stress of a particle, and the determinant of its elastic part.
    #[inline(always)]
    pub fn piola(&self, index: usize, f: &Mat3<T>, physics: &Physics<T>, lame: &Lame<T>) -> (Mat3<T>, T) {
        let bending = self.bending.get(index / self.section);
        let (mut pk1, j) = match self.natural_inverse.get(index) {
            None => elastic_piola(f, bending, physics, lame),
            Some(a) => {
                let (stress, j) = elastic_piola(&matmul(f, a), bending, physics, lame);
                let volume = T::one() / det(a);
                (matmul_transposed(&stress, a).map(|row| mul(row, volume)), j)
            }
        };
        if let Some(common) = self.common_pa.get(index / self.section) {
            let common = match self.natural_inverse.get(index) {
                Some(a) => matmul_transposed(common, a),
                None => *common,
            };
            pk1 = matadd(&pk1, &common);
        }
        for (law, memories) in physics.memory_laws.iter().zip(&self.memories) {
            let stress = isotropic(&memories[index], &law.viscosity(lame));
            pk1 = matadd(&pk1, &matmul(f, &stress));
        }
        (pk1, j)
    }

    /// Stored energy of the rope, J: elasticity with its slices' bending stiffness, and that of the
    /// axial laws. `gradients` are the particles' deformation gradients, `volume_m3` their volumes.
    pub fn energy_j<'a>(
        &self,
        physics: &Physics<T>,
        gradients: impl Fn(usize) -> &'a Mat3<T>,
        volume_m3: &[f64],
    ) -> T {
        let lame = physics.lame();
        let mut sum = T::zero();
        for (index, &volume) in volume_m3.iter().enumerate() {
            let elastic = self.elastic(index, gradients(index));
            let mut density = energy_density(&elastic, &lame);
            if let Some(&c) = self.bending.get(index / self.section) {
                density = density * c;
            }
            if let Some(cubic_pa) = physics.cubic_pa(&lame) {
                density += axial::energy_j_m3(axial::axis(&elastic), cubic_pa);
            }
            if let Some(a) = self.natural_inverse.get(index) {
                density = density / det(a);
            }
            sum += density.scale(volume);
        }
        for (slice, &c) in self.bending.iter().enumerate() {
            let common = energy_density(&self.mean(slice, &gradients), &lame);
            let members = slice * self.section..(slice + 1) * self.section;
            sum += ((T::one() - c) * common).scale(volume_m3[members].iter().sum());
        }
        sum
    }
}

/// Shares of what was remembered and of what is new in a memory after a step: backward Euler, stable for any delay;
/// without a delay the memory is the new itself.
pub(super) fn remembered<T: Real>(delay_s: T, dt_s: f64) -> [T; 2] {
    let inverse = T::one() / (delay_s + T::of(dt_s));
    [delay_s * inverse, inverse.scale(dt_s)]
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

/// Elasticity, times the bending stiffness, and the stress along the axis: c P + P_a, and det F.
#[inline(always)]
fn elastic_piola<T: Real>(
    f: &Mat3<T>,
    bending: Option<&T>,
    physics: &Physics<T>,
    lame: &Lame<T>,
) -> (Mat3<T>, T) {
    let (mut pk1, j) = piola_stress(f, lame);
    if let Some(&c) = bending {
        pk1 = pk1.map(|row| mul(row, c));
    }
    if let Some(cubic_pa) = physics.cubic_pa(lame) {
        axial::add_column(&mut pk1, axial::piola_column(axial::axis(f), cubic_pa));
    }
    (pk1, j)
}
