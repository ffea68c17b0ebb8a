//! Exact answers: rods and beams as ordinary differential equations, solved by shooting with the
//! classical Runge-Kutta rule far below the tolerances of the suite.

use super::section::Section;
use super::setup::{DENSITY_KG_M3, G_M_S2, POISSON};

/// Section stiffness and inertia of a round rod.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rod {
    /// Length, m.
    pub length_m: f64,
    /// E A, N.
    pub axial_n: f64,
    /// κ G A, N, with Cowper's (1966) κ = 6 (1 + ν)/(7 + 6 ν) for a full circle.
    pub shear_n: f64,
    /// E I, N m².
    pub bending_n_m2: f64,
    /// ρ A, kg/m.
    pub mass_kg_m: f64,
    /// ρ I, kg m.
    pub rotary_kg_m: f64,
}

impl Rod {
    /// A round rod of the suite's density and Poisson's ratio.
    pub fn round(length_m: f64, diameter_m: f64, young_pa: f64) -> Self {
        let area = std::f64::consts::FRAC_PI_4 * diameter_m * diameter_m;
        let second_moment = area * diameter_m * diameter_m / 16.0;
        let shear_pa = young_pa / (2.0 * (1.0 + POISSON));
        Self {
            length_m,
            axial_n: young_pa * area,
            shear_n: 6.0 * (1.0 + POISSON) / (7.0 + 6.0 * POISSON) * shear_pa * area,
            bending_n_m2: young_pa * second_moment,
            mass_kg_m: DENSITY_KG_M3 * area,
            rotary_kg_m: DENSITY_KG_M3 * second_moment,
        }
    }

    /// Weight per length, N/m.
    pub fn weight_n_m(&self) -> f64 {
        self.mass_kg_m * G_M_S2
    }

    /// Radius of the round section, m, of which I is a quarter of the square times A.
    fn radius_m(&self) -> f64 {
        2.0 * (self.bending_n_m2 / self.axial_n).sqrt()
    }

    /// Curvature of the section that carries a moment (N m) and an axial force (N).
    fn curvature_per_m(&self, moment_n_m: f64, axial_n: f64, section: Section) -> f64 {
        const STEPS: usize = 12;
        let square_m2 = self.radius_m().powi(2);
        let stiffness = |curvature_per_m: f64| {
            self.bending_n_m2 * (1.0 - section.softening * square_m2 * curvature_per_m.powi(2))
                - 2.0 * section.shift * square_m2 * axial_n
        };
        (0..STEPS).fold(moment_n_m / self.bending_n_m2, |curvature_per_m, _| {
            moment_n_m / stiffness(curvature_per_m)
        })
    }

    /// Tip sag of a level cantilever under its weight, small deflection: q L⁴/(8 E I) + q L²/(2 κ G A).
    pub fn sag_m(&self) -> f64 {
        let (q, l) = (self.weight_n_m(), self.length_m);
        q * l.powi(4) / (8.0 * self.bending_n_m2) + q * l * l / (2.0 * self.shear_n)
    }
}

const STEPS: usize = 1000;

/// Walks y' = slope(u, y) from 0 to `end` and shows every point.
fn walk<const N: usize>(
    end: f64,
    start: [f64; N],
    slope: impl Fn(f64, [f64; N]) -> [f64; N],
    mut see: impl FnMut(f64, &[f64; N]),
) -> [f64; N] {
    let h = end / STEPS as f64;
    let mut y = start;
    see(0.0, &y);
    for i in 0..STEPS {
        let u = i as f64 * h;
        let moved = |k: &[f64; N], share: f64| std::array::from_fn(|j| y[j] + share * h * k[j]);
        let k1 = slope(u, y);
        let k2 = slope(u + 0.5 * h, moved(&k1, 0.5));
        let k3 = slope(u + 0.5 * h, moved(&k2, 0.5));
        let k4 = slope(u + h, moved(&k3, 1.0));
        y = std::array::from_fn(|j| y[j] + h / 6.0 * (k1[j] + 2.0 * (k2[j] + k3[j]) + k4[j]));
        see(u + h, &y);
    }
    y
}

