//! What holds where a rope hangs still: the forces of the simulator's own discretisation, and a step of Newton's
//! method towards the state in which they vanish ([`super::rest`] takes the steps).
//!
//! Weights are functions of undeformed coordinates, so positions and deformation gradients of the
//! particles are linear in the positions of the nodes, and a state in which a rollout stays at rest is
//! one in which the forces at the nodes vanish: stress, weight, laws, clamps. That system is solved
//! directly; a damped rollout to the same state takes some thousand times as many operations. The
//! tangent matrix is that of the elastic rope in its stress-free shape, without axial laws. Numbers with
//! tangents go through the same iteration, so that what comes out carries the exact derivatives of the rest state.
//!
//! It takes double precision: nodes at the rope's surface are held by so little of it that single
//! precision loses them.

use super::axial::axis;
use super::band::{Band, Factor};
use super::clamp::RigidMotion;
use super::curve::Curve;
use super::elastic::Lame;
use super::error::Cause;
use super::grid::{Grid, Link, STENCIL};
use super::material::Material;
use super::pads::Pads;
use super::physics::{ForcePoint, Physics, SliceMotion};
use super::props::Props;
use super::real::Real;
use super::rest::Near;
use super::rollout::{grip_motions, masses_kg};
use super::rope::RopeLayout;
use super::scene::Scene;
use super::softness::Softness;
use super::stiffness::meeting;
use super::tensor::{Mat3, Vec3, add, cross, det, mul, scaled, sub, zero3};
use std::collections::BTreeMap;

/// A spring that pulls the rope's axis to a point where it was seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pin {
    /// Arc length, m.
    pub arc_m: f64,
    /// Where it was seen, m.
    pub target_m: [f64; 3],
    /// Stiffness, N/m.
    pub stiffness_n_m: f64,
}

/// One pose to find: when the clamps had it, a first guess, and springs that hold it.
#[derive(Clone, Debug)]
pub struct Pose {
    /// Time on the clamps' paths, s.
    pub t_s: f64,
    /// First guess.
    pub guess: Curve,
    /// Springs; none where the rope hangs free.
    pub pins: Vec<Pin>,
    /// Where a rope much like it was at rest: the search starts there, and at the guess only if that leads nowhere.
    pub near: Option<Near>,
}

/// Largest change of a deformation gradient in one step.
const STEP_CAP: f64 = 0.3;
/// Least share of its volume that a particle keeps in one step.
const VOLUME_KEPT: f64 = 0.3;
/// Share of a step below which nothing is gained by a smaller one.
const SMALLEST_SHARE: f64 = 1e-3;
/// Share of its diagonal that is added to the matrix: some nodes are held by almost no particle.
const REGULARISATION: f64 = 1e-9;

/// The rest states of one rope.
pub struct Statics<'a, T: Real> {
    pub(super) scene: &'a Scene,
    physics: &'a Physics<T>,
    pub(super) layout: RopeLayout,
    pub(super) grid: Grid<f64>,
    pub(super) masses_kg: Vec<T>,
    pub(super) lame: Lame<T>,
    /// The material, of which nothing is taken down yet.
    pub(super) material: Material<T>,
    /// Stiffness of the clamps' springs per mass, 1/s², that of the rollout.
    pub(super) clamp_per_kg: T,
    /// The grips' pads, where they give.
    pads: Option<Pads<T>>,
    /// The grip that may hold each particle, and where it belongs in it.
    gripped: Vec<Option<(usize, [f64; 3])>>,
    /// Particles that meet the same nodes.
    pub(super) meeting: Vec<Vec<usize>>,
    /// Place of each node in the matrix, along the rope.
    pub(super) place: Vec<usize>,
    band: usize,
}

/// Where each grip stands that is closed.
pub(super) type Motions<T> = Vec<Option<RigidMotion<T>>>;
/// A pin as a row of node weights.
pub(super) type PinRow = (Pin, Vec<(usize, f64)>);

/// What holds a rope besides its own forces.
pub(super) struct Hold<'a, T> {
    /// Where the closed grips stand, as recorded.
    pub(super) motions: &'a Motions<T>,
    pub(super) pins: &'a [PinRow],
    pub(super) props: Option<&'a Props<T>>,
}

/// The matrices of a search for a rest state, in memory that is used again.
pub(super) struct Matrices {
    tangent: Band,
    factor: Factor,
    /// What the grips' pads take from the stiffness of their springs; none where they do not give.
    softness: Option<Softness>,
    /// Masses of the nodes, kg, by their place in the matrices.
    mass_kg: Vec<f64>,
}

