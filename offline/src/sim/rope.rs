//! The undeformed rope as particles: slices along the arc, each a quadrature of the circular section.

use crate::demo::RopeSpec;
use serde::{Deserialize, Serialize};

/// The rope's shape and mass.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RopeShape {
    /// Length, m.
    pub length_m: f64,
    /// Diameter, m.
    pub diameter_m: f64,
    /// Mass, kg.
    pub mass_kg: f64,
    /// Known mass at s = length besides that, kg.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub end_mass_kg: f64,
}

/// Most ropes carry nothing, and their files say nothing of it.
fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

impl RopeShape {
    /// A rope of uniform density, kg/m³.
    pub fn of_density(length_m: f64, diameter_m: f64, density_kg_m3: f64) -> Self {
        let mut shape = Self {
            length_m,
            diameter_m,
            mass_kg: 0.0,
            end_mass_kg: 0.0,
        };
        shape.mass_kg = density_kg_m3 * shape.volume_m3();
        shape
    }

    /// The measured rope.
    pub fn of_spec(spec: &RopeSpec) -> Self {
        Self {
            length_m: spec.length_m,
            diameter_m: spec.diameter_m,
            mass_kg: spec.mass_kg,
            end_mass_kg: spec.end_mass_kg,
        }
    }

    /// Whether another shape may be the same rope's: what hangs at its end may differ.
    pub fn is_of_one_rope(&self, other: &Self) -> bool {
        let without_end = |shape: &Self| Self {
            end_mass_kg: 0.0,
            ..*shape
        };
        without_end(self) == without_end(other)
    }

    /// Volume, m³.
    pub fn volume_m3(&self) -> f64 {
        std::f64::consts::FRAC_PI_4 * self.diameter_m * self.diameter_m * self.length_m
    }

    /// Density, kg/m³.
    pub fn density_kg_m3(&self) -> f64 {
        self.mass_kg / self.volume_m3()
    }
}

/// How finely particles sample the rope.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sampling {
    /// Distance of slices along the rope, in cells. Thinner ones bend no better: see "what did not pay" in
    /// [`crate::sim`].
    pub slice_cells: f64,
    /// Distance of neighbouring rings of particles within a section, in cells, as near as a whole number of rings comes to
    /// it. Where finer grids had fewer particles per cell than 1.5 cells have with their least two rings (0.5 and more
    /// instead of 0.375), the first bending mode of a rope 3 cells thick was 0.5 % off, with as many 0.3 %.
    pub section_cells: f64,
}

impl Default for Sampling {
    fn default() -> Self {
        Self {
            slice_cells: 0.6,
            section_cells: 0.375,
        }
    }
}

/// Length of the slices at the rope's ends, as a share of a usual slice: they touch the table, carry a mass at
/// the end and are seen there, all of it in their middle, which is to lie at the end.
const END_SHARE: f64 = 0.1;

/// One slice of the rope.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slice {
    /// Arc length of its middle, m.
    pub arc_m: f64,
    /// Length along the rope, m.
    pub length_m: f64,
}

/// Where the particles of the straight rope lie, in material coordinates.
#[derive(Clone, Debug, PartialEq)]
pub struct RopeLayout {
    /// The rope.
    pub shape: RopeShape,
    /// Slices along the rope.
    pub slices: Vec<Slice>,
    /// Offsets of a slice's particles from the axis, m.
    pub section_m: Vec<[f64; 2]>,
    /// Spacing of the grid for which they are fine enough, m.
    pub spacing_m: f64,
}

impl RopeLayout {
    /// Slices and sections fine enough for the grid spacing. Slices end at the arc lengths
    /// `edges_m` (where grips end), so that a grip holds exactly its length of rope.
    pub fn new(shape: RopeShape, edges_m: &[f64], spacing_m: f64, sampling: Sampling) -> Self {
        let mut ends = vec![0.0];
        ends.extend(edges_m.iter().copied().filter(|&s| s > 0.0 && s < shape.length_m));
        ends.push(shape.length_m);
        ends.sort_by(f64::total_cmp);
        let mut slices = Vec::new();
        for piece in ends.windows(2) {
            let longest_m = sampling.slice_cells * spacing_m;
            let at_end = |s_m: f64| s_m <= 0.0 || s_m >= shape.length_m;
            let [first, last] =
                [piece[0], piece[1]].map(|s_m| if at_end(s_m) { END_SHARE * longest_m } else { 0.0 });
            let length = piece[1] - piece[0] - first - last;
            let count = (length / longest_m).ceil().max(2.0) as usize;
            let mut lengths_m = vec![first];
            lengths_m.extend(std::iter::repeat_n(length / count as f64, count));
            lengths_m.push(last);
            let mut from_m = piece[0];
            for length_m in lengths_m.into_iter().filter(|&l| l > 0.0) {
                slices.push(Slice {
                    arc_m: from_m + 0.5 * length_m,
                    length_m,
                });
                from_m += length_m;
            }
        }
        Self {
            shape,
            slices,
            section_m: section(shape.diameter_m, sampling.section_cells * spacing_m),
            spacing_m,
        }
    }