/// The root of a function that changes its sign once between the bounds.
fn bisect(mut low: f64, mut high: f64, f: impl Fn(f64) -> f64) -> f64 {
    let sign = f(low).signum();
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if f(middle).signum() == sign {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

/// Rest shape of a heavy rod clamped level at the origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hanging {
    /// Tip (x, z), m.
    pub tip_m: [f64; 2],
    /// Curvature at the clamp, 1/m; negative bends down.
    pub clamp_curvature_per_m: f64,
}

/// The elastica with stretch and shear (Reissner 1972): with the weight q u below a section at the
/// distance u from the tip, the axial force is N = −q u sin θ, the strain along n is −q u cos θ/κGA,
/// M' = q u x', and curvature θ' and strain along t follow from M and N by the section's law of
/// `Section`; shot from the tip so that θ = 0 at the clamp.
pub fn heavy_elastica(rod: &Rod) -> Hanging {
    let (q, section) = (rod.weight_n_m(), Section::bent());
    // (θ, M, x, z), x and z walked from the tip towards the clamp.
    let slope = |u: f64, y: [f64; 4]| {
        let (sin, cos) = y[0].sin_cos();
        let axial_n = -q * u * sin;
        let curvature_per_m = rod.curvature_per_m(y[1], axial_n, section);
        let bent = section.shift * (curvature_per_m * rod.radius_m()).powi(2);
        let (along, across) = (1.0 + axial_n / rod.axial_n + bent, -q * u * cos / rod.shear_n);
        let (dx, dz) = (along * cos - across * sin, along * sin + across * cos);
        [-curvature_per_m, -q * u * dx, dx, dz]
    };
    let shoot = |tip_angle: f64| walk(rod.length_m, [tip_angle, 0.0, 0.0, 0.0], slope, |_, _| ());
    let tip_angle = bisect(-std::f64::consts::FRAC_PI_2, 0.0, |angle| shoot(angle)[0]);
    let y = shoot(tip_angle);
    Hanging {
        tip_m: [y[2], y[3]],
        clamp_curvature_per_m: rod.curvature_per_m(y[1], 0.0, section),
    }
}

/// A mode of bending vibration: deflection and rotation of the section along the rod.
#[derive(Clone, Debug)]
pub struct Mode {
    /// Angular frequency, rad/s.
    pub omega_rad_s: f64,
    length_m: f64,
    /// Deflection and rotation at equal distances.
    shape: Vec<[f64; 2]>,
}

impl Mode {
    /// Deflection and rotation at arc length `s`, of which the largest deflection is 1.
    pub fn at(&self, s: f64) -> [f64; 2] {
        let place = (s / self.length_m).clamp(0.0, 1.0) * (self.shape.len() - 1) as f64;
        let i = (place as usize).min(self.shape.len() - 2);
        let part = place - i as f64;
        std::array::from_fn(|k| self.shape[i][k] * (1.0 - part) + self.shape[i + 1][k] * part)
    }
}

/// How a rod is held while it vibrates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hold {
    /// No force and no moment at either end, no weight.
    Free,
    /// Clamped at its upper end, hanging in its own weight.
    HangingClamped,
}

/// Timoshenko's beam under its tension: (T w'/(1 + ε) + Q)' = −ρA ω² w, M' = −Q − ρI ω² θ, θ' = M/EI,
/// Q = κGA (w' − θ); ω is the root nearest below `guess_rad_s` (plus 2 %) at which both end conditions
/// of the far end hold.
pub fn bending_mode(rod: &Rod, hold: Hold, guess_rad_s: f64) -> Mode {
    let q = if hold == Hold::Free { 0.0 } else { rod.weight_n_m() };
    let slope = |square: f64| {
        move |s: f64, [w, turn, moment, force]: [f64; 4]| {
            let weight = q * (rod.length_m - s);
            let tension = weight / (1.0 + weight / rod.axial_n);
            let dw = (force + rod.shear_n * turn) / (tension + rod.shear_n);
            let shear = rod.shear_n * (dw - turn);
            [
                dw,
                moment / rod.bending_n_m2,
                -shear - rod.rotary_kg_m * square * turn,
                -rod.mass_kg_m * square * w,
            ]
        }
    };
    let starts: [[f64; 4]; 2] = match hold {
        Hold::Free => [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0 / rod.length_m, 0.0, 0.0]],
        Hold::HangingClamped => [
            [0.0, 0.0, rod.bending_n_m2 / rod.length_m.powi(2), 0.0],
            [0.0, 0.0, 0.0, rod.bending_n_m2 / rod.length_m.powi(3)],
        ],
    };
    let ends = |omega: f64| starts.map(|y| walk(rod.length_m, y, slope(omega * omega), |_, _| ()));
    let determinant = |omega: f64| {
        let [a, b] = ends(omega);
        a[2] * b[3] - a[3] * b[2]
    };
    let mut high = 1.02 * guess_rad_s;
    while determinant(0.98 * high).signum() == determinant(high).signum() && high > 0.1 * guess_rad_s {
        high *= 0.98;
    }
    let omega_rad_s = bisect(0.98 * high, high, determinant);
    let [a, b] = ends(omega_rad_s);
    // The combination without end moment.
    let start = std::array::from_fn(|k| starts[0][k] * b[2] - starts[1][k] * a[2]);
    let mut shape = Vec::with_capacity(STEPS + 1);
    walk(rod.length_m, start, slope(omega_rad_s * omega_rad_s), |_, y| {
        shape.push([y[0], y[1]]);
    });
    let largest = shape.iter().map(|y| y[0].abs()).fold(0.0, f64::max);
    for y in &mut shape {
        *y = y.map(|c| c / largest);
    }
    Mode {
        omega_rad_s,
        length_m: rod.length_m,
        shape,
    }
}

