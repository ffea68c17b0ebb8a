//! How particles and nodes exchange momentum and velocity, in two stages.
//!
//! Every slice carries the same members, and weights are functions of undeformed coordinates, so the
//! weight of a particle at a node is a product: its slice's weight on one of three planes of nodes
//! across the rope, times its member's weight on one of nine nodes of a plane, which is the same for
//! every slice. A slice therefore gathers its members on the nodes of *one* plane, with the change of
//! the momentum along the rope kept beside it, and only these few nodes are spread over three planes;
//! velocities take the same way back. A register holds the same member of as many slices as it has lanes.

use super::grid::{GridSpec, half_offset};
use super::kernel::weights;
use super::lanes::{Lanes, MOST_LANES};
use super::real::{Arithmetic, Real};
use super::rope::RopeLayout;
use super::tensor::{Mat3, Vec3, zero3};

/// Nodes of a plane that a member meets.
const NODES: usize = 9;

/// How one member of a slice meets the nodes of a plane.
#[derive(Clone, Debug)]
pub struct Member<B> {
    /// Places of the 3 × 3 nodes, last axis fastest.
    nodes: [u16; NODES],
    /// Weights of these nodes.
    weights: [B; NODES],
    /// Position relative to the middle node, cells, along (side, up).
    offset: [B; 2],
}

/// What a member gives to the nodes of its slice: a value at its place, and its change per cell along each axis.
#[derive(Clone, Copy, Debug)]
pub struct Given<L> {
    /// The value.
    pub value: Vec3<L>,
    /// Its change per cell, by component and axis.
    pub slope: Mat3<L>,
}

impl<L: Lanes> Given<L> {
    /// Nothing.
    pub fn zero() -> Self {
        Self {
            value: zero3(),
            slope: [zero3(); 3],
        }
    }
}

/// How one slice meets the planes.
#[derive(Clone, Copy, Debug)]
pub struct SliceLink<B> {
    /// The first of three planes.
    pub plane: usize,
    /// Weights of these planes.
    pub weights: [B; 3],
}

/// The constant part of the exchange between the particles of a rope and its nodes.
#[derive(Clone, Debug)]
pub struct Transfer<L: Lanes> {
    /// Members of every slice.
    pub members: Vec<Member<L::Scalar>>,
    /// Members that meet the same nodes, whose sums stay in registers from one to the next.
    groups: Vec<Vec<usize>>,
    /// Sum of the members' weights at each node of a plane.
    section_weights: Vec<L::Scalar>,
    /// Slices, filled up to whole registers with slices without weight.
    pub slices: Vec<SliceLink<L::Scalar>>,
    /// Position of the slices of each register relative to their middle plane, cells.
    offsets: Vec<L>,
    /// Places for nodes on a plane, a multiple of the lanes of any register.
    pub width: usize,
    /// Number of planes.
    pub planes: usize,
}

