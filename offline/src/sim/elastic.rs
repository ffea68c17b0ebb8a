//! Fixed-corotated elasticity (Stomakhin et al. 2012): energy density and first Piola-Kirchhoff stress.

use super::real::Arithmetic;
use super::tensor::{Mat3, Vec3, cross, det, dot, matadd, mul, transpose_inverse};

/// Lamé parameters, Pa.
#[derive(Clone, Copy, Debug)]
pub struct Lame<T> {
    /// Shear modulus μ = E / (2 (1 + ν)).
    pub mu: T,
    /// λ = E ν / ((1 + ν)(1 − 2ν)).
    pub lambda: T,
}

impl<T: Arithmetic> Lame<T> {
    /// From Young's modulus (Pa) and Poisson's ratio.
    pub fn new(young_pa: T, poisson: T) -> Self {
        let one = T::one();
        let two_mu = young_pa / (one + poisson);
        Self {
            mu: two_mu.scale(0.5),
            lambda: two_mu * poisson / (one - poisson.scale(2.0)),
        }
    }

    /// Young's modulus μ (3λ + 2μ)/(λ + μ), Pa.
    pub fn young_pa(&self) -> T {
        self.mu * (self.lambda.scale(3.0) + self.mu.scale(2.0)) / (self.lambda + self.mu)
    }

    /// Both moduli times a factor.
    pub fn times(&self, factor: T) -> Self {
        Self {
            mu: self.mu * factor,
            lambda: self.lambda * factor,
        }
    }

    /// P-wave modulus λ + 2μ, Pa.
    pub fn p_wave_modulus(&self) -> T {
        self.lambda + self.mu.scale(2.0)
    }
}

/// First Piola-Kirchhoff stress P = 2μ (F − R) + λ (J − 1) J F⁻ᵀ, with R the rotation of F.
/// Returns (P, J).
#[inline(always)]
pub fn piola_stress<T: Arithmetic>(f: &Mat3<T>, lame: &Lame<T>) -> (Mat3<T>, T) {
    let strained = Strained::new(f);
    (strained.piola_stress(lame), strained.j)
}

/// A deformation gradient, and what its stress is made of.
#[derive(Clone, Copy, Debug)]
pub struct Strained<T> {
    f: Mat3<T>,
    rotation: Mat3<T>,
    /// J F⁻ᵀ, the cofactor matrix.
    cofactors: Mat3<T>,
    /// Determinant of the deformation gradient.
    pub j: T,
}

impl<T: Arithmetic> Strained<T> {
    /// Of a deformation gradient.
    #[inline(always)]
    pub fn new(f: &Mat3<T>) -> Self {
        let cofactors = [cross(f[1], f[2]), cross(f[2], f[0]), cross(f[0], f[1])];
        Self {
            f: *f,
            rotation: T::polar_rotation(f),
            cofactors,
            j: dot(f[0], cofactors[0]),
        }
    }

    /// The deformation gradient.
    #[inline(always)]
    pub(super) fn gradient(&self) -> &Mat3<T> {
        &self.f
    }

    /// Σ c ∂P/∂μ and Σ c ∂P/∂λ.
    #[inline(always)]
    pub fn by_moduli(&self, c: &Mat3<T>) -> [T; 2] {
        let (mut shear, mut volume) = (T::zero(), T::zero());
        for a in 0..3 {
            for b in 0..3 {
                shear = c[a][b].times_plus(self.f[a][b] - self.rotation[a][b], shear);
                volume = c[a][b].times_plus(self.cofactors[a][b], volume);
            }
        }
        [shear + shear, volume * (self.j - T::one())]
    }

    /// First Piola-Kirchhoff stress, Pa.
    #[inline(always)]
    pub fn piola_stress(&self, lame: &Lame<T>) -> Mat3<T> {
        let two_mu = lame.mu + lame.mu;
        let pressure = lame.lambda * (self.j - T::one());
        let mut pk1 = self.f;
        for a in 0..3 {
            for b in 0..3 {
                let shear = two_mu * (self.f[a][b] - self.rotation[a][b]);
                pk1[a][b] = pressure.times_plus(self.cofactors[a][b], shear);
            }
        }
        pk1
    }
}

