//! What props a rope that finds no rest by its own forces alone: a second search takes these small forces as well
//! ([`super::rest`]). Two things keep measured cables from rest:
//!
//! - Nodes that hardly any particle sees are held by next to nothing. Where a heavy cable stood out from its clamp, on 2.5
//!   to 3 cells, they went metres away to take the stress from the one particle they touch. In a rollout they forget within
//!   a millisecond what their particles do not carry; here a weak energy ties them to the affine motion of their particles.
//! - A heavy curled cable that stands up may rest on the edge in the plane in which it was measured: it would tip out, so
//!   slowly that no search gets away from where it stands. Springs across the plane hold it in, and pull at nothing but what
//!   thickens or thins.

use super::block::{Block, NOTHING, PerNode, Rows, per_node};
use super::grid::{Grid, STENCIL};
use super::real::Real;
use super::rope::RopeLayout;
use super::statics::Statics;
use super::tensor::{Mat3, Vec3, add, dot, matvec, mul, scaled, sub, zero3};
use super::widest::on_widest;

/// Stiffness with which a node that sees next to nothing keeps to the affine motion of its particles, in moduli of P waves
/// over a squared cell. With half as much or less a search took up to 83 steps in place of 13, and came to rest where no
/// cable does; a rollout from there leaves the pose by some ten micrometres a second.
const AFFINE: f64 = 1e-4;
/// Volume of rope that such a node sees, as a share of a cell's: from there on the less the stiffer.
const SLIGHT: f64 = 0.02;
/// The axis across the plane of a rope that was seen to stay in one.
const Y: usize = 1;

/// The props of one rope.
pub(super) struct Props<T> {
    /// Stiffness per volume, Pa/m², with which each node keeps to the affine motion of its particles.
    affine_pa_m2: Vec<T>,
    across: Option<Across>,
}

/// Springs along y, one for each particle.
struct Across {
    /// Stiffness per mass, 1/s²: as of a pendulum as long as the rope.
    per_kg: f64,
    /// Where each particle is held, m: as in the straight rope.
    y_m: Vec<f64>,
}

impl<T: Real> Props<T> {
    /// Those of a rope.
    pub(super) fn new(statics: &Statics<T>) -> Self {
        let Statics {
            scene,
            layout,
            grid,
            lame,
            ..
        } = statics;
        let stiffest_pa_m2 = lame.p_wave_modulus().scale(AFFINE / grid.spacing_m.powi(2));
        let slightness = slightness(layout, grid).into_iter();
        let in_plane = scene.start.hang().is_some_and(|hang| hang.in_plane);
        let y_m = || (0..layout.particles()).map(|p| scene.straight_m(layout.material_m(p))[Y]);
        Self {
            affine_pa_m2: slightness.map(|share| stiffest_pa_m2.scale(share)).collect(),
            across: in_plane.then(|| Across {
                per_kg: statics.swing_per_s2(),
                y_m: y_m().collect(),
            }),
        }
    }

    /// Force of the spring across the plane on particle `p`, N.
    pub(super) fn spring_n(&self, p: usize, x: &Vec3<T>, mass_kg: T) -> Vec3<T> {
        let mut force = zero3();
        if let Some(across) = &self.across {
            force[Y] = (T::of(across.y_m[p]) - x[Y]) * mass_kg.scale(across.per_kg);
        }
        force
    }

    /// Adds the forces with which the slight nodes around particle `p` keep to its affine motion x + F d, and what they do
    /// to the others, with which that motion goes.
    pub(super) fn add_forces(
        &self,
        forces: &mut [Vec3<T>],
        nodes: &[Vec3<T>],
        (grid, p, volume_m3): (&Grid<f64>, usize, f64),
        (x, f): (Vec3<T>, Mat3<T>),
    ) {
        let link = &grid.links[p];
        let per_m2 = 4.0 / (grid.spacing_m * grid.spacing_m);
        let (mut pull, mut turn) = (zero3(), [zero3(); 3]);
        for entry in 0..STENCIL {
            let slot = link.slots[entry] as usize;
            let keeps = self.affine_pa_m2[slot];
            if keeps.value() == 0.0 {
                continue;
            }
            let d = grid.offset_m(p, entry);
            let away = sub(add(x, matvec(&f, d.map(T::of))), nodes[slot]);
            let force = mul(away, keeps.scale(link.weights[entry] * volume_m3));
            forces[slot] = add(forces[slot], force);
            pull = add(pull, force);
            for a in 0..3 {
                for b in 0..3 {
                    turn[a][b] += force[a].scale(per_m2 * d[b]);
                }
            }
        }
        for entry in 0..STENCIL {
            let d = grid.offset_m(p, entry).map(T::of);
            let back = scaled(add(pull, matvec(&turn, d)), link.weights[entry]);
            let node = &mut forces[link.slots[entry] as usize];
            *node = sub(*node, back);
        }
    }