impl<L: Lanes> Transfer<L> {
    /// The exchange of a layout with a grid.
    pub fn new(layout: &RopeLayout, spec: GridSpec) -> Self {
        let (dx, shift) = (spec.spacing_m, spec.shift_cells);
        let base = L::Scalar::of;
        // Nodes without any member are left out of the planes.
        let mut places: Vec<(i32, i32)> = Vec::new();
        let members: Vec<Member<L::Scalar>> = layout
            .section_m
            .iter()
            .map(|place| {
                let axis = |k: usize| weights(place[k] / dx + half_offset(layout, dx) + shift[k + 1]);
                let axes = [axis(0), axis(1)];
                let node = |e: usize| (axes[0].0 + (e / 3) as i32, axes[1].0 + (e % 3) as i32);
                Member {
                    nodes: std::array::from_fn(|e| {
                        let found = places.iter().position(|&p| p == node(e));
                        found.unwrap_or_else(|| {
                            places.push(node(e));
                            places.len() - 1
                        }) as u16
                    }),
                    weights: std::array::from_fn(|e| base(axes[0].2[e / 3] * axes[1].2[e % 3])),
                    offset: [base(axes[0].1 - 1.0), base(axes[1].1 - 1.0)],
                }
            })
            .collect();
        let along = |arc_m: f64| weights(arc_m / dx + 4.0 + shift[0]);
        let first = along(layout.slices[0].arc_m).0;
        let mut slices = Vec::new();
        let mut offset = Vec::new();
        for slice in &layout.slices {
            let (plane, place, weights) = along(slice.arc_m);
            slices.push(SliceLink {
                plane: (plane - first) as usize,
                weights: weights.map(base),
            });
            offset.push(base(place - 1.0));
        }
        let planes = slices[slices.len() - 1].plane + 3;
        while !slices.len().is_multiple_of(L::COUNT) {
            slices.push(SliceLink {
                plane: planes - 3,
                weights: [base(0.0); 3],
            });
            offset.push(base(0.0));
        }
        let mut groups: Vec<Vec<usize>> = Vec::new();
        let mut section_weights = vec![base(0.0); places.len().next_multiple_of(MOST_LANES)];
        for (index, member) in members.iter().enumerate() {
            match groups
                .iter_mut()
                .find(|group| members[group[0]].nodes == member.nodes)
            {
                Some(group) => group.push(index),
                None => groups.push(vec![index]),
            }
            for (&node, &weight) in member.nodes.iter().zip(&member.weights) {
                section_weights[node as usize] += weight;
            }
        }
        Self {
            members,
            groups,
            section_weights,
            offsets: offset.chunks(L::COUNT).map(L::load).collect(),
            slices,
            width: places.len().next_multiple_of(MOST_LANES),
            planes,
        }
    }

    /// Adds the masses of the members of a slice to the nodes they meet, `width` nodes per plane.
    pub fn weigh<T: Real<Base = L::Scalar>>(&self, slice: usize, masses_kg: &[T], nodes: &mut [T]) {
        let link = &self.slices[slice];
        for (member, &mass) in self.members.iter().zip(masses_kg) {
            for i in 0..3 {
                let part = mass.times(link.weights[i]);
                for (&node, &weight) in member.nodes.iter().zip(&member.weights) {
                    nodes[(link.plane + i) * self.width + node as usize] += part.times(weight);
                }
            }
        }
    }

    /// The transpose for one member: Σ w of what is given at the nodes it meets.
    pub fn weigh_back(&self, slice: usize, member: usize, nodes: &[f64]) -> f64 {
        let (link, member) = (&self.slices[slice], &self.members[member]);
        let mut sum = 0.0;
        for i in 0..3 {
            let plane = &nodes[(link.plane + i) * self.width..];
            for (&node, &weight) in member.nodes.iter().zip(&member.weights) {
                sum += link.weights[i].value() * weight.value() * plane[node as usize];
            }
        }
        sum
    }

    /// Plane and place of every node that the first `slices` slices meet, in the order in which they do, slice by
    /// slice and member by member.
    pub fn nodes_as_met(&self, slices: usize) -> Vec<(usize, usize)> {
        let mut met = vec![false; self.planes * self.width];
        let mut nodes = Vec::new();
        for link in &self.slices[..slices] {
            for member in &self.members {
                for (i, &node) in (0..3).flat_map(|i| member.nodes.iter().map(move |node| (i, node))) {
                    let (plane, node) = (link.plane + i, usize::from(node));
                    if !std::mem::replace(&mut met[plane * self.width + node], true) {
                        nodes.push((plane, node));
                    }
                }
            }
        }
        nodes
    }

    /// Number of registers that hold one member of every slice.
    pub fn blocks(&self) -> usize {
        self.offsets.len()
    }

