//! One time step: forces of the particles to the nodes, update of the nodes, their motion to the particles.

use super::axial::axis;
use super::clamp::{KEPT, RigidMotion};
use super::contact::{Contact, Footing, push, rub};
use super::elastic::{Lame, Straining};
use super::error::Cause;
use super::grid::{Grid, Link, STENCIL};
use super::material::{Material, Motion};
use super::pads::Pads;
use super::physics::{ForcePoint, Physics, SliceMotion};
use super::real::{Arithmetic, Real};
use super::rope::RopeLayout;
use super::scene::Scene;
use super::tensor::{Mat3, Vec3, add, mul, scaled, select3, sub, zero3};

/// What moves with the rope.
#[derive(Clone, Copy, Debug)]
pub struct Particle<T> {
    /// Position, m.
    pub position_m: Vec3<T>,
    /// What rounding has left out of the position so far, m.
    pub lost_m: Vec3<T>,
    /// Velocity, m/s.
    pub velocity_m_s: Vec3<T>,
    /// Rate of the deformation gradient, 1/s: the affine velocity field in undeformed coordinates.
    pub deformation_rate: Mat3<T>,
    /// Deformation gradient, from the rope's undeformed coordinates (s, side, up) to the world.
    pub deformation_gradient: Mat3<T>,
    /// Mass, kg.
    pub mass_kg: T,
    /// Undeformed volume, m³.
    pub volume_m3: f64,
    /// Length of rope that the particle stands for, m.
    pub length_m: f64,
    /// Index of the grip that may hold it, and its offset from the grip's first pose, m.
    pub grip: Option<(usize, [f64; 3])>,
}

impl<T> Particle<T> {
    /// Deformation gradient and its rate.
    #[inline(always)]
    pub fn motion(&self) -> Motion<'_, T> {
        (&self.deformation_gradient, &self.deformation_rate)
    }
}

/// Constants of a rollout that every step uses.
pub struct StepContext<'a, T> {
    /// Coefficients and laws.
    pub physics: &'a Physics<T>,
    /// Elastic moduli, Pa.
    pub lame: Lame<T>,
    /// Viscosities, Pa s.
    pub viscosity: Lame<T>,
    /// Time step, s.
    pub dt_s: f64,
    /// Diameter of the rope, m.
    pub diameter_m: f64,
    /// Share of a node's velocity that is replaced in a step by what its particles carry.
    pub forgotten: f64,
    /// Stiffness of a clamp's spring as a multiple of its particle's mass over the square of the time step.
    pub clamp_stiffness: T,
    /// The table.
    pub table: Option<Contact>,
    /// The grips' pads, where they give; none before [`Self::with_pads`].
    pub pads: Option<Pads<T>>,
    /// Particles per slice.
    pub section: usize,
}

/// Time in which nodes forget motions that particles do not carry, s: what of a velocity field is not
/// affine around a particle is not resisted as it should be, and in compressed rope it grows. Measured on a
/// rope of 0.23 m and 0.9 MPa that hangs from a level clamp, on 3 cells: without forgetting its tip creeps by
/// 20 mm within a second after it has come to rest.
const FORGET_S: f64 = 1e-3;

impl<'a, T: Real> StepContext<'a, T> {
    /// For a scene whose slices have `section` particles.
    pub fn new(scene: &Scene, physics: &'a Physics<T>, dt_s: f64, section: usize) -> Self {
        Self {
            physics,
            lame: physics.lame(),
            viscosity: physics.viscosity(&scene.rope),
            dt_s,
            forgotten: -libm::expm1(-dt_s / FORGET_S),
            diameter_m: scene.rope.diameter_m,
            clamp_stiffness: scene.clamp_per_kg(physics.young_pa).scale(dt_s * dt_s),
            table: Contact::of(scene, section),
            pads: None,
            section,
        }
    }

    /// The same with the grips' pads, where they give.
    pub fn with_pads(self, scene: &Scene, layout: &RopeLayout, masses_kg: &[T]) -> Self {
        let pads = Pads::new(scene, self.physics, (layout, masses_kg), self.clamp_per_kg());
        Self { pads, ..self }
    }