/// A step of Newton's method: the whole step, the share of it that was taken, and how far the whole one moves the
/// node that it moves most, m.
pub(super) struct Advance<T> {
    pub(super) step: Nodes<T>,
    pub(super) share: f64,
    pub(super) moved_m: f64,
}

/// Positions of the nodes, m.
pub type Nodes<T> = Vec<Vec3<T>>;

impl<'a, T: Real> Statics<'a, T> {
    /// The rope of a scene.
    pub fn new(scene: &'a Scene, physics: &'a Physics<T>) -> Self {
        let layout = scene.layout();
        let masses_kg = masses_kg(scene, physics, &layout);
        let values: Vec<f64> = masses_kg.iter().map(|m| m.value()).collect();
        let grid = Grid::<f64>::new(&layout, scene.grid, &values);
        let lame = physics.lame();
        let material = Material::new(physics, &layout);
        let clamp_per_kg = scene.clamp_per_kg(physics.young_pa);
        let particles = 0..layout.particles();
        let mut statics = Self {
            pads: Pads::new(scene, physics, (&layout, &masses_kg), clamp_per_kg),
            gripped: particles
                .map(|p| scene.grip_offset(layout.material_m(p)))
                .collect(),
            scene,
            physics,
            layout,
            meeting: meeting(&grid),
            grid,
            masses_kg,
            lame,
            material,
            clamp_per_kg,
            place: Vec::new(),
            band: 0,
        };
        let along: Vec<f64> = statics
            .grid
            .nodes_material_m(&statics.layout)
            .iter()
            .map(|m| m[0])
            .collect();
        let mut order: Vec<usize> = (0..along.len()).collect();
        order.sort_by(|&a, &b| along[a].total_cmp(&along[b]));
        statics.place = vec![0; order.len()];
        for (place, &node) in order.iter().enumerate() {
            statics.place[node] = place;
        }
        // A law that bends a slice ties all of its nodes together, which in many rings no member does.
        let spread = |slice: &[Link<f64>]| {
            let places = slice.iter().flat_map(|link| &link.slots);
            let places = places.map(|&slot| statics.place[slot as usize]);
            places.clone().max().unwrap_or(0) - places.min().unwrap_or(0)
        };
        let members = statics.layout.section_m.len();
        let slices = statics.grid.links.chunks(members);
        let widest = slices.map(spread).max().unwrap_or(0);
        // A pin ties two neighbouring slices, which may reach one plane further.
        let pinned = scene
            .start
            .hang()
            .is_some_and(|hang| hang.poses.iter().any(|pose| !pose.pins.is_empty()));
        let plane = along.len() as f64 * scene.grid.spacing_m / scene.rope.length_m;
        let further = if pinned { plane.ceil() as usize } else { 0 };
        statics.band = 3 * (widest + further) + 2;
        statics
    }

    /// Position and deformation gradient of particle `p`.
    pub fn particle(&self, nodes: &[Vec3<T>], p: usize) -> (Vec3<T>, Mat3<T>) {
        gather(&self.grid, nodes, p)
    }

    /// Force of each grip on the rope, N.
    pub fn grip_forces_n(&self, nodes: &[Vec3<T>], pose: &Pose) -> Vec<Vec3<T>> {
        let mut forces = vec![zero3(); self.scene.grips.len()];
        let motions = self.turned(&self.motions(pose.t_s), |p| self.particle(nodes, p).0);
        for (p, gripped) in self.gripped.iter().enumerate() {
            if let (Some((grip, _)), Some(target)) = (*gripped, self.target(&motions, p)) {
                let spring = self.masses_kg[p] * self.clamp_per_kg;
                let gap = sub(target, self.particle(nodes, p).0);
                forces[grip] = add(forces[grip], mul(gap, spring));
            }
        }
        forces
    }

    /// Squared frequency of a pendulum as long as the rope, 1/s².
    pub(super) fn swing_per_s2(&self) -> f64 {
        (-self.physics.gravity_m_s2[2].value()).max(1.0) / self.scene.rope.length_m
    }

    /// Where the closed grips stand at a time, as recorded.
    pub(super) fn motions(&self, t_s: f64) -> Motions<T> {
        grip_motions(self.scene, self.physics, t_s, 0.0)
    }