/// Elongation of a rope that hangs in its weight, of fixed-corotated material: at every section the
/// stretch whose uniaxial stress carries the weight below.
pub fn hanging_elongation_m(length_m: f64, young_pa: f64) -> f64 {
    let lame = crate::sim::elastic::Lame::new(young_pa, POISSON);
    let lateral = |a: f64| {
        bisect(0.5, 1.5, |b| {
            2.0 * lame.mu * (b - 1.0) + lame.lambda * (a * b * b - 1.0) * a * b
        })
    };
    let stress = |a: f64| {
        let b = lateral(a);
        2.0 * lame.mu * (a - 1.0) + lame.lambda * (a * b * b - 1.0) * b * b
    };
    const SECTIONS: usize = 100;
    (0..SECTIONS)
        .map(|k| {
            let below_m = (k as f64 + 0.5) / SECTIONS as f64 * length_m;
            let load_pa = DENSITY_KG_M3 * G_M_S2 * below_m;
            (bisect(1.0, 1.5, |a| stress(a) - load_pa) - 1.0) * length_m / SECTIONS as f64
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::verify::setup::DIAMETER_M;

    /// A rod so slender that stretch, shear and rotary inertia vanish.
    fn slender() -> Rod {
        Rod::round(1.0, 1e-3, 1e12)
    }

    #[test]
    fn the_elastica_becomes_the_beam_for_small_loads() {
        let mut rod = Rod::round(0.2, DIAMETER_M, 1e9);
        let Hanging {
            tip_m,
            clamp_curvature_per_m,
        } = heavy_elastica(&rod);
        assert!((-tip_m[1] / rod.sag_m() - 1.0).abs() < 1e-4);
        let moment = -0.5 * rod.weight_n_m() * 0.04;
        assert!((clamp_curvature_per_m * rod.bending_n_m2 / moment - 1.0).abs() < 1e-4);
        // q L³/(E I) = 64: the tip hangs almost straight down, turned within about an eighth of the length.
        rod.bending_n_m2 *= 1e-4;
        let [x, z] = heavy_elastica(&rod).tip_m;
        assert!(x > 0.0 && x < 0.05 && z < -0.15, "{x} {z}");
    }

    /// Roots of cos βL cosh βL = 1 (Euler-Bernoulli, free ends): 4.73004, 7.85320.
    #[test]
    fn slender_free_rods_vibrate_as_the_books_say() {
        let rod = slender();
        for root in [4.730_040_745_f64, 7.853_204_624] {
            let exact = root * root * (rod.bending_n_m2 / rod.mass_kg_m).sqrt();
            let mode = bending_mode(&rod, Hold::Free, exact);
            assert!((mode.omega_rad_s / exact - 1.0).abs() < 1e-4, "{root}");
        }
    }

    /// First root of J0: 2.404826; ω = 2.404826/2 (g/L)^½ for a chain.
    #[test]
    fn a_limp_rope_swings_like_a_chain() {
        let mut rod = slender();
        rod.bending_n_m2 = rod.weight_n_m() / 400.0;
        // The clamp keeps a layer of length (E I/q L)^½ straight, here a twentieth of the rope.
        let chain = 0.5 * 2.404_825_558 * (G_M_S2 / 0.95).sqrt();
        let mode = bending_mode(&rod, Hold::HangingClamped, 1.1 * chain);
        assert!(
            (mode.omega_rad_s / chain - 1.0).abs() < 0.02,
            "{}",
            mode.omega_rad_s / chain
        );
    }

    #[test]
    fn a_stiff_rope_stretches_by_hookes_law() {
        let expected = DENSITY_KG_M3 * G_M_S2 * 0.25 / (2.0 * 1e8);
        assert!((hanging_elongation_m(0.5, 1e8) / expected - 1.0).abs() < 1e-3);
    }
}