/// The differential of the stress at one deformation gradient, applied to many directions.
#[derive(Clone, Copy, Debug)]
pub struct StressDifferential<T> {
    strained: Strained<T>,
    lame: Lame<T>,
    /// −2μ (tr(S) I − S)⁻¹ with S = Rᵀ F.
    spin: Mat3<T>,
    /// λ (J − 1) F.
    pressed: Mat3<T>,
}

impl<T: Arithmetic> StressDifferential<T> {
    /// At a deformation gradient.
    #[inline(always)]
    pub fn new(strained: &Strained<T>, lame: &Lame<T>) -> Self {
        let (r, f) = (&strained.rotation, &strained.f);
        let (xx, yy, zz) = (
            columns_dot(r, 0, f, 0),
            columns_dot(r, 1, f, 1),
            columns_dot(r, 2, f, 2),
        );
        let (xy, xz, yz) = (
            columns_dot(r, 0, f, 1),
            columns_dot(r, 0, f, 2),
            columns_dot(r, 1, f, 2),
        );
        let system = [[yy + zz, -xy, -xz], [-xy, xx + zz, -yz], [-xz, -yz, xx + yy]];
        let inverse = transpose_inverse(&system);
        let factor = -(lame.mu + lame.mu);
        let pressure = lame.lambda * (strained.j - T::one());
        Self {
            strained: *strained,
            lame: *lame,
            spin: [
                mul(inverse[0], factor),
                mul(inverse[1], factor),
                mul(inverse[2], factor),
            ],
            pressed: [mul(f[0], pressure), mul(f[1], pressure), mul(f[2], pressure)],
        }
    }

    /// dP for a change of the deformation gradient and of the moduli. The rotation changes by R Ω, Ω the
    /// cross-product matrix of ω with (tr(S) I − S) ω = axial(Rᵀ dF − dFᵀ R): regular wherever two singular
    /// values of F do not sum to zero, F = I included, unlike the derivative of an SVD.
    #[inline(always)]
    pub fn of(&self, df: &Mat3<T>, dlame: &Lame<T>) -> Mat3<T> {
        let (r, f, c) = (
            &self.strained.rotation,
            &self.strained.f,
            &self.strained.cofactors,
        );
        let axial = [
            columns_dot(r, 2, df, 1) - columns_dot(r, 1, df, 2),
            columns_dot(r, 0, df, 2) - columns_dot(r, 2, df, 0),
            columns_dot(r, 1, df, 0) - columns_dot(r, 0, df, 1),
        ];
        let spin = &self.spin;
        let w = [
            fused_dot(spin[0], axial),
            fused_dot(spin[1], axial),
            fused_dot(spin[2], axial),
        ];
        let two_mu = self.lame.mu + self.lame.mu;
        let two_dmu = dlame.mu + dlame.mu;
        let dj = fused_dot(c[0], df[0]) + fused_dot(c[1], df[1]) + fused_dot(c[2], df[2]);
        let strain = self.strained.j - T::one();
        let dpressure = self.lame.lambda.times_plus(dj, dlame.lambda * strain);
        let g = &self.pressed;
        let mut dp = *df;
        for a in 0..3 {
            // Row a of the cofactors is the product of the two rows after it.
            let (u, v) = ((a + 1) % 3, (a + 2) % 3);
            for b in 0..3 {
                let (p, q) = ((b + 1) % 3, (b + 2) % 3);
                let mut sum = two_mu.times_plus(df[a][b], two_dmu * (f[a][b] - r[a][b]));
                sum = r[a][p].times_plus(w[q], sum);
                sum = (-r[a][q]).times_plus(w[p], sum);
                sum = dpressure.times_plus(c[a][b], sum);
                sum = df[u][p].times_plus(g[v][q], sum);
                sum = (-df[u][q]).times_plus(g[v][p], sum);
                sum = g[u][p].times_plus(df[v][q], sum);
                dp[a][b] = (-g[u][q]).times_plus(df[v][p], sum);
            }
        }
        dp
    }
}

