//! Fixed-corotated elasticity (Stomakhin et al. 2012): energy density and first Piola-Kirchhoff stress.

use super::real::Real;
use super::tensor::{Mat3, cross, det, dot};

/// Lamé parameters, Pa.
#[derive(Clone, Copy, Debug)]
pub struct Lame<T> {
    /// Shear modulus μ = E / (2 (1 + ν)).
    pub mu: T,
    /// λ = E ν / ((1 + ν)(1 − 2ν)).
    pub lambda: T,
}

impl<T: Real> Lame<T> {
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

    /// P-wave modulus λ + 2μ, Pa.
    pub fn p_wave_modulus(&self) -> T {
        self.lambda + self.mu.scale(2.0)
    }
}

/// First Piola-Kirchhoff stress P = 2μ (F − R) + λ (J − 1) J F⁻ᵀ, with R the rotation of F.
/// Returns (P, J).
#[inline(always)]
pub fn piola_stress<T: Real>(f: &Mat3<T>, lame: &Lame<T>) -> (Mat3<T>, T) {
    let r = T::polar_rotation(f);
    // J F⁻ᵀ is the cofactor matrix.
    let cofactors = [cross(f[1], f[2]), cross(f[2], f[0]), cross(f[0], f[1])];
    let j = dot(f[0], cofactors[0]);
    let two_mu = lame.mu.scale(2.0);
    let pressure = lame.lambda * (j - T::one());
    let mut pk1 = *f;
    for a in 0..3 {
        for b in 0..3 {
            pk1[a][b] = two_mu * (f[a][b] - r[a][b]) + pressure * cofactors[a][b];
        }
    }
    (pk1, j)
}

/// ψ = μ |F − R|² + λ/2 (J − 1)², J/m³.
pub fn energy_density<T: Real>(f: &Mat3<T>, lame: &Lame<T>) -> T {
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