    /// The same as pads let them turn that hold particles in these places, m.
    fn turned(&self, motions: &Motions<T>, place_m: impl Fn(usize) -> Vec3<T>) -> Motions<T> {
        let mut turned = motions.clone();
        if let Some(pads) = &self.pads {
            let members = self.layout.section_m.len();
            pads.turn(&mut turned, |[slice, member]| place_m(slice * members + member));
        }
        turned
    }

    /// Where the grips want a particle, m; none where it is free.
    pub(super) fn target(&self, motions: &Motions<T>, particle: usize) -> Option<Vec3<T>> {
        let (grip, offset_m) = self.gripped[particle]?;
        motions[grip].as_ref().map(|motion| motion.place(offset_m))
    }

    /// Each pin as a row of node weights.
    pub(super) fn pin_rows(&self, pins: &[Pin]) -> Vec<PinRow> {
        let arcs: Vec<f64> = self.layout.slices.iter().map(|s| s.arc_m).collect();
        let members = self.layout.section_m.len();
        pins.iter()
            .map(|pin| {
                let (low, share) = crate::observe::bracket(&arcs, pin.arc_m);
                let mut row = BTreeMap::<usize, f64>::new();
                for (slice, weight) in [(low, 1.0 - share), (low + 1, share)] {
                    for p in slice * members..(slice + 1) * members {
                        let link = &self.grid.links[p];
                        for (slot, w) in link.slots.iter().zip(&link.weights) {
                            *row.entry(*slot as usize).or_default() += w * weight / members as f64;
                        }
                    }
                }
                (*pin, row.into_iter().collect())
            })
            .collect()
    }

    /// Forces at the nodes, N.
    pub(super) fn forces(&self, nodes: &[Vec3<T>], hold: &Hold<T>) -> Result<Nodes<T>, Cause> {
        let scale = 4.0 / (self.grid.spacing_m * self.grid.spacing_m);
        let mut forces = vec![zero3(); nodes.len()];
        let particles: Vec<(Vec3<T>, Mat3<T>)> = (0..self.grid.links.len())
            .map(|p| self.particle(nodes, p))
            .collect();
        let mut material = self.material.clone();
        material.rest(self.physics, |p| &particles[p].1);
        let motions = self.turned(hold.motions, |p| particles[p].0);
        let section = self.layout.section_m.len();
        let mut pushed = zero3();
        for (p, link) in self.grid.links.iter().enumerate() {
            if p % section == 0 {
                pushed = self.law_force(p, &particles[p..p + section]);
            }
            let (x, f) = particles[p];
            let mass = self.masses_kg[p];
            let stress = self.stress(&material, p, &f)?;
            let volume = self.layout.particle_volume_m3(p);
            let mut body = add(mul(self.physics.gravity_m_s2, mass), pushed);
            if let Some(target) = self.target(&motions, p) {
                let spring = mass * self.clamp_per_kg;
                body = add(body, mul(sub(target, x), spring));
            }
            if let Some(props) = hold.props {
                body = add(body, props.spring_n(p, &x, mass));
                props.add_forces(&mut forces, nodes, (&self.grid, p, volume), particles[p]);
            }
            for entry in 0..STENCIL {
                let weight = link.weights[entry];
                let d = self.grid.offset_m(p, entry);
                let inner: Vec3<T> = std::array::from_fn(|a| {
                    stress[a][0].scale(d[0]) + stress[a][1].scale(d[1]) + stress[a][2].scale(d[2])
                });
                let force = sub(scaled(body, weight), scaled(inner, volume * scale * weight));
                let node = &mut forces[link.slots[entry] as usize];
                *node = add(*node, force);
            }
        }
        for (pin, row) in hold.pins {
            let at = row
                .iter()
                .fold(zero3(), |sum, (node, w)| add(sum, scaled(nodes[*node], *w)));
            let pull = scaled(sub(pin.target_m.map(T::of), at), pin.stiffness_n_m);
            for (node, w) in row {
                forces[*node] = add(forces[*node], scaled(pull, *w));
            }
        }
        Ok(forces)
    }

    /// First Piola-Kirchhoff stress of a particle at rest, Pa.
    fn stress(&self, material: &Material<T>, particle: usize, f: &Mat3<T>) -> Result<Mat3<T>, Cause> {
        let (pk1, j) = material.piola(particle, f, self.physics, &self.lame);
        if j.value().is_nan() || j.value() <= 0.0 {
            return Err(Cause::Inverted {
                particle,
                det: j.value(),
            });
        }
        Ok(pk1)
    }