    /// Adds what particle `p` gives to the stiffness of those that meet its nodes.
    pub(super) fn add_stiffness(
        &self,
        block: &mut Block,
        (grid, p, volume_m3): (&Grid<f64>, usize, f64),
        mass_kg: f64,
    ) {
        let link = &grid.links[p];
        let weights = per_node(|entry| link.weights[entry]);
        if let Some(across) = &self.across {
            block.add_spring(Y..Y + 1, &weights, mass_kg * across.per_kg);
        }
        let of_node = |entry: usize| volume_m3 * self.affine_pa_m2[link.slots[entry] as usize].value();
        add_affine(block, (grid, p), &weights, &per_node(of_node));
    }
}

/// How little each node sees of the rope: one where it sees nothing, zero from [`SLIGHT`] on.
fn slightness(layout: &RopeLayout, grid: &Grid<f64>) -> Vec<f64> {
    let mut volumes_m3 = vec![0.0; grid.mass_kg.len()];
    for (p, link) in grid.links.iter().enumerate() {
        for (slot, weight) in link.slots.iter().zip(&link.weights) {
            volumes_m3[*slot as usize] += weight * layout.particle_volume_m3(p);
        }
    }
    let seen = volumes_m3.iter().map(|v| v / (SLIGHT * grid.spacing_m.powi(3)));
    seen.map(|share| (1.0 - share).max(0.0)).collect()
}

/// Adds stiffnesses k, N/m, against what of the motion of a particle's nodes is not affine: with their weights w and
/// offsets d, E = ½ Σ k w |y − x − F d|², where x = Σ w y and F = c Σ w y dᵀ with c = 4/dx². Node i moves the affine motion
/// at node j by w_i q_ij with q_ij = 1 + c d_i·d_j.
fn add_affine(block: &mut Block, (grid, p): (&Grid<f64>, usize), weights: &PerNode, stiffness_n_m: &PerNode) {
    if stiffness_n_m.iter().all(|&k| k == 0.0) {
        return;
    }
    let per_m2 = 4.0 / (grid.spacing_m * grid.spacing_m);
    let offsets_m: [PerNode; 3] = [0, 1, 2].map(|k| per_node(|entry| grid.offset_m(p, entry)[k]));
    let mut rows = NOTHING;
    let rows_of_all = &mut rows;
    on_widest!(affine_rows(
        rows_of_all: &mut Rows,
        weights: &PerNode,
        offsets_m: [PerNode; 3],
        stiffness_n_m: &PerNode,
        per_m2: f64
    ) -> ());
    block.add_along(0..3, &rows);
}

/// See [`add_affine`].
#[inline(always)]
fn affine_rows(
    rows: &mut Rows,
    weights: &PerNode,
    offsets_m: [PerNode; 3],
    stiffness_n_m: &PerNode,
    per_m2: f64,
) {
    // Moments of k w, with which Σ k w q_i q_j is had for each pair at once.
    let (mut sum, mut first, mut second) = (0.0, [0.0; 3], [[0.0; 3]; 3]);
    for entry in 0..STENCIL {
        let share = stiffness_n_m[entry] * weights[entry];
        let d = offsets_m.each_ref().map(|along| along[entry]);
        sum += share;
        first = add(first, scaled(d, share));
        second = std::array::from_fn(|a| add(second[a], scaled(d, share * d[a])));
    }
    for (j, row) in rows.iter_mut().enumerate() {
        let d = offsets_m.each_ref().map(|along| along[j]);
        let turned = matvec(&second, d);
        let [linear, square] = [scaled(first, per_m2), scaled(turned, per_m2 * per_m2)];
        let moved = add(linear, square);
        let constant = sum + per_m2 * dot(first, d);
        for (i, entry) in row.iter_mut().enumerate() {
            let along =
                |by: &Vec3<f64>| by[0] * offsets_m[0][i] + by[1] * offsets_m[1][i] + by[2] * offsets_m[2][i];
            let q = 1.0 + per_m2 * along(&d);
            let both = constant + along(&moved);
            *entry = weights[i] * weights[j] * (both - q * (stiffness_n_m[i] + stiffness_n_m[j]));
        }
        row[j] += stiffness_n_m[j] * weights[j];
    }
}