    /// Stiffness of a clamp's spring over its particle's mass, 1/s².
    pub fn clamp_per_kg(&self) -> T {
        self.clamp_stiffness.scale(1.0 / (self.dt_s * self.dt_s))
    }
}

/// Advances nodes, particles and material by one step. `motions` holds the motion of each closed grip at the
/// end of the step; `decay` multiplies every velocity (1 outside settling).
#[inline(always)]
pub fn step<T: Real>(
    particles: &mut [Particle<T>],
    material: &mut Material<T>,
    grid: &mut Grid<T>,
    context: &StepContext<T>,
    motions: &[Option<RigidMotion<T>>],
    decay: f64,
) -> Result<(), Cause> {
    particles_to_grid(particles, material, grid, context, motions, decay)?;
    update_nodes(grid, context, decay);
    grid_to_particles(particles, grid, context.dt_s);
    Ok(())
}

/// The first part of a step: sums up at the nodes what the particles, clamps and table give. `decay` is that
/// of the step.
#[inline(always)]
pub fn particles_to_grid<T: Real>(
    particles: &[Particle<T>],
    material: &mut Material<T>,
    grid: &mut Grid<T>,
    context: &StepContext<T>,
    motions: &[Option<RigidMotion<T>>],
    decay: f64,
) -> Result<(), Cause> {
    let carried = decay * context.forgotten;
    grid.clear();
    material.advance(context.physics, context.dt_s, |index| particles[index].motion());
    let mut pushed = zero3();
    for (index, particle) in particles.iter().enumerate() {
        if index % context.section == 0 && !context.physics.force_laws.is_empty() {
            let slice = &particles[index..index + context.section];
            pushed = scaled(force_of_laws(slice, context), context.dt_s);
        }
        let mut field = impulse_field((particle, index), pushed, material, context, grid.spacing_m)?;
        add_momentum(particle, carried, &mut field);
        scatter(&grid.links[index], grid.spacing_m, &field, &mut grid.impulses);
        if let Some((stiffness, change)) = clamp_target(particle, motions, context) {
            scatter_clamp(index, stiffness, change, grid);
        }
    }
    if let Some(table) = &context.table {
        scatter_contact(particles, table, context, grid);
    }
    Ok(())
}

/// The last part of a step: moves the particles with the nodes.
#[inline(always)]
pub fn grid_to_particles<T: Real>(particles: &mut [Particle<T>], grid: &Grid<T>, dt_s: f64) {
    for (index, particle) in particles.iter_mut().enumerate() {
        gather(particle, index, grid, dt_s);
    }
}

/// Impulse that a particle gives to a node at the undeformed offset d: w dt (f − V P 4/dx² d), the
/// force of Hu et al. 2018, eq. 29, with the first Piola-Kirchhoff stress P in place of the Kirchhoff
/// stress because offsets are undeformed.
pub(super) struct ImpulseField<T> {
    pub(super) at_particle: Vec3<T>,
    pub(super) slope: Mat3<T>,
}

#[inline(always)]
fn impulse_field<T: Real>(
    (particle, index): (&Particle<T>, usize),
    pushed: Vec3<T>,
    material: &Material<T>,
    context: &StepContext<T>,
    dx: f64,
) -> Result<ImpulseField<T>, Cause> {
    let (f, rate) = particle.motion();
    let (pk1, j) = material.piola(index, f, context.physics, &context.lame);
    if j.value().is_nan() || j.value() <= 0.0 {
        return Err(inverted_or_not_finite(index, j.value()));
    }
    let viscous = Straining::new(f, rate, &context.viscosity).piola_stress(f);
    let stress_scale = -context.dt_s * particle.volume_m3 * 4.0 / (dx * dx);
    Ok(ImpulseField {
        at_particle: pushed,
        slope: std::array::from_fn(|a| scaled(add(pk1[a], viscous[a]), stress_scale)),
    })
}

/// Adds a share of a particle's momentum, of the affine field m (v + Ḟ d) (Jiang et al. 2015).
#[inline(always)]
fn add_momentum<T: Real>(particle: &Particle<T>, share: f64, field: &mut ImpulseField<T>) {
    let mass = particle.mass_kg.scale(share);
    field.at_particle = add(field.at_particle, mul(particle.velocity_m_s, mass));
    for a in 0..3 {
        field.slope[a] = add(field.slope[a], mul(particle.deformation_rate[a], mass));
    }
}