    /// Force of the laws on each particle of the slice that begins with particle `first`, N.
    fn law_force(&self, first: usize, slice: &[(Vec3<T>, Mat3<T>)]) -> Vec3<T> {
        if self.physics.force_laws.is_empty() {
            return zero3();
        }
        let members = slice.iter().zip(&self.masses_kg[first..]);
        let members = members.map(|((position_m, f), &mass_kg)| SliceMotion {
            position_m: *position_m,
            velocity_m_s: zero3(),
            axis: axis(f),
            mass_kg,
        });
        let length_m = self.layout.particle_length_m(first);
        let mean = SliceMotion::mean(members);
        let point = ForcePoint::new(&mean, length_m, self.scene.rope.diameter_m);
        self.physics.force_n(&point)
    }

    /// Room for the matrices of a search.
    pub(super) fn matrices(&self) -> Matrices {
        let size = 3 * self.place.len();
        let mut mass_kg = vec![0.0; self.place.len()];
        for (place, mass) in self.place.iter().zip(&self.grid.mass_kg) {
            mass_kg[*place] = *mass;
        }
        Matrices {
            tangent: Band::new(size, self.band),
            factor: Factor::new(size, self.band),
            softness: None,
            mass_kg,
        }
    }

    /// Factorises the elastic tangent matrix with clamps and pins, made positive definite by as much inertia
    /// (1/s², times the nodes' masses) as it takes.
    pub(super) fn factorise(
        &self,
        matrices: &mut Matrices,
        (nodes, hold): (&[Vec3<T>], &Hold<T>),
        inertia: &mut f64,
        inertia_least: f64,
    ) -> Result<(), Cause> {
        let Matrices {
            tangent,
            factor,
            softness,
            mass_kg,
        } = matrices;
        self.fill_tangent(tangent, nodes, hold);
        while inertia.is_finite() {
            let more = |at: usize| *inertia * mass_kg[at / 3] + REGULARISATION * tangent.entry(at, at);
            if factor.factorise(tangent, more) {
                *softness = self.softness(factor, nodes, hold);
                return Ok(());
            }
            *inertia = (4.0 * *inertia).max(inertia_least);
        }
        Err(Cause::NonFinite { particle: 0 })
    }

    /// What the grips' pads take from the stiffness of their springs.
    fn softness(&self, factor: &Factor, nodes: &[Vec3<T>], hold: &Hold<T>) -> Option<Softness> {
        let pads = self.pads.as_ref()?;
        let motions = self.turned(hold.motions, |p| self.particle(nodes, p).0);
        let members = self.layout.section_m.len();
        let mut slopes = Vec::new();
        for slope in pads.slopes(&motions) {
            // Forces at the nodes per turn of a grip about each axis, N/rad.
            let mut pulls = [0, 1, 2].map(|_| vec![0.0; 3 * nodes.len()]);
            for ([slice, member], arm_m, spring_n_m) in slope.held {
                let link = &self.grid.links[slice * members + member];
                for (slot, weight) in link.slots.iter().zip(&link.weights) {
                    for (axis, pull) in pulls.iter_mut().enumerate() {
                        let mut turn = zero3();
                        turn[axis] = spring_n_m * weight;
                        for (k, force) in cross(turn, arm_m).into_iter().enumerate() {
                            pull[3 * self.place[*slot as usize] + k] += force;
                        }
                    }
                }
            }
            slopes.push((slope.turn_per_torque, pulls));
        }
        Some(Softness::new(factor, slopes))
    }

    /// Moves the nodes by as much as is admissible of a step with the matrix as it was factorised last.
    pub(super) fn advance(
        &self,
        nodes: &mut Nodes<T>,
        matrices: &Matrices,
        forces: &[Vec3<T>],
    ) -> Advance<T> {
        let step = self.newton_step(matrices, forces);
        let share = self.admissible_share(nodes, &step);
        for (node, change) in nodes.iter_mut().zip(&step) {
            *node = add(*node, scaled(*change, share));
        }
        let moved_m = step.iter().map(|d| norm_value(*d)).fold(0.0, f64::max);
        Advance { step, share, moved_m }
    }

