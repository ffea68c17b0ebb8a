//! Fixed-corotated elasticity (Stomakhin et al. 2012): energy density and Kirchhoff stress.

use super::real::Real;
use super::tensor::{Mat3, det, matmul_transposed};

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

    /// P-wave modulus λ + 2μ, Pa.
    pub fn p_wave_modulus(&self) -> T {
        self.lambda + self.mu.scale(2.0)
    }
}

/// τ = 2μ (F − R) Fᵀ + λ J (J − 1) I, with R the rotation of F. Returns (τ, J).
#[inline(always)]
pub fn kirchhoff_stress<T: Real>(f: &Mat3<T>, lame: &Lame<T>) -> (Mat3<T>, T) {
    let r = T::polar_rotation(f);
    let j = det(f);
    let mut stretch = *f;
    for a in 0..3 {
        for b in 0..3 {
            stretch[a][b] -= r[a][b];
        }
    }
    let two_mu = lame.mu.scale(2.0);
    let pressure = lame.lambda * j * (j - T::one());
    let mut kirchhoff = matmul_transposed(&stretch, f);
    for a in 0..3 {
        for b in 0..3 {
            kirchhoff[a][b] = kirchhoff[a][b] * two_mu;
        }
    }
    for a in 0..3 {
        kirchhoff[a][a] += pressure;
    }
    (kirchhoff, j)
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

    /// τ = (∂ψ/∂F) Fᵀ, in tension and in compression.
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
            let expected = matmul_transposed(&pk1, &f);
            let (got, _) = kirchhoff_stress(&f, &lame);
            for a in 0..3 {
                for b in 0..3 {
                    let scale = 1e-6 * lame.mu;
                    assert!((got[a][b] - expected[a][b]).abs() < scale, "{a}{b}");
                }
            }
        }
    }
}
