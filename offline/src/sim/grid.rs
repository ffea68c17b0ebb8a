//! A sparse grid: only nodes that particles touch exist; the rest of the box is an index of slots.

use super::real::Real;

/// Sums of the particles around one node: mass (kg) and momentum (kg m/s), which becomes the
/// velocity once the nodes are updated. Four adjacent numbers, so that a step works on all at once.
pub type Node<T> = [T; 4];

/// Slots of the 3 × 3 × 3 nodes around a particle, z fastest.
pub type Stencil = [u32; 27];

const EMPTY: u32 = u32::MAX;

/// Extent and spacing of the simulated box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridBox {
    /// Position of node (0, 0, 0), m.
    pub origin_m: [f64; 3],
    /// Number of nodes along each axis.
    pub nodes: [usize; 3],
    /// Distance of neighbouring nodes, m.
    pub spacing_m: f64,
}

impl GridBox {
    /// The smallest box around `low`..`high` whose nodes include the plane z = `table_m`.
    ///
    /// With a node plane on the table, contact does not depend on where the grid happens to lie.
    pub fn around(low: [f64; 3], high: [f64; 3], spacing_m: f64, table_m: f64) -> Self {
        const MARGIN: f64 = 3.0;
        let anchor = [0.0, 0.0, table_m];
        let mut origin_m = [0.0; 3];
        let mut nodes = [0; 3];
        for k in 0..3 {
            let first = ((low[k] - anchor[k]) / spacing_m).floor() - MARGIN;
            let last = ((high[k] - anchor[k]) / spacing_m).ceil() + MARGIN;
            origin_m[k] = anchor[k] + first * spacing_m;
            nodes[k] = (last - first) as usize + 1;
        }
        Self {
            origin_m,
            nodes,
            spacing_m,
        }
    }

    /// The same box moved by a vector, for tests of alignment.
    pub fn shifted(mut self, by_m: [f64; 3]) -> Self {
        for k in 0..3 {
            self.origin_m[k] += by_m[k];
        }
        self
    }
}

/// The grid's working memory; reused from step to step, so a step allocates nothing once warm.
///
/// Particles whose lowest node is the same share a stencil, so the search for nodes happens once
/// per occupied cell and not once per particle and node.
#[derive(Clone, Debug)]
pub struct Grid<T> {
    /// Where the nodes lie.
    pub bounds: GridBox,
    node_slot: Vec<u32>,
    node_cells: Vec<u32>,
    stencil_slot: Vec<u32>,
    stencil_cells: Vec<u32>,
    /// Stencils in use.
    pub stencils: Vec<Stencil>,
    /// Sums of the rope per touched node, in the order of first touch.
    pub nodes: Vec<Node<T>>,
    /// Stiffness of the clamps per touched node as an equivalent mass, and that mass times the
    /// velocity which the clamps ask for.
    pub clamps: Vec<Node<T>>,
}

impl<T: Real> Grid<T> {
    /// An empty grid.
    pub fn new(bounds: GridBox) -> Self {
        let cells = bounds.nodes.iter().product();
        Self {
            bounds,
            node_slot: vec![EMPTY; cells],
            node_cells: Vec::new(),
            stencil_slot: vec![EMPTY; cells],
            stencil_cells: Vec::new(),
            stencils: Vec::new(),
            nodes: Vec::new(),
            clamps: Vec::new(),
        }
    }

    /// Forgets all nodes.
    pub fn clear(&mut self) {
        for &cell in &self.node_cells {
            self.node_slot[cell as usize] = EMPTY;
        }
        for &cell in &self.stencil_cells {
            self.stencil_slot[cell as usize] = EMPTY;
        }
        self.node_cells.clear();
        self.stencil_cells.clear();
        self.stencils.clear();
        self.nodes.clear();
        self.clamps.clear();
    }

    /// Number of the stencil whose lowest node has the lattice coordinates `base`, created when
    /// missing; none where it would leave the box.
    #[inline(always)]
    pub fn stencil(&mut self, base: [i32; 3]) -> Option<usize> {
        let n = self.bounds.nodes;
        for k in 0..3 {
            if base[k] < 0 || base[k] as usize + 3 > n[k] {
                return None;
            }
        }
        let cell = (base[0] as usize * n[1] + base[1] as usize) * n[2] + base[2] as usize;
        let slot = self.stencil_slot[cell];
        Some(if slot == EMPTY {
            self.add_stencil(cell)
        } else {
            slot as usize
        })
    }

    #[cold]
    #[inline(never)]
    fn add_stencil(&mut self, first: usize) -> usize {
        let [_, ny, nz] = self.bounds.nodes;
        let mut stencil = [EMPTY; 27];
        for (entry, slot) in stencil.iter_mut().enumerate() {
            let (i, j, k) = (entry / 9, entry / 3 % 3, entry % 3);
            *slot = self.touch(first + (i * ny + j) * nz + k);
        }
        self.stencil_slot[first] = self.stencils.len() as u32;
        self.stencil_cells.push(first as u32);
        self.stencils.push(stencil);
        self.stencils.len() - 1
    }

    fn touch(&mut self, cell: usize) -> u32 {
        if self.node_slot[cell] == EMPTY {
            self.node_slot[cell] = self.nodes.len() as u32;
            self.node_cells.push(cell as u32);
            self.nodes.push([T::zero(); 4]);
            self.clamps.push([T::zero(); 4]);
        }
        self.node_slot[cell]
    }

    /// Height of node number `index` of [`Self::nodes`], m.
    #[inline(always)]
    pub fn height_m(&self, index: usize) -> f64 {
        let k = self.node_cells[index] as usize % self.bounds.nodes[2];
        self.bounds.origin_m[2] + k as f64 * self.bounds.spacing_m
    }
}
