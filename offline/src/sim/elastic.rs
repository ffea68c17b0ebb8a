//! Fixed-corotated elasticity (Stomakhin et al. 2012): energy density and first Piola-Kirchhoff stress.

use super::real::Arithmetic;
use super::tensor::{Mat3, Vec3, cross, det, dot, mul, transpose_inverse};

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
        let s =
            |a: usize, b: usize| r[2][a].times_plus(f[2][b], r[1][a].times_plus(f[1][b], r[0][a] * f[0][b]));
        let (xx, yy, zz, xy, xz, yz) = (s(0, 0), s(1, 1), s(2, 2), s(0, 1), s(0, 2), s(1, 2));
        let system = [[yy + zz, -xy, -xz], [-xy, xx + zz, -yz], [-xz, -yz, xx + yy]];
        let inverse = transpose_inverse(&system);
        let factor = -(lame.mu + lame.mu);
        let pressure = lame.lambda * (strained.j - T::one());
        Self {
            strained: *strained,
            lame: *lame,
            spin: inverse.map(|row| mul(row, factor)),
            pressed: f.map(|row| mul(row, pressure)),
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
        let difference = |p: usize, q: usize| -> T {
            let mut sum = r[0][p] * df[0][q];
            for a in 1..3 {
                sum = r[a][p].times_plus(df[a][q], sum);
            }
            for a in 0..3 {
                sum = (-r[a][q]).times_plus(df[a][p], sum);
            }
            sum
        };
        let axial = [difference(2, 1), difference(0, 2), difference(1, 0)];
        let w = self.spin.map(|row| fused_dot(row, axial));
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

#[inline(always)]
fn fused_dot<T: Arithmetic>(a: Vec3<T>, b: Vec3<T>) -> T {
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