    /// Values at the nodes of each slice of a block, from values at the nodes of all planes: `rows` rows
    /// of nodes per plane. Writes for every node Σ w v, then for every node Σ w v k with k = −1, 0, 1 the
    /// number of the plane.
    #[inline(always)]
    pub fn read_planes(&self, block: usize, rows: usize, planes: &[L::Scalar], nodes: &mut [L]) {
        let length = rows * self.width;
        let slices = &self.slices[block * L::COUNT..(block + 1) * L::COUNT];
        let (sums, moments) = nodes.split_at_mut(length);
        for start in (0..length).step_by(L::COUNT) {
            // In their places from the first: a copy of sixteen registers is a call.
            let sum = &mut sums[start..start + L::COUNT];
            let moment = &mut moments[start..start + L::COUNT];
            for (l, slice) in slices.iter().enumerate() {
                let at = slice.plane * length + start;
                let low = L::load(&planes[at..]) * L::splat(slice.weights[0]);
                let high = L::load(&planes[at + 2 * length..]) * L::splat(slice.weights[2]);
                let middle = L::load(&planes[at + length..]);
                sum[l] = middle.times_plus(L::splat(slice.weights[1]), low + high);
                moment[l] = high - low;
            }
            L::transpose(sum);
            L::transpose(moment);
        }
    }

    /// The reverse: spreads values at the nodes of each slice, and their change from plane to plane,
    /// over the planes. With `moments` false, the values do not change along the rope. What `nodes` held is lost.
    #[inline(always)]
    pub fn add_to_planes(
        &self,
        block: usize,
        rows: usize,
        moments: bool,
        nodes: &mut [L],
        planes: &mut [L::Scalar],
    ) {
        let length = rows * self.width;
        let slices = &self.slices[block * L::COUNT..(block + 1) * L::COUNT];
        let (values, changes) = nodes.split_at_mut(length);
        for start in (0..length).step_by(L::COUNT) {
            let value = &mut values[start..start + L::COUNT];
            L::transpose(value);
            if moments {
                L::transpose(&mut changes[start..start + L::COUNT]);
            }
            // Slices follow each other along the rope, so that three planes at a time stay in registers.
            let mut at = slices[0].plane * length + start;
            let mut sums = [
                L::load(&planes[at..]),
                L::load(&planes[at + length..]),
                L::load(&planes[at + 2 * length..]),
            ];
            for (l, slice) in slices.iter().enumerate() {
                while at < slice.plane * length + start {
                    sums[0].store(&mut planes[at..]);
                    at += length;
                    sums = [sums[1], sums[2], L::load(&planes[at + 2 * length..])];
                }
                let change = if moments { changes[start + l] } else { L::zero() };
                let parts = [value[l] - change, value[l], value[l] + change];
                for i in 0..3 {
                    sums[i] = parts[i].times_plus(L::splat(slice.weights[i]), sums[i]);
                }
            }
            for (i, sum) in sums.into_iter().enumerate() {
                sum.store(&mut planes[at + i * length..]);
            }
        }
    }

    /// Velocity of a member, and its change per cell along each axis: Σ w v, and
    /// (4/dx²)(Σ w v d − v o) dx with the node's and the member's offsets d and o from the middle node.
    #[inline(always)]
    pub fn gather(&self, block: usize, member: usize, nodes: &[L]) -> (Vec3<L>, Mat3<L>) {
        let link = &self.members[member];
        let offset = [
            self.offsets[block],
            L::splat(link.offset[0]),
            L::splat(link.offset[1]),
        ];
        let (mut velocity, mut rate) = (zero3(), [zero3(); 3]);
        for a in 0..3 {
            let values = &nodes[a * self.width..(a + 1) * self.width];
            let moments = &nodes[(a + 3) * self.width..(a + 4) * self.width];
            let mut lines = [L::zero(); 3];
            let (mut low, mut high, mut along) = (L::zero(), L::zero(), L::zero());
            for j in 0..3 {
                let e = 3 * j;
                let (v0, w0) = (node(values, link, e), L::splat(link.weights[e]));
                let (v1, w1) = (node(values, link, e + 1), L::splat(link.weights[e + 1]));
                let (v2, w2) = (node(values, link, e + 2), L::splat(link.weights[e + 2]));
                lines[j] = v2.times_plus(w2, v1.times_plus(w1, v0 * w0));
                low = v0.times_plus(w0, low);
                high = v2.times_plus(w2, high);
                along = node(moments, link, e).times_plus(w0, along);
                along = node(moments, link, e + 1).times_plus(w1, along);
                along = node(moments, link, e + 2).times_plus(w2, along);
            }
            velocity[a] = lines[0] + lines[1] + lines[2];
            let moment = [along, lines[2] - lines[0], high - low];
            for b in 0..3 {
                rate[a][b] = (-velocity[a]).times_plus(offset[b], moment[b]) * L::of(4.0);
            }
        }
        (velocity, rate)
    }

