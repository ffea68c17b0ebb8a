//! How a pose's tangent matrix is filled: the stiffness of the particles and of what each slice has in common, springs of
//! clamps, props and pins.

use super::band::Band;
use super::block::{Block, Elastic, StressSlope, per_node};
use super::dual::Dual;
use super::elastic::{Lame, piola_stress};
use super::grid::{Grid, STENCIL};
use super::real::{Arithmetic, Real};
use super::statics::{Hold, Nodes, Statics, gather};
use super::tensor::{Mat3, Vec3, add, det, dot, matmul, scaled};
use std::collections::BTreeMap;

impl<T: Real> Statics<'_, T> {
    /// Fills the matrix with the elastic rope's stiffness, clamps, props and pins.
    pub(super) fn fill_tangent(&self, matrix: &mut Band, nodes: &[Vec3<T>], hold: &Hold<T>) {
        matrix.clear();
        let nodes_m: Nodes<f64> = nodes.iter().map(|y| y.map(T::value)).collect();
        let lame = Lame {
            mu: self.lame.mu.value(),
            lambda: self.lame.lambda.value(),
        };
        let mut block = Block::new();
        for meeting in &self.meeting {
            let volumes: Vec<Elastic> = meeting
                .iter()
                .map(|&p| self.elastic(p, &nodes_m, &lame))
                .collect();
            block.clear();
            block.add_elastic(&volumes);
            for &p in meeting {
                self.add_holds(&mut block, p, hold);
            }
            block.add_to(matrix, &self.rows(meeting[0]));
        }
        self.add_common(matrix, &nodes_m, &lame);
        for (pin, row) in hold.pins {
            let (at, weights): (Vec<usize>, Vec<f64>) =
                row.iter().map(|(node, w)| (3 * self.place[*node], *w)).unzip();
            add_spring(matrix, (&at, &weights), pin.stiffness_n_m);
        }
    }

    /// First rows of a particle's nodes in the matrix.
    fn rows(&self, p: usize) -> [usize; STENCIL] {
        self.grid.links[p].slots.map(|slot| 3 * self.place[slot as usize])
    }

    /// Derivatives of a particle's elastic deformation gradient with respect to its nodes, 1/m. F A varies with a node as F
    /// does, seen from the stress-free shape.
    fn gradients(&self, p: usize, shape: &Mat3<f64>) -> [Vec3<f64>; STENCIL] {
        let scale = 4.0 / (self.grid.spacing_m * self.grid.spacing_m);
        std::array::from_fn(|entry| {
            let d = self.grid.offset_m(p, entry);
            let d = d.map(|d| d * scale * self.grid.links[p].weights[entry]);
            std::array::from_fn(|b| (0..3).map(|c| d[c] * shape[c][b]).sum())
        })
    }

    /// What a particle gives to the matrix as a volume of its own.
    fn elastic(&self, p: usize, nodes_m: &[Vec3<f64>], lame: &Lame<f64>) -> Elastic {
        let (shape, bending) = self.material.shape_and_bending(p);
        let (_, f) = gather(&self.grid, nodes_m, p);
        let gradients = self.gradients(p, &shape);
        Elastic {
            gradients: [0, 1, 2].map(|b| per_node(|entry| gradients[entry][b])),
            slope: stress_slope(&matmul(&f, &shape), lame),
            volume_m3: bending * self.layout.particle_volume_m3(p) / det(&shape),
        }
    }

    /// Adds the springs that hold a particle, and its props.
    fn add_holds(&self, block: &mut Block, p: usize, hold: &Hold<T>) {
        if self.target(hold.motions, p).is_some() {
            let spring = (self.masses_kg[p] * self.clamp_per_kg).value();
            let weights = per_node(|entry| self.grid.links[p].weights[entry]);
            block.add_spring(0..3, &weights, spring);
        }
        if let Some(props) = hold.props {
            let mass_kg = self.masses_kg[p].value();
            props.add_stiffness(block, (&self.grid, p, self.layout.particle_volume_m3(p)), mass_kg);
        }
    }

    /// Adds what the particles of a slice have in common, where bending has a stiffness of its own.
    fn add_common(&self, matrix: &mut Band, nodes_m: &[Vec3<f64>], lame: &Lame<f64>) {
        let members = self.layout.section_m.len();
        for slice in 0..self.layout.slices.len() {
            let mut common = Common::default();
            for p in slice * members..(slice + 1) * members {
                let (shape, bending) = self.material.shape_and_bending(p);
                if bending != 1.0 {
                    let elastic = matmul(&gather(&self.grid, nodes_m, p).1, &shape);
                    let gradients = self.gradients(p, &shape);
                    common.add(&elastic, &self.rows(p), &gradients, 1.0 / members as f64);
                    common.volume_m3 += (1.0 - bending) * self.layout.particle_volume_m3(p);
                }
            }
            if common.volume_m3 != 0.0 {
                let (at, gradients): (Vec<usize>, Vec<[f64; 3]>) = common.gradients.into_iter().unzip();
                let slope = stress_slope(&common.elastic, lame);
                add_stiffness(matrix, &at, &gradients, &slope, common.volume_m3);
            }
        }
    }
}

