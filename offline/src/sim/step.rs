//! One time step of MLS-MPM: particles to grid, grid update, grid to particles.

use super::clamp::{RigidMotion, STIFFNESS};
use super::elastic::{Lame, piola_stress};
use super::error::Cause;
use super::grid::{Grid, Link, STENCIL};
use super::physics::{ForcePoint, Physics, StressPoint};
use super::real::{Arithmetic, Real};
use super::tensor::{Mat3, Vec3, add, dot, matmul, matmul_transposed, mul, scaled, sub, transpose_inverse};

/// What moves with the rope.
#[derive(Clone, Copy, Debug)]
pub struct Particle<T> {
    /// Position, m.
    pub position_m: Vec3<T>,
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

/// Constants of a rollout that every step uses.
pub struct StepContext<'a, T> {
    /// Coefficients and laws.
    pub physics: &'a Physics<T>,
    /// Elastic moduli.
    pub lame: Lame<T>,
    /// Time step, s.
    pub dt_s: f64,
    /// Diameter of the rope, m.
    pub diameter_m: f64,
    /// Height of the table, m.
    pub table_m: Option<f64>,
    /// Particles per slice.
    pub section: usize,
}

/// Advances the particles by one step. `motions` holds the motion of each closed grip at the end of
/// the step; `decay` multiplies every velocity (1 outside settling).
#[inline(always)]
pub fn step<T: Real>(
    particles: &mut [Particle<T>],
    grid: &mut Grid<T>,
    context: &StepContext<T>,
    motions: &[Option<RigidMotion<T>>],
    decay: f64,
) -> Result<(), Cause> {
    particles_to_grid(particles, grid, context, motions)?;
    update_nodes(grid, context, decay);
    grid_to_particles(particles, grid, context.dt_s);
    Ok(())
}