    /// The reverse: adds to the nodes of the slices of a block what their members give.
    #[inline(always)]
    pub fn scatter(&self, block: usize, given: &[Given<L>], nodes: &mut [L]) {
        for group in &self.groups {
            for a in 0..3 {
                self.scatter_component(block, (group, a), given, nodes);
            }
        }
    }

    /// One component of what the members of a group give.
    #[inline(always)]
    fn scatter_component(
        &self,
        block: usize,
        (group, a): (&[usize], usize),
        given: &[Given<L>],
        nodes: &mut [L],
    ) {
        let places = &self.members[group[0]].nodes;
        let (values, moments) = nodes.split_at_mut(3 * self.width);
        let values = &mut values[a * self.width..(a + 1) * self.width];
        let moments = &mut moments[a * self.width..(a + 1) * self.width];
        let (mut sums, mut changes) = ([L::zero(); NODES], [L::zero(); NODES]);
        for e in 0..NODES {
            sums[e] = values[places[e] as usize];
            changes[e] = moments[places[e] as usize];
        }
        for &member in group {
            let link = &self.members[member];
            let Given { value, slope } = &given[member];
            let [along, side, up] = slope[a];
            let mut middle = (-along).times_plus(self.offsets[block], value[a]);
            middle = (-side).times_plus(L::splat(link.offset[0]), middle);
            middle = (-up).times_plus(L::splat(link.offset[1]), middle);
            let lines = [middle - side, middle, middle + side];
            for j in 0..3 {
                let parts = [lines[j] - up, lines[j], lines[j] + up];
                for k in 0..3 {
                    let (e, weight) = (3 * j + k, L::splat(link.weights[3 * j + k]));
                    sums[e] = parts[k].times_plus(weight, sums[e]);
                    changes[e] = along.times_plus(weight, changes[e]);
                }
            }
        }
        for e in 0..NODES {
            values[places[e] as usize] = sums[e];
            moments[places[e] as usize] = changes[e];
        }
    }

    /// The same for one component of the values alone, which do not change from cell to cell; on a row of nodes.
    #[inline(always)]
    pub fn scatter_values(&self, a: usize, given: &[Given<L>], row: &mut [L]) {
        for group in &self.groups {
            let places = &self.members[group[0]].nodes;
            let mut sums = [L::zero(); NODES];
            for e in 0..NODES {
                sums[e] = row[places[e] as usize];
            }
            for &member in group {
                let value = given[member].value[a];
                let weights = &self.members[member].weights;
                for e in 0..NODES {
                    sums[e] = value.times_plus(L::splat(weights[e]), sums[e]);
                }
            }
            for e in 0..NODES {
                row[places[e] as usize] = sums[e];
            }
        }
    }

    /// Gives the nodes of a row what all members of a slice give alike.
    #[inline(always)]
    pub fn spread(&self, value: L, row: &mut [L]) {
        for (node, &weight) in row.iter_mut().zip(&self.section_weights) {
            *node = value * L::splat(weight);
        }
    }

    /// Σ w v for one row of nodes of a member's slice.
    #[inline(always)]
    pub fn gather_value(&self, member: usize, nodes: &[L]) -> L {
        let link = &self.members[member];
        let mut sum = L::zero();
        for entry in 0..NODES {
            sum = node(nodes, link, entry).times_plus(L::splat(link.weights[entry]), sum);
        }
        sum
    }
}

#[inline(always)]
fn node<L: Lanes>(row: &[L], link: &Member<L::Scalar>, entry: usize) -> L {
    row[link.nodes[entry] as usize]
}