    /// Number of particles.
    pub fn particles(&self) -> usize {
        self.slices.len() * self.section_m.len()
    }

    /// Weights that the middles of the last slice and of the one before have in the end point of the axis.
    pub fn end_weights(&self) -> [f64; 2] {
        let [.., before, last] = &self.slices[..] else {
            return [1.0, 0.0];
        };
        let beyond = (self.shape.length_m - last.arc_m) / (last.arc_m - before.arc_m);
        [1.0 + beyond, -beyond]
    }

    /// The slice to which a particle belongs.
    pub fn slice_of(&self, particle: usize) -> Slice {
        self.slices[particle / self.section_m.len()]
    }

    /// Undeformed coordinates (s, side, up) of a particle, m.
    pub fn material_m(&self, particle: usize) -> [f64; 3] {
        let [a, b] = self.section_m[particle % self.section_m.len()];
        [self.slice_of(particle).arc_m, a, b]
    }

    /// Length of rope that a particle stands for, m.
    pub fn particle_length_m(&self, particle: usize) -> f64 {
        self.slice_of(particle).length_m / self.section_m.len() as f64
    }

    /// Volume of a particle, m³.
    pub fn particle_volume_m3(&self, particle: usize) -> f64 {
        self.particle_length_m(particle) * self.shape.volume_m3() / self.shape.length_m
    }
}

/// Equal-weight quadrature of a disc: rings of 4, 8, 12, … points, each at the root-mean-square
/// radius of an annulus whose area is its share. The second moment of area is then exactly that of
/// the disc, R²/4 along every axis; bending stiffness is E times that moment, so a raw lattice of
/// few points would bend 5 to 10 % wrong. Measured on a cantilever 1.8 cells thick, the sag changes
/// with the place of the axis between nodes by 11 % for one ring of six and a centre, 5 % for 4 + 8
/// points, 1.3 % for 1 + 6 + 12.
fn section(diameter_m: f64, spacing_m: f64) -> Vec<[f64; 2]> {
    let radius = 0.5 * diameter_m;
    let rings = (radius / spacing_m).round().max(2.0) as usize;
    let total = (2 * rings * (rings + 1)) as f64;
    let mut points = Vec::with_capacity(total as usize);
    for ring in 1..=rings {
        let count = 4 * ring;
        let (inside, outside) = (points.len() as f64, (points.len() + count) as f64);
        let mean_square = 0.5 * (inside + outside) / total;
        let r = radius * mean_square.sqrt();
        for i in 0..count {
            let angle = std::f64::consts::TAU * (i as f64 + 0.5) / count as f64;
            // The same bits on every machine, which the system's sine does not promise.
            let (sin, cos) = libm::sincos(angle);
            points.push([r * cos, r * sin]);
        }
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_section_has_the_second_moments_of_the_disc() {
        for spacing in [0.002, 0.004, 0.006] {
            let points = section(0.014, spacing);
            let n = points.len() as f64;
            let moment = |f: fn(&[f64; 2]) -> f64| points.iter().map(f).sum::<f64>() / n;
            let expected = 0.007f64.powi(2) / 4.0;
            assert!(moment(|p| p[0]).abs() < 1e-15);
            assert!(moment(|p| p[1]).abs() < 1e-15);
            assert!((moment(|p| p[0] * p[0]) / expected - 1.0).abs() < 1e-12);
            assert!((moment(|p| p[1] * p[1]) / expected - 1.0).abs() < 1e-12);
            assert!(moment(|p| p[0] * p[1]).abs() / expected < 1e-12);
        }
    }
}
