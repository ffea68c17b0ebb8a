//! The grid in the rope's own undeformed coordinates, and how each particle meets its nodes.
//!
//! Weights are functions of where a particle was in the undeformed rope, not of where it is: the
//! total-Lagrangian form of the method (de Vaucorbeil, Nguyen and Hutchinson 2020). The usual,
//! updated form was built first and measured: a 0.25 m rope 1.8 cells thick that had been lifted by
//! 0.3 m through the grid hung 27 mm (15 % of its length) lower than the same rope clamped there from
//! the start, because every crossing of a cell lets loaded particles creep; finer grids did not cure
//! it. With material weights the deformation gradient is a function of the nodes' displacement,
//! results are invariant to rotation and translation, the alignment of clamps to nodes is a choice and
//! not an accident, and stencils and masses are computed once.
//! What it gives up: two distant parts of the rope do not feel each other when they touch.

use super::kernel::weights;
use super::real::Real;
use super::rope::RopeLayout;
use super::tensor::add;

/// Number of nodes that a particle meets.
pub const STENCIL: usize = 27;

/// How one particle meets the grid.
#[derive(Clone, Copy, Debug)]
pub struct Link<T: Real> {
    /// Slots of the 3 × 3 × 3 nodes, last axis fastest.
    pub slots: [u32; STENCIL],
    /// Weights of these nodes.
    pub weights: [T::Base; STENCIL],
    /// Position of the particle relative to the middle node, m, along (s, side, up).
    pub offset_m: [T::Base; 3],
}

/// Where the material grid lies: node spacing, and its shift relative to the rope in cells.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridSpec {
    /// Distance of neighbouring nodes, m.
    pub spacing_m: f64,
    /// Shift of the nodes along (s, side, up), in cells. At zero a node plane lies on the rope's
    /// start, and the axis runs through the middle between node lines, where bending is most exact;
    /// [`super::Scene::lay_grid`] shifts it along the rope to where clamps are most exact.
    pub shift_cells: [f64; 3],
}

/// Nodes and links of one rope.
#[derive(Clone, Debug)]
pub struct Grid<T: Real> {
    /// Node spacing, m.
    pub spacing_m: f64,
    /// One link per particle.
    pub links: Vec<Link<T>>,
    /// Mass per node, kg.
    pub mass_kg: Vec<T>,
    /// One over the mass per node, 1/kg.
    pub inverse_mass: Vec<T>,
    /// Velocity per node, m/s.
    pub velocities_m_s: Vec<T::Packed>,
    /// Impulse per node in the step at hand, N s.
    pub impulses: Vec<T::Packed>,
    /// Stiffness of the clamps per node as an equivalent mass, and that mass times the change of
    /// velocity which the clamps ask for.
    pub clamps: Vec<[T; 4]>,
    /// The table's push upward per node in the step at hand, N s.
    pub contact: Vec<T>,
    /// Whether any clamp or contact has left something since the last clear.
    pub constrained: bool,
}

impl<T: Real> Grid<T> {
    /// Links every particle of a layout to the nodes around it. `masses_kg` are the particles'.
    pub fn new(layout: &RopeLayout, spec: GridSpec, masses_kg: &[T]) -> Self {
        let dx = spec.spacing_m;
        // Far enough that no index is negative, with the alignment that `GridSpec` promises.
        let origin = [
            4.0 + spec.shift_cells[0],
            half_offset(layout, dx) + spec.shift_cells[1],
            half_offset(layout, dx) + spec.shift_cells[2],
        ];
        let across = 2 * half_offset(layout, dx) as usize + 4;
        let along = (layout.shape.length_m / dx).ceil() as usize + 10;
        let mut slot_of = vec![u32::MAX; along * across * across];
        let mut mass_kg: Vec<T> = Vec::new();
        let mut links = Vec::with_capacity(layout.particles());
        for (p, &particle_mass) in masses_kg.iter().enumerate() {
            let [a, b] = layout.section_m[p % layout.section_m.len()];
            let material = [layout.slice_of(p).arc_m, a, b];
            let axes: [(i32, f64, [f64; 3]); 3] =
                std::array::from_fn(|k| weights(material[k] / dx + origin[k]));
            let mut link = Link {
                slots: [0; STENCIL],
                weights: [T::base(0.0); STENCIL],
                offset_m: std::array::from_fn(|k| T::base((axes[k].1 - 1.0) * dx)),
            };
            for entry in 0..STENCIL {
                let index = [entry / 9, entry / 3 % 3, entry % 3];
                let node: [usize; 3] = std::array::from_fn(|k| axes[k].0 as usize + index[k]);
                let cell = (node[0] * across + node[1]) * across + node[2];
                if slot_of[cell] == u32::MAX {
                    slot_of[cell] = mass_kg.len() as u32;
                    mass_kg.push(T::zero());
                }
                let weight: f64 = (0..3).map(|k| axes[k].2[index[k]]).product();
                link.slots[entry] = slot_of[cell];
                link.weights[entry] = T::base(weight);
                mass_kg[slot_of[cell] as usize] += particle_mass.scale(weight);
            }
            links.push(link);
        }
        let zero = T::zero();
        let count = mass_kg.len();
        Self {
            spacing_m: dx,
            links,
            inverse_mass: mass_kg.iter().map(|&m| T::one() / m).collect(),
            mass_kg,
            velocities_m_s: vec![T::pack([zero; 3]); count],
            impulses: vec![T::pack([zero; 3]); count],
            clamps: vec![[zero; 4]; count],
            contact: vec![zero; count],
            constrained: false,
        }
    }

    /// Forgets the sums of the last step.
    #[inline(always)]
    pub fn clear(&mut self) {
        let zero = T::zero();
        self.impulses.fill(T::pack([zero; 3]));
        if self.constrained {
            self.clamps.fill([zero; 4]);
            self.contact.fill(zero);
            self.constrained = false;
        }
    }
}

impl Grid<f64> {
    /// From a particle to a node of its stencil in undeformed coordinates, m.
    #[inline(always)]
    pub fn offset_m(&self, particle: usize, entry: usize) -> [f64; 3] {
        let index = [entry / 9, entry / 3 % 3, entry % 3];
        let link = &self.links[particle];
        std::array::from_fn(|k| (index[k] as f64 - 1.0) * self.spacing_m - link.offset_m[k])
    }

    /// Where the nodes lie in the undeformed rope, (s, side, up), m.
    pub fn nodes_material_m(&self, layout: &RopeLayout) -> Vec<[f64; 3]> {
        let mut nodes = vec![[0.0; 3]; self.mass_kg.len()];
        for (particle, link) in self.links.iter().enumerate() {
            let material_m = layout.material_m(particle);
            for (entry, &slot) in link.slots.iter().enumerate() {
                nodes[slot as usize] = add(material_m, self.offset_m(particle, entry));
            }
        }
        nodes
    }
}

/// Coordinate of the axis in cells: a whole number and a half, so that node lines lie symmetrically.
pub fn half_offset(layout: &RopeLayout, dx: f64) -> f64 {
    (0.5 * layout.shape.diameter_m / dx).ceil() + 3.5
}