/// Sum of the force laws on each particle of a slice, N.
fn force_of_laws<T: Real>(slice: &[Particle<T>], context: &StepContext<T>) -> Vec3<T> {
    let members = slice.iter().map(|particle| SliceMotion {
        position_m: particle.position_m,
        velocity_m_s: particle.velocity_m_s,
        axis: axis(&particle.deformation_gradient),
        mass_kg: particle.mass_kg,
    });
    let point = ForcePoint::new(&SliceMotion::mean(members), slice[0].length_m, context.diameter_m);
    context.physics.force_n(&point)
}

/// Why a deformation gradient with this determinant stops a run.
#[cold]
pub fn inverted_or_not_finite(particle: usize, det: f64) -> Cause {
    if det.is_nan() {
        Cause::NonFinite { particle }
    } else {
        Cause::Inverted { particle, det }
    }
}

/// Stiffness of a gripped particle's spring as a mass, κ m, and how much its velocity, as far as it is
/// kept, must change to bring it to its place within the step.
#[inline(always)]
pub(super) fn clamp_target<T: Real>(
    particle: &Particle<T>,
    motions: &[Option<RigidMotion<T>>],
    context: &StepContext<T>,
) -> Option<(T, Vec3<T>)> {
    let (grip, offset_m) = particle.grip?;
    let motion = motions[grip].as_ref()?;
    let gap = sub(motion.place(offset_m), particle.position_m);
    let stiffness = particle.mass_kg * context.clamp_stiffness;
    let asked = sub(
        scaled(gap, 1.0 / context.dt_s),
        scaled(particle.velocity_m_s, KEPT),
    );
    Some((stiffness, asked))
}

#[inline(always)]
pub(super) fn scatter<T: Real>(
    link: &Link<T>,
    spacing_m: f64,
    field: &ImpulseField<T>,
    nodes: &mut [T::Packed],
) {
    let dx = T::base(spacing_m);
    let Link {
        slots,
        weights,
        offset_m,
    } = link;
    // The value at the middle node, and its change from node to node along each axis.
    let slope = &field.slope;
    let mut middle = field.at_particle;
    for a in 0..3 {
        let row = &slope[a];
        middle[a] -= row[0].times(offset_m[0]) + row[1].times(offset_m[1]) + row[2].times(offset_m[2]);
    }
    let along = |b: usize| T::packed_times(T::pack([slope[0][b], slope[1][b], slope[2][b]]), dx);
    let (along_x, along_y, along_z) = (along(0), along(1), along(2));
    let middle = T::pack(middle);
    let planes = [middle - along_x, middle, middle + along_x];
    for i in 0..3 {
        let lines = [planes[i] - along_y, planes[i], planes[i] + along_y];
        for j in 0..3 {
            let impulses = [lines[j] - along_z, lines[j], lines[j] + along_z];
            for k in 0..3 {
                let entry = 9 * i + 3 * j + k;
                nodes[slots[entry] as usize] += T::packed_times(impulses[k], weights[entry]);
            }
        }
    }
}

/// Adds a gripped particle's spring to the clamps' share of its nodes.
pub(super) fn scatter_clamp<T: Real>(index: usize, stiffness: T, change: Vec3<T>, grid: &mut Grid<T>) {
    grid.constrained = true;
    let link = &grid.links[index];
    for entry in 0..STENCIL {
        let share = stiffness.times(link.weights[entry]);
        let node = &mut grid.clamps[link.slots[entry] as usize];
        node[0] += share;
        for k in 0..3 {
            node[k + 1] += change[k] * share;
        }
    }
}