    /// Solves for value and tangents alike, in double precision.
    fn newton_step(&self, matrices: &Matrices, forces: &[Vec3<T>]) -> Nodes<T> {
        let size = 3 * forces.len();
        let lanes: Vec<Vec<f64>> = (0..=T::TANGENTS)
            .map(|lane| {
                let mut x = vec![0.0; size];
                for (node, force) in forces.iter().enumerate() {
                    for k in 0..3 {
                        x[3 * self.place[node] + k] = match lane {
                            0 => force[k].value(),
                            _ => force[k].tangent(lane - 1),
                        };
                    }
                }
                matrices.factor.solve(&mut x);
                if let Some(softness) = &matrices.softness {
                    softness.correct(&mut x);
                }
                x
            })
            .collect();
        let number = |at: usize| T::with_tangents(lanes[0][at], |t| lanes[t + 1][at]);
        let node = |node: usize| std::array::from_fn(|k| number(3 * self.place[node] + k));
        (0..forces.len()).map(node).collect()
    }

    /// The share of a step that changes no deformation gradient by more than [`STEP_CAP`] and takes no more than
    /// [`VOLUME_KEPT`] of any particle's volume.
    fn admissible_share(&self, nodes: &[Vec3<T>], step: &[Vec3<T>]) -> f64 {
        let values = [nodes, step].map(|list| list.iter().map(|y| y.map(T::value)).collect::<Nodes<f64>>());
        // The map from nodes to gradients is linear.
        let moves: Vec<[Mat3<f64>; 2]> = (0..self.layout.particles())
            .map(|p| values.each_ref().map(|list| gather(&self.grid, list, p).1))
            .collect();
        let size = |[_, change]: &[Mat3<f64>; 2]| change.iter().flatten().map(|c| c * c).sum::<f64>().sqrt();
        let largest = moves.iter().map(size).fold(0.0, f64::max);
        let mut share = (STEP_CAP / largest).min(1.0);
        let turns_inside_out = |[f, change]: &[Mat3<f64>; 2], share: f64| {
            let moved = std::array::from_fn(|a| add(f[a], scaled(change[a], share)));
            det(&moved) < VOLUME_KEPT * det(f)
        };
        while share > SMALLEST_SHARE && moves.iter().any(|m| turns_inside_out(m, share)) {
            share *= 0.5;
        }
        share
    }

    /// Refuses a pose in which the rope would yield: where it comes to rest then depends on how it got there.
    pub(super) fn below_yield(&self, nodes: &[Vec3<T>]) -> Result<(), Cause> {
        let yields = |p: &usize| {
            let (_, f) = self.particle(nodes, *p);
            self.material.yields(*p, &f, self.physics)
        };
        match (0..self.layout.particles()).find(yields) {
            Some(particle) => Err(Cause::YieldsAtRest { particle }),
            None => Ok(()),
        }
    }

    /// Refuses a pose in which the rope would lie on the table.
    pub(super) fn above_table(&self, nodes: &[Vec3<T>]) -> Result<(), Cause> {
        let Some(table) = self.scene.table else {
            return Ok(());
        };
        let heights = (0..self.layout.particles()).map(|p| self.particle(nodes, p).0[2].value());
        let lowest_m = heights.fold(f64::INFINITY, f64::min);
        if lowest_m < table.height_m {
            return Err(Cause::RestsOnTable { lowest_m });
        }
        Ok(())
    }
}

/// Position and deformation gradient of a grid's particle `p`.
pub(super) fn gather<R: Real>(grid: &Grid<f64>, nodes: &[Vec3<R>], p: usize) -> (Vec3<R>, Mat3<R>) {
    let link = &grid.links[p];
    let scale = 4.0 / (grid.spacing_m * grid.spacing_m);
    let (mut x, mut f) = (zero3(), [zero3(); 3]);
    // Differences to one node keep digits: the gradient of a constant is zero.
    let origin = nodes[link.slots[13] as usize];
    for entry in 0..STENCIL {
        let (weight, d) = (link.weights[entry], grid.offset_m(p, entry));
        let y = sub(nodes[link.slots[entry] as usize], origin);
        x = add(x, scaled(y, weight));
        for a in 0..3 {
            for b in 0..3 {
                f[a][b] += y[a].scale(scale * weight * d[b]);
            }
        }
    }
    (add(x, origin), f)
}

/// Length of the value, without tangents.
fn norm_value<T: Real>(v: Vec3<T>) -> f64 {
    v.iter().map(|c| c.value().powi(2)).sum::<f64>().sqrt()
}