/// The first part of a step: sums up at the nodes what the particles, clamps and table give.
#[inline(always)]
pub fn particles_to_grid<T: Real>(
    particles: &[Particle<T>],
    grid: &mut Grid<T>,
    context: &StepContext<T>,
    motions: &[Option<RigidMotion<T>>],
) -> Result<(), Cause> {
    grid.clear();
    for (index, particle) in particles.iter().enumerate() {
        let field = momentum_field(particle, context, grid.spacing_m, index)?;
        scatter(&grid.links[index], grid.spacing_m, &field, &mut grid.nodes);
        if let Some((stiffness, velocity)) = clamp_target(particle, motions, context.dt_s) {
            scatter_clamp(index, stiffness, velocity, grid);
        }
    }
    if let Some(table_m) = context.table_m {
        scatter_contact(particles, table_m, context, grid);
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

/// Momentum that a particle gives to a node at the undeformed offset d:
/// w (m v + dt f + (m Ḟ − dt V P 4/dx²) d), Hu et al. 2018, eq. 29, with the first Piola-Kirchhoff
/// stress P in place of the Kirchhoff stress because offsets are undeformed.
pub(super) struct MomentumField<T> {
    pub(super) at_particle: Vec3<T>,
    pub(super) slope: Mat3<T>,
}

#[inline(always)]
fn momentum_field<T: Real>(
    particle: &Particle<T>,
    context: &StepContext<T>,
    dx: f64,
    index: usize,
) -> Result<MomentumField<T>, Cause> {
    let f = &particle.deformation_gradient;
    let (mut pk1, j) = piola_stress(f, &context.lame);
    if j.value().is_nan() || j.value() <= 0.0 {
        return Err(inverted_or_not_finite(index, j.value()));
    }
    if !context.physics.stress_laws.is_empty() {
        add_stress_laws(particle, context, j, &mut pk1);
    }
    let stress_scale = -context.dt_s * particle.volume_m3 * 4.0 / (dx * dx);
    let m = particle.mass_kg;
    let mut slope = particle.deformation_rate;
    for a in 0..3 {
        slope[a] = add(mul(slope[a], m), scaled(pk1[a], stress_scale));
    }
    let mut at_particle = mul(particle.velocity_m_s, m);
    if !context.physics.force_laws.is_empty() {
        let force_n = force_of_laws(particle, context);
        at_particle = add(at_particle, scaled(force_n, context.dt_s));
    }
    Ok(MomentumField { at_particle, slope })
}

/// Sum of the force laws, N.
pub(super) fn force_of_laws<T: Real>(particle: &Particle<T>, context: &StepContext<T>) -> Vec3<T> {
    let f = &particle.deformation_gradient;
    let axis = [f[0][0], f[1][0], f[2][0]];
    let point = ForcePoint {
        position_m: particle.position_m,
        velocity_m_s: particle.velocity_m_s,
        tangent: mul(axis, T::one() / dot(axis, axis).sqrt()),
        length_m: particle.length_m,
        diameter_m: context.diameter_m,
        mass_kg: particle.mass_kg,
    };
    let laws = &context.physics.force_laws;
    laws.iter()
        .fold([T::zero(); 3], |sum, law| add(sum, law.force_n(&point)))
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

/// Adds the Kirchhoff stresses τ of the laws as P = τ F⁻ᵀ.
pub(super) fn add_stress_laws<T: Real>(
    particle: &Particle<T>,
    context: &StepContext<T>,
    j: T,
    pk1: &mut Mat3<T>,
) {
    let f = &particle.deformation_gradient;
    let inverse_transposed = transpose_inverse(f);
    // L = Ḟ F⁻¹.
    let velocity_gradient = matmul_transposed(&particle.deformation_rate, &inverse_transposed);
    for law in &context.physics.stress_laws {
        let kirchhoff = law.kirchhoff_pa(&StressPoint {
            deformation_gradient: f,
            velocity_gradient: &velocity_gradient,
            volume_ratio: j,
            lame: &context.lame,
        });
        let extra = matmul(&kirchhoff, &inverse_transposed);
        for a in 0..3 {
            pk1[a] = add(pk1[a], extra[a]);
        }
    }
}

/// Stiffness of a gripped particle's spring as a mass, κ m, and the velocity that would bring it to
/// its place within the step.
#[inline(always)]
pub(super) fn clamp_target<T: Real>(
    particle: &Particle<T>,
    motions: &[Option<RigidMotion<T>>],
    dt_s: f64,
) -> Option<(T, Vec3<T>)> {
    let (grip, offset_m) = particle.grip?;
    let motion = motions[grip].as_ref()?;
    let gap = sub(motion.place(offset_m), particle.position_m);
    Some((particle.mass_kg.scale(STIFFNESS), scaled(gap, 1.0 / dt_s)))
}

#[inline(always)]
pub(super) fn scatter<T: Real>(
    link: &Link<T>,
    spacing_m: f64,
    field: &MomentumField<T>,
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
            let momenta = [lines[j] - along_z, lines[j], lines[j] + along_z];
            for k in 0..3 {
                let entry = 9 * i + 3 * j + k;
                nodes[slots[entry] as usize] += T::packed_times(momenta[k], weights[entry]);
            }
        }
    }
}

/// Adds a gripped particle's spring to the clamps' share of its nodes.
pub(super) fn scatter_clamp<T: Real>(index: usize, stiffness: T, velocity: Vec3<T>, grid: &mut Grid<T>) {
    grid.constrained = true;
    let link = &grid.links[index];
    for entry in 0..STENCIL {
        let share = stiffness.times(link.weights[entry]);
        let node = &mut grid.clamps[link.slots[entry] as usize];
        node[0] += share;
        for k in 0..3 {
            node[k + 1] += velocity[k] * share;
        }
    }
}

/// Slices nearer to the table than this share of a cell take part in contact; the constraint itself
/// is exact, this only skips slices that cannot touch within the step.
pub const CONTACT_NEAR_CELLS: f64 = 0.1;

/// Adds the table's springs for every slice near the table: a slice's centre may not come nearer than
/// the rope's radius, and may not move down by more than its gap within the step. This is the contact
/// of a row of spheres; a lying rope touches as it should, and its end counts as round.
pub(super) fn scatter_contact<T: Real>(
    particles: &[Particle<T>],
    table_m: f64,
    context: &StepContext<T>,
    grid: &mut Grid<T>,
) {
    for (slice, members) in particles.chunks(context.section).enumerate() {
        let Some(asked) = asked_of_slice(members, table_m, context, grid.spacing_m) else {
            continue;
        };
        grid.constrained = true;
        for (member, p) in members.iter().enumerate() {
            let link = &grid.links[slice * context.section + member];
            let stiffness = p.mass_kg.scale(STIFFNESS);
            for entry in 0..STENCIL {
                let weight = stiffness.times(link.weights[entry]);
                let node = &mut grid.contact[link.slots[entry] as usize];
                node[0] += weight;
                node[1] += weight * asked;
            }
        }
    }
}

/// Upward velocity that brings a slice onto the table within the step; none where it is not near.
pub(super) fn asked_of_slice<T: Real>(
    members: &[Particle<T>],
    table_m: f64,
    context: &StepContext<T>,
    spacing_m: f64,
) -> Option<T> {
    let lowest = T::of(table_m + 0.5 * context.diameter_m);
    let mut height = T::zero();
    for p in members {
        height += p.position_m[2];
    }
    let gap = height.scale(1.0 / members.len() as f64) - lowest;
    (gap.value() <= CONTACT_NEAR_CELLS * spacing_m).then(|| -gap.scale(1.0 / context.dt_s))
}

/// Turns momenta into velocities: weight, settling, table, clamps.
#[inline(always)]
pub fn update_nodes<T: Real>(grid: &mut Grid<T>, context: &StepContext<T>, decay: f64) {
    let fall = scaled(context.physics.gravity_m_s2, context.dt_s);
    for index in 0..grid.nodes.len() {
        let free = mul(T::unpack(grid.nodes[index]), grid.inverse_mass[index]);
        let velocity = add(scaled(free, decay), fall);
        if !grid.constrained {
            grid.nodes[index] = T::pack(velocity);
            continue;
        }
        let mass = grid.mass_kg[index];
        let velocity = table_contact(velocity, mass, &grid.contact[index], context.physics.friction);
        grid.nodes[index] = T::pack(clamp_node(velocity, mass, &grid.clamps[index]));
    }
}

/// Unilateral contact with Coulomb friction. The table's implicit springs ask for an upward velocity
/// (m v + K v_asked)/(m + K); they only push. Friction takes from the tangential velocity at most μ
/// times what the push added. In stick the tangential velocity is zero, and so is its derivative
/// with respect to μ.
#[inline(always)]
pub fn table_contact<T: Arithmetic>(velocity: Vec3<T>, mass: T, contact: &[T; 2], friction: T) -> Vec3<T> {
    let ([stiffness, asked], [vx, vy, vz]) = (*contact, velocity);
    let (zero, one) = (T::zero(), T::one());
    let held = (vz * mass + asked) / (mass + stiffness);
    let near = stiffness.exceeds(zero);
    let push = T::select(near, held - vz, zero);
    let square = vx * vx + vy * vy;
    let moves = square.exceeds(T::of(f64::from(f32::MIN_POSITIVE)));
    let speed = T::select(moves, square, one).sqrt();
    let kept = T::select(moves, one - friction * push / speed, zero);
    let kept = T::select(kept.exceeds(zero), kept, zero);
    let touches = push.exceeds(zero);
    [
        T::select(touches, vx * kept, vx),
        T::select(touches, vy * kept, vy),
        T::select(touches, held, vz),
    ]
}

/// Implicit springs: (m v + K v_clamp) / (m + K).
#[inline(always)]
pub fn clamp_node<T: Arithmetic>(velocity: Vec3<T>, mass: T, clamp: &[T; 4]) -> Vec3<T> {
    let [stiffness, px, py, pz] = *clamp;
    let held = stiffness.exceeds(T::zero());
    let inverse = T::one() / (mass + stiffness);
    let asked = mul(add(mul(velocity, mass), [px, py, pz]), inverse);
    std::array::from_fn(|k| T::select(held, asked[k], velocity[k]))
}

/// Moves a particle on with its nodes.
#[inline(always)]
fn gather<T: Real>(particle: &mut Particle<T>, index: usize, grid: &Grid<T>, dt_s: f64) {
    let (velocity, rate) = field_of_nodes(&grid.links[index], grid.spacing_m, &grid.nodes);
    for a in 0..3 {
        let f = &mut particle.deformation_gradient[a];
        *f = add(*f, scaled(rate[a], dt_s));
    }
    particle.deformation_rate = rate;
    particle.velocity_m_s = velocity;
    particle.position_m = add(particle.position_m, scaled(velocity, dt_s));
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