/// Adds the table's push on every slice that touches it.
fn scatter_contact<T: Real>(
    particles: &[Particle<T>],
    table: &Contact,
    context: &StepContext<T>,
    grid: &mut Grid<T>,
) {
    for (slice, members) in particles.chunks(context.section).enumerate() {
        let mean = |of: fn(&Particle<T>) -> T| -> T {
            let sum = members.iter().fold(T::zero(), |sum, p| sum + of(p));
            sum.scale(1.0 / members.len() as f64)
        };
        let gap = mean(|p| p.position_m[2]) - T::of(table.lowest_m);
        let first = &members[0];
        let footing = table.footing(first.length_m, first.volume_m3, first.mass_kg.value());
        let footing = Footing {
            mass_kg: if footing.own > 0.0 {
                first.mass_kg
            } else {
                T::of(footing.mass_kg)
            },
            own: T::of(footing.own),
            ratio: T::of(footing.ratio),
        };
        let impulse = push(gap, mean(|p| p.velocity_m_s[2]), &footing, context.dt_s).impulse;
        if impulse.value() <= 0.0 {
            continue;
        }
        grid.constrained = true;
        for member in 0..members.len() {
            let link = &grid.links[slice * context.section + member];
            for entry in 0..STENCIL {
                grid.contact[link.slots[entry] as usize] += impulse.times(link.weights[entry]);
            }
        }
    }
}

/// Turns impulses into a change of the velocities: settling, weight, table, clamps.
#[inline(always)]
pub fn update_nodes<T: Real>(grid: &mut Grid<T>, context: &StepContext<T>, decay: f64) {
    let fall = scaled(context.physics.gravity_m_s2, context.dt_s);
    let kept = decay * (1.0 - context.forgotten);
    for index in 0..grid.velocities_m_s.len() {
        let change = mul(T::unpack(grid.impulses[index]), grid.inverse_mass[index]);
        let before = T::unpack(grid.velocities_m_s[index]);
        let mut velocity = add(add(scaled(before, kept), change), fall);
        if grid.constrained {
            let push = grid.contact[index] * grid.inverse_mass[index];
            velocity = rub(velocity, push, context.physics.friction);
            velocity = clamp_node(velocity, before, grid.mass_kg[index], &grid.clamps[index]);
        }
        grid.velocities_m_s[index] = T::pack(velocity);
    }
}

/// Implicit springs: (m v + q K u + Σ K_p (gap/dt − q u_p))/(m + K), with the velocity u of the node `before`
/// the step, what the particles make of it, u_p, and the share q ([`KEPT`]).
#[inline(always)]
pub fn clamp_node<T: Arithmetic>(velocity: Vec3<T>, before: Vec3<T>, mass: T, clamp: &[T; 4]) -> Vec3<T> {
    let [stiffness, px, py, pz] = *clamp;
    let held = stiffness.exceeds(T::zero());
    let inverse = T::one() / (mass + stiffness);
    let asked = add(scaled(mul(before, stiffness), KEPT), [px, py, pz]);
    let asked = mul(add(mul(velocity, mass), asked), inverse);
    select3(held, asked, velocity)
}

/// Moves a particle on with its nodes.
#[inline(always)]
fn gather<T: Real>(particle: &mut Particle<T>, index: usize, grid: &Grid<T>, dt_s: f64) {
    let (velocity, rate) = field_of_nodes(&grid.links[index], grid.spacing_m, &grid.velocities_m_s);
    for a in 0..3 {
        let f = &mut particle.deformation_gradient[a];
        *f = add(*f, scaled(rate[a], dt_s));
    }
    particle.deformation_rate = rate;
    particle.velocity_m_s = velocity;
    for a in 0..3 {
        velocity[a].carry_to(T::of(dt_s), &mut particle.position_m[a], &mut particle.lost_m[a]);
    }
}