/// The rate of strain of a deformation gradient in motion, and the stress of Kelvin-Voigt damping from it
/// (Simo and Hughes, Computational Inelasticity, 1998, 10.1): P = F S, S = 2 μ' E' + λ' tr(E') I, with the
/// rate E' = sym(Fᵀ Ḟ) of the Green strain and the viscosities μ' and λ', Pa s. S is symmetric, so it
/// takes from strain alone and keeps angular momentum.
#[derive(Clone, Copy, Debug)]
pub struct Straining<T> {
    /// 2 E', 1/s.
    pub(super) twice: Mat3<T>,
    /// S, Pa.
    stress: Mat3<T>,
}

impl<T: Arithmetic> Straining<T> {
    /// Of a deformation gradient and its rate.
    #[inline(always)]
    pub fn new(f: &Mat3<T>, rate: &Mat3<T>, viscosity: &Lame<T>) -> Self {
        let twice = strain_rate_twice(f, rate);
        Self {
            stress: isotropic(&twice, viscosity),
            twice,
        }
    }

    /// First Piola-Kirchhoff stress at the same deformation gradient, Pa.
    #[inline(always)]
    pub fn piola_stress(&self, f: &Mat3<T>) -> Mat3<T> {
        times(f, &self.stress)
    }

    /// dP for a change of the deformation gradient, of its rate and of the viscosities.
    #[inline(always)]
    pub fn differential(&self, at: [&Mat3<T>; 2], by: [&Mat3<T>; 2], viscosities: [&Lame<T>; 2]) -> Mat3<T> {
        let ([f, _], [df, _]) = (at, by);
        let twice = Self::change_of_twice(at, by);
        let change = matadd(
            &isotropic(&twice, viscosities[0]),
            &isotropic(&self.twice, viscosities[1]),
        );
        matadd(&times(df, &self.stress), &times(f, &change))
    }

    /// d(2 E') for a change of the deformation gradient and of its rate.
    #[inline(always)]
    pub(super) fn change_of_twice([f, rate]: [&Mat3<T>; 2], [df, drate]: [&Mat3<T>; 2]) -> Mat3<T> {
        let mut twice = *f;
        for a in 0..3 {
            for b in 0..3 {
                twice[a][b] = columns_dot(df, a, rate, b) + columns_dot(f, a, drate, b);
            }
        }
        symmetrise(&mut twice);
        twice
    }

    /// Pulls a derivative with respect to P back to the deformation gradient, its rate, and both
    /// viscosities.
    #[inline(always)]
    pub fn pull_back(
        &self,
        f: &Mat3<T>,
        rate: &Mat3<T>,
        viscosity: &Lame<T>,
        bar: &Mat3<T>,
    ) -> StrainingCotangent<T> {
        let mut wanted = *bar;
        for a in 0..3 {
            for b in 0..3 {
                wanted[a][b] = columns_dot(f, a, bar, b);
            }
        }
        let shear = self.twice[0][0] * wanted[0][0]
            + self.twice[1][1] * wanted[1][1]
            + self.twice[2][2] * wanted[2][2];
        let across = self.twice[0][1] * (wanted[0][1] + wanted[1][0])
            + self.twice[0][2] * (wanted[0][2] + wanted[2][0])
            + self.twice[1][2] * (wanted[1][2] + wanted[2][1]);
        let volume = (trace(&self.twice) * trace(&wanted)).scale(0.5);
        symmetrise(&mut wanted);
        // With respect to sym(Fᵀ Ḟ): symmetric, like what it is made of.
        let strain = isotropic(&wanted, viscosity);
        StrainingCotangent {
            deformation_gradient: matadd(&times(bar, &self.stress), &times(rate, &strain)),
            rate: times(f, &strain),
            viscosity: [shear + across, volume],
        }
    }
}

/// Derivatives of a result with respect to what a viscous stress is made of.
pub struct StrainingCotangent<T> {
    /// With respect to the deformation gradient.
    pub deformation_gradient: Mat3<T>,
    /// With respect to its rate.
    pub rate: Mat3<T>,
    /// With respect to μ' and λ'.
    pub viscosity: [T; 2],
}