/// The particles of a grid by the nodes that they meet.
pub(super) fn meeting(grid: &Grid<f64>) -> Vec<Vec<usize>> {
    let mut by_nodes = BTreeMap::<[u32; STENCIL], Vec<usize>>::new();
    for (p, link) in grid.links.iter().enumerate() {
        by_nodes.entry(link.slots).or_default().push(p);
    }
    by_nodes.into_values().collect()
}

/// What the particles of a slice have in common, which has another stiffness where bending has its own.
#[derive(Default)]
struct Common {
    /// Mean of the elastic deformation gradients.
    elastic: Mat3<f64>,
    /// Its derivative with respect to each node, 1/m, by place in the matrix.
    gradients: BTreeMap<usize, [f64; 3]>,
    /// Volume times the share of stiffness that it has for itself, m³; negative where bending is stiffer.
    volume_m3: f64,
}

impl Common {
    fn add(&mut self, elastic: &Mat3<f64>, at: &[usize], gradients: &[[f64; 3]], share: f64) {
        for (sum, row) in self.elastic.iter_mut().zip(elastic) {
            *sum = add(*sum, scaled(*row, share));
        }
        for (at, gradient) in at.iter().zip(gradients) {
            let sum = self.gradients.entry(*at).or_default();
            *sum = add(*sum, scaled(*gradient, share));
        }
    }
}

/// Adds the stiffness of a volume whose deformation gradient varies with the nodes at the rows `at` by `gradients`, however
/// many they are.
pub(super) fn add_stiffness(
    matrix: &mut Band,
    at: &[usize],
    gradients: &[[f64; 3]],
    slope: &StressSlope,
    volume_m3: f64,
) {
    for (&column, gradient) in at.iter().zip(gradients) {
        let g = gradient.map(|x| volume_m3 * x);
        let stress = slope.map(|row| row.map(|entry| entry.map(|by| dot(by, g))));
        for (&row, gradient) in at.iter().zip(gradients).filter(|(row, _)| **row >= column) {
            for c in 0..3 {
                let forces = [0, 1, 2].map(|a| (0..3).map(|b| gradient[b] * stress[a][b][c]).sum());
                let above = if row == column { c } else { 0 };
                matrix.add_column(row + above, column + c, &forces[above..]);
            }
        }
    }
}

/// Adds a spring at a point that is a weighted mean of nodes.
pub(super) fn add_spring(matrix: &mut Band, (at, weights): (&[usize], &[f64]), stiffness_n_m: f64) {
    for (&column, weight) in at.iter().zip(weights) {
        for (&row, other) in at.iter().zip(weights).filter(|(row, _)| **row >= column) {
            for k in 0..3 {
                matrix.add(row + k, column + k, stiffness_n_m * weight * other);
            }
        }
    }
}

/// ∂P/∂F of the elastic rope as [a][b][c][d] = ∂P_ab/∂F_cd, Pa.
fn stress_slope(f: &Mat3<f64>, lame: &Lame<f64>) -> StressSlope {
    let dual: Mat3<Dual<f64, 9>> =
        std::array::from_fn(|a| std::array::from_fn(|b| Dual::input(f[a][b], 3 * a + b)));
    let lame = Lame {
        mu: Dual::of(lame.mu),
        lambda: Dual::of(lame.lambda),
    };
    let (pk1, _) = piola_stress(&dual, &lame);
    pk1.map(|row| row.map(|entry| std::array::from_fn(|c| std::array::from_fn(|d| entry.tangent[3 * c + d]))))
}