/// Velocity Σ w v and affine field 4/dx² Σ w v dᵀ that the nodes' velocities give to a particle: the
/// transpose of [`scatter`], with the slope scaled.
#[inline(always)]
pub(super) fn field_of_nodes<T: Real>(
    link: &Link<T>,
    spacing_m: f64,
    nodes: &[T::Packed],
) -> (Vec3<T>, Mat3<T>) {
    let zero = T::pack([T::zero(); 3]);
    // Σ w v (offset along z and y), offsets counted in cells from the middle node.
    let (mut moment_y, mut moment_z) = (zero, zero);
    let mut planes = [zero; 3];
    for i in 0..3 {
        let mut lines = [zero; 3];
        for j in 0..3 {
            let at = |k: usize| {
                let entry = 9 * i + 3 * j + k;
                T::packed_times(nodes[link.slots[entry] as usize], link.weights[entry])
            };
            let (low, high) = (at(0), at(2));
            lines[j] = low + at(1) + high;
            moment_z += high - low;
        }
        planes[i] = lines[0] + lines[1] + lines[2];
        moment_y += lines[2] - lines[0];
    }
    let velocity = T::unpack(planes[0] + planes[1] + planes[2]);
    let moment = [planes[2] - planes[0], moment_y, moment_z].map(T::unpack);
    let dx = T::base(spacing_m);
    let scale = T::base(4.0 / (spacing_m * spacing_m));
    let mut rate = [[T::zero(); 3]; 3];
    for a in 0..3 {
        for b in 0..3 {
            let centred = moment[b][a].times(dx) - velocity[a].times(link.offset_m[b]);
            rate[a][b] = centred.times(scale);
        }
    }
    (velocity, rate)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::initial_particles;
    use crate::sim::rollout::masses_kg;
    use crate::sim::rope::RopeShape;
    use crate::sim::tensor::dot;
    use crate::sim::time_step::fastest_pa;

    const DENSITY_KG_M3: f64 = 1000.0;
    const YOUNG_PA: f64 = 1e6;

    /// ω² ρ dx² of the fastest oscillation of a free rope, by power iteration with forces per mass.
    fn fastest_by_iteration(cells: f64, poisson: f64, shift_cells: [f64; 3]) -> f64 {
        let rope = RopeShape::of_density(0.1, 0.014, DENSITY_KG_M3);
        let mut scene = Scene::new(rope, [0.0; 3], [1.0, 0.0, 0.0], vec![], None, cells, vec![0.1]).unwrap();
        scene.grid.shift_cells = shift_cells;
        let mut physics = Physics::base(YOUNG_PA, poisson, 0.0);
        (physics.loss, physics.gravity_m_s2) = (0.0, [0.0; 3]);
        let layout = scene.layout();
        let masses = masses_kg(&scene, &physics, &layout);
        let still = initial_particles(&scene, &layout, &masses);
        let mut grid = Grid::new(&layout, scene.grid, &masses);
        let mut material = Material::new(&physics, &layout);
        let context = StepContext::new(&scene, &physics, 1.0, layout.section_m.len());
        let mut field: Vec<Vec3<f64>> = (0..grid.mass_kg.len())
            .map(|i| [7919, 104_729, 1_299_709].map(|prime| ((i * prime) % 101) as f64 - 50.0))
            .collect();
        let norm = |field: &[Vec3<f64>], masses: &[f64]| {
            let squares = field.iter().zip(masses).map(|(v, m)| m * dot(*v, *v));
            squares.sum::<f64>().sqrt()
        };
        const SMALL: f64 = 1e-9;
        let mut omega_squared = 0.0;
        for _ in 0..150 {
            let size = SMALL / norm(&field, &grid.mass_kg);
            for (node, v) in grid.velocities_m_s.iter_mut().zip(&field) {
                *node = f64::pack(scaled(*v, size));
            }
            let mut particles = still.clone();
            grid_to_particles(&mut particles, &grid, 1.0);
            particles_to_grid(&particles, &mut material, &mut grid, &context, &[], 0.0).unwrap();
            for (v, (&impulse, &mass)) in field.iter_mut().zip(grid.impulses.iter().zip(&grid.mass_kg)) {
                *v = scaled(f64::unpack(impulse), -1.0 / mass);
            }
            omega_squared = norm(&field, &grid.mass_kg) / SMALL;
        }
        omega_squared * DENSITY_KG_M3 * scene.grid.spacing_m.powi(2)
    }

    /// The time step rests on this bound; it is also not so far off that steps would be wasted.
    #[test]
    fn the_bound_of_the_fastest_oscillation_holds() {
        for cells in [1.5, 2.2] {
            for poisson in [0.0, 0.2, 0.35, 0.49] {
                for shift in [0.0, 0.25, 0.5] {
                    let found = fastest_by_iteration(cells, poisson, [shift; 3]);
                    let share = found / fastest_pa(&Lame::new(YOUNG_PA, poisson));
                    assert!(
                        share < 1.0 && share > 0.75,
                        "{cells} cells, ν = {poisson}: {share}"
                    );
                }
            }
        }
    }
}