/// Twice the rate of the Green strain, FᵀḞ + ḞᵀF.
#[inline(always)]
pub(super) fn strain_rate_twice<T: Arithmetic>(f: &Mat3<T>, rate: &Mat3<T>) -> Mat3<T> {
    let mut twice = *f;
    for a in 0..3 {
        for b in 0..3 {
            twice[a][b] = columns_dot(f, a, rate, b);
        }
    }
    symmetrise(&mut twice);
    twice
}

/// M + Mᵀ.
#[inline(always)]
fn symmetrise<T: Arithmetic>(m: &mut Mat3<T>) {
    for a in 0..3 {
        for b in a..3 {
            let sum = m[a][b] + m[b][a];
            m[a][b] = sum;
            m[b][a] = sum;
        }
    }
}

/// 2 μ E + λ tr(E) I of 2 E.
#[inline(always)]
pub(super) fn isotropic<T: Arithmetic>(twice: &Mat3<T>, moduli: &Lame<T>) -> Mat3<T> {
    let volume = (moduli.lambda * trace(twice)).scale(0.5);
    let mut stress = *twice;
    for a in 0..3 {
        stress[a] = mul(stress[a], moduli.mu);
        stress[a][a] += volume;
    }
    stress
}

#[inline(always)]
fn trace<T: Arithmetic>(m: &Mat3<T>) -> T {
    m[0][0] + m[1][1] + m[2][2]
}

/// A S of a symmetric S.
#[inline(always)]
pub(super) fn times<T: Arithmetic>(a: &Mat3<T>, s: &Mat3<T>) -> Mat3<T> {
    let mut product = *a;
    for i in 0..3 {
        for j in 0..3 {
            product[i][j] = fused_dot(a[i], s[j]);
        }
    }
    product
}

// What runs in registers has no closures: one that is not inlined would be compiled without them.

/// Column p of A times column q of B.
#[inline(always)]
fn columns_dot<T: Arithmetic>(a: &Mat3<T>, p: usize, b: &Mat3<T>, q: usize) -> T {
    a[2][p].times_plus(b[2][q], a[1][p].times_plus(b[1][q], a[0][p] * b[0][q]))
}

/// a · b.
#[inline(always)]
pub fn fused_dot<T: Arithmetic>(a: Vec3<T>, b: Vec3<T>) -> T {
    a[2].times_plus(b[2], a[1].times_plus(b[1], a[0] * b[0]))
}

/// ψ = μ |F − R|² + λ/2 (J − 1)², J/m³.
pub fn energy_density<T: Arithmetic>(f: &Mat3<T>, lame: &Lame<T>) -> T {
    let r = T::polar_rotation(f);
    let mut square = T::zero();
    for a in 0..3 {
        for b in 0..3 {
            let difference = f[a][b] - r[a][b];
            square += difference * difference;
        }
    }
    let volume = det(f) - T::one();
    lame.mu * square + lame.lambda.scale(0.5) * volume * volume
}

#[cfg(test)]
mod tests {
    use super::*;

    /// P = ∂ψ/∂F, in tension and in compression.
    #[test]
    fn stress_is_the_derivative_of_the_energy() {
        let lame = Lame::new(2.0e6, 0.35);
        for f in [
            [[1.2, 0.1, -0.05], [0.0, 0.9, 0.2], [0.1, 0.0, 1.05]],
            [[0.7, 0.2, 0.1], [-0.2, 0.8, 0.0], [0.0, 0.1, 0.75]],
        ] {
            let mut pk1 = [[0.0; 3]; 3];
            for a in 0..3 {
                for b in 0..3 {
                    let h = 1e-6;
                    let shifted = |sign: f64| {
                        let mut g = f;
                        g[a][b] += sign * h;
                        energy_density(&g, &lame)
                    };
                    pk1[a][b] = (shifted(1.0) - shifted(-1.0)) / (2.0 * h);
                }
            }
            let (got, _) = piola_stress(&f, &lame);
            for a in 0..3 {
                for b in 0..3 {
                    let scale = 1e-6 * lame.mu;
                    assert!((got[a][b] - pk1[a][b]).abs() < scale, "{a}{b}");
                }
            }
        }
    }
}
