//! How a round section of the suite's material bends where curvatures are not small: pure bending in three
//! dimensions, solved for how the section changes its shape.

use super::setup::POISSON;
use crate::sim::elastic::{Lame, piola_stress};
use nalgebra::{SMatrix, SVector};

/// What a round section of radius r adds, in second order of curvature, to a rod's linear law:
/// M = EI κ (1 − `softening` (κ r)²) − 2 `shift` r² κ N, and the axis stretches by N/EA + `shift` (κ r)².
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Section {
    /// Share of the moment that is missing, over (κ r)²: the section is squeezed by its own bent fibres (Brazier 1927).
    pub softening: f64,
    /// Stretch of the axis without axial force, over (κ r)².
    pub shift: f64,
}

/// Displacements of the section's points as powers of (side, up), the radius being 1: those to the side and up that
/// are symmetric to the plane of bending, up to the third degree. Higher ones change `softening` by less than 1e-3.
const SIDE: [[i32; 2]; 4] = [[1, 0], [1, 1], [1, 2], [3, 0]];
const UP: [[i32; 2]; 5] = [[0, 1], [0, 2], [0, 3], [2, 0], [2, 1]];
/// Unknowns: their coefficients, and the axis' stretch.
const UNKNOWNS: usize = SIDE.len() + UP.len() + 1;
type Unknowns = SVector<f64, UNKNOWNS>;

/// Curvatures, times the radius, at which a moment is linear and at which its second order is read off.
const CURVATURES: [f64; 2] = [1e-3, 0.1];
const NEWTON_STEPS: usize = 6;
const DIFFERENCE: f64 = 1e-6;

impl Section {
    /// Of fixed-corotated material with the suite's Poisson's ratio.
    pub fn bent() -> Self {
        let [linear, bent] = CURVATURES.map(|curvature| (curvature, Bent::at(curvature, POISSON)));
        let stiffness = |(curvature, state): (f64, Bent)| state.moment / curvature;
        Self {
            softening: (1.0 - stiffness(bent) / stiffness(linear)) / bent.0.powi(2),
            shift: bent.1.stretch / bent.0.powi(2),
        }
    }
}

/// A section of radius 1 and E = 1 in pure bending.
#[derive(Clone, Copy)]
struct Bent {
    moment: f64,
    stretch: f64,
}

impl Bent {
    /// The section without forces but its moment: the work of its stress on every displacement vanishes.
    fn at(curvature: f64, poisson: f64) -> Self {
        let lame = Lame::new(1.0, poisson);
        let mut x = Unknowns::zeros();
        for _ in 0..NEWTON_STEPS {
            let column = |k: usize| {
                let [more, less] = [1.0, -1.0].map(|sign| {
                    let mut moved = x;
                    moved[k] += sign * DIFFERENCE;
                    works(&moved, curvature, &lame).0
                });
                (more - less) / (2.0 * DIFFERENCE)
            };
            let slope =
                SMatrix::<f64, UNKNOWNS, UNKNOWNS>::from_columns(&std::array::from_fn::<_, UNKNOWNS, _>(
                    column,
                ));
            let step = slope.lu().solve(&works(&x, curvature, &lame).0);
            x -= step.expect("an elastic section is stiff against every displacement");
        }
        Self {
            moment: works(&x, curvature, &lame).1,
            stretch: x[UNKNOWNS - 1],
        }
    }
}

/// Work of the section's stress on every unknown, and its moment.
fn works(x: &Unknowns, curvature: f64, lame: &Lame<f64>) -> (Unknowns, f64) {
    let (mut works, mut moment) = (Unknowns::zeros(), 0.0);
    for (point, weight) in disc() {
        let shapes: [[f64; 3]; UNKNOWNS - 1] = std::array::from_fn(|k| {
            monomial(*SIDE.iter().chain(&UP).nth(k).expect("there are as many"), point)
        });
        let sum =
            |range: std::ops::Range<usize>, part: usize| range.map(|k| x[k] * shapes[k][part]).sum::<f64>();
        let (side, up) = (0..SIDE.len(), SIDE.len()..UNKNOWNS - 1);
        let height = point[1] + sum(up.clone(), 0);
        let stretch = 1.0 + x[UNKNOWNS - 1] + curvature * height;
        let gradient = [
            [1.0 + sum(side.clone(), 1), sum(side.clone(), 2), 0.0],
            [sum(up.clone(), 1), 1.0 + sum(up, 2), 0.0],
            [0.0, 0.0, stretch],
        ];
        let (stress, _) = piola_stress(&gradient, lame);
        for (k, [value, by_side, by_up]) in shapes.into_iter().enumerate() {
            let row = stress[usize::from(!side.contains(&k))];
            let fibres = if side.contains(&k) {
                0.0
            } else {
                stress[2][2] * curvature * value
            };
            works[k] += weight * (row[0] * by_side + row[1] * by_up + fibres);
        }
        works[UNKNOWNS - 1] += weight * stress[2][2];
        moment += weight * stress[2][2] * height;
    }
    (works, moment)
}

/// side^i up^j and its derivatives along both.
fn monomial([i, j]: [i32; 2], [side, up]: [f64; 2]) -> [f64; 3] {
    let slope = |x: f64, n: i32| if n == 0 { 0.0 } else { f64::from(n) * x.powi(n - 1) };
    [
        side.powi(i) * up.powi(j),
        slope(side, i) * up.powi(j),
        side.powi(i) * slope(up, j),
    ]
}

/// Points and weights on the unit disc: Gauss's two-point rule in the square of the radius on rings of equal area.
fn disc() -> impl Iterator<Item = ([f64; 2], f64)> {
    const RINGS: usize = 4;
    const ANGLES: usize = 16;
    const SHARE: f64 = std::f64::consts::PI / (2 * RINGS * ANGLES) as f64;
    let squares = (0..2 * RINGS).map(|k| {
        let side = if k % 2 == 0 { -0.5 } else { 0.5 };
        ((k / 2) as f64 + 0.5 + side / 3.0_f64.sqrt()) / RINGS as f64
    });
    squares.flat_map(|square: f64| {
        (0..ANGLES).map(move |i| {
            let (sin, cos) = (std::f64::consts::TAU * (i as f64 + 0.5) / ANGLES as f64).sin_cos();
            ([square.sqrt() * cos, square.sqrt() * sin], SHARE)
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn little_bending_is_saint_venants() {
        let bent = Bent::at(1e-3, 0.3);
        assert!((bent.moment / (std::f64::consts::FRAC_PI_4 * 1e-3) - 1.0).abs() < 1e-5);
        assert!(bent.stretch.abs() < 1e-6);
    }

    /// The energy over polynomials of the fifth degree, minimised by SciPy's BFGS, gives 0.515 and 0.163 for ν = 0.3.
    #[test]
    fn much_bending_is_softer_and_stretches_the_axis() {
        let section = Section::bent();
        assert!((section.softening - 0.515).abs() < 2e-3, "{section:?}");
        assert!((section.shift - 0.163).abs() < 2e-3, "{section:?}");
    }

    /// Without Poisson's ratio the axis keeps its length; what softens is the fibres' pull on the section alone.
    #[test]
    fn without_poissons_ratio_the_axis_keeps_its_length() {
        assert!(Bent::at(0.1, 0.0).stretch.abs() < 1e-9);
    }
}
