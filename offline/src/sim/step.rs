//! One time step of MLS-MPM: particles to grid, grid update, grid to particles.

use super::clamp::{RigidMotion, STIFFNESS};
use super::elastic::{Lame, kirchhoff_stress};
use super::error::Cause;
use super::grid::{Grid, Node};
use super::kernel::weights;
use super::physics::{ForcePoint, Physics, StressPoint};
use super::real::Real;
use super::tensor::{Mat3, Vec3, add, dot, matmul, matvec, mul, scaled, sub, value3};

/// What moves with the rope.
#[derive(Clone, Copy, Debug)]
pub struct Particle<T> {
    /// Position, m.
    pub position_m: Vec3<T>,
    /// Velocity, m/s.
    pub velocity_m_s: Vec3<T>,
    /// Affine velocity field, 1/s.
    pub affine: Mat3<T>,
    /// Deformation gradient.
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
    /// Axis of the undeformed rope.
    pub axis: [f64; 3],
    /// Height of the table, m.
    pub table_m: Option<f64>,
}

/// Advances the particles by one step. `motions` holds the motion of each closed grip at the end of
/// the step, `stencils` is working memory, `decay` multiplies every velocity (1 outside settling).
#[inline(always)]
pub fn step<T: Real>(
    particles: &mut [Particle<T>],
    grid: &mut Grid<T>,
    stencils: &mut Vec<u32>,
    context: &StepContext<T>,
    motions: &[Option<RigidMotion<T>>],
    decay: f64,
) -> Result<(), Cause> {
    grid.clear();
    stencils.clear();
    for (index, particle) in particles.iter().enumerate() {
        let stencil = find_stencil(particle, index, grid)?;
        stencils.push(stencil as u32);
        let field = momentum_field(particle, context, grid.bounds.spacing_m, index)?;
        scatter(particle, stencil, &field, grid);
        if let Some((stiffness, velocity)) = clamp_target(particle, motions, context.dt_s) {
            scatter_clamp(particle, stencil, stiffness, velocity, grid);
        }
    }
    update_nodes(grid, context, decay);
    for (particle, &stencil) in particles.iter_mut().zip(stencils.iter()) {
        gather(particle, stencil as usize, grid, context.dt_s);
    }
    Ok(())
}

/// Momentum that a particle gives to a node at offset d: w (m v + dt f + (m C − dt V τ 4/dx²) d);
/// Hu et al. 2018, eq. 29.
struct MomentumField<T> {
    at_particle: Vec3<T>,
    slope: Mat3<T>,
}

#[inline(always)]
fn momentum_field<T: Real>(
    particle: &Particle<T>,
    context: &StepContext<T>,
    dx: f64,
    index: usize,
) -> Result<MomentumField<T>, Cause> {
    let f = &particle.deformation_gradient;
    let (mut kirchhoff, j) = kirchhoff_stress(f, &context.lame);
    if j.value() <= 0.0 {
        return Err(Cause::Inverted {
            particle: index,
            det: j.value(),
        });
    }
    for law in &context.physics.stress_laws {
        let extra = law.kirchhoff_pa(&StressPoint {
            deformation_gradient: f,
            velocity_gradient: &particle.affine,
            volume_ratio: j,
            lame: &context.lame,
        });
        for a in 0..3 {
            kirchhoff[a] = add(kirchhoff[a], extra[a]);
        }
    }
    let stress_scale = -context.dt_s * particle.volume_m3 * 4.0 / (dx * dx);
    let m = particle.mass_kg;
    let slope = std::array::from_fn(|a| add(mul(particle.affine[a], m), scaled(kirchhoff[a], stress_scale)));
    let mut at_particle = mul(particle.velocity_m_s, m);
    if !context.physics.force_laws.is_empty() {
        let axis = matvec(f, context.axis.map(T::of));
        let point = ForcePoint {
            position_m: particle.position_m,
            velocity_m_s: particle.velocity_m_s,
            tangent: mul(axis, T::one() / dot(axis, axis).sqrt()),
            length_m: particle.length_m,
            diameter_m: context.diameter_m,
            mass_kg: m,
        };
        for law in &context.physics.force_laws {
            at_particle = add(at_particle, scaled(law.force_n(&point), context.dt_s));
        }
    }
    Ok(MomentumField { at_particle, slope })
}

/// Stiffness of a gripped particle's spring as a mass, κ m, and the velocity that would bring it to
/// its place within the step.
#[inline(always)]
fn clamp_target<T: Real>(
    particle: &Particle<T>,
    motions: &[Option<RigidMotion<T>>],
    dt_s: f64,
) -> Option<(T, Vec3<T>)> {
    let (grip, offset_m) = particle.grip?;
    let motion = motions[grip].as_ref()?;
    let gap = sub(motion.place(offset_m), particle.position_m);
    Some((particle.mass_kg.scale(STIFFNESS), scaled(gap, 1.0 / dt_s)))
}

/// Where a particle lies among its nodes: coordinate from the lowest node in cells, and weights.
#[inline(always)]
fn locate<T: Real>(position_m: Vec3<T>, grid: &Grid<T>) -> ([i32; 3], [T; 3], [[T; 3]; 3]) {
    let origin = grid.bounds.origin_m;
    let inverse = 1.0 / grid.bounds.spacing_m;
    let along = |k: usize| weights((position_m[k] - T::of(origin[k])).scale(inverse));
    let (x, y, z) = (along(0), along(1), along(2));
    ([x.0, y.0, z.0], [x.1, y.1, z.1], [x.2, y.2, z.2])
}

#[inline(always)]
fn find_stencil<T: Real>(particle: &Particle<T>, index: usize, grid: &mut Grid<T>) -> Result<usize, Cause> {
    let position = value3(particle.position_m);
    if !position.iter().all(|c| c.is_finite()) {
        return Err(Cause::NonFinite { particle: index });
    }
    let (base, _, _) = locate(particle.position_m, grid);
    grid.stencil(base).ok_or(Cause::OutsideGrid {
        particle: index,
        x_m: position[0],
        y_m: position[1],
        z_m: position[2],
    })
}

#[inline(always)]
fn scatter<T: Real>(particle: &Particle<T>, stencil: usize, field: &MomentumField<T>, grid: &mut Grid<T>) {
    let dx = grid.bounds.spacing_m;
    let (_, fraction, w) = locate(particle.position_m, grid);
    let slots = &grid.stencils[stencil];
    // Offsets are counted from the stencil's first node, so that they are constants.
    let slope = &field.slope;
    let offset = [
        fraction[0].scale(dx),
        fraction[1].scale(dx),
        fraction[2].scale(dx),
    ];
    let corner = sub(field.at_particle, matvec(slope, offset));
    let column = |b: usize| {
        [
            slope[0][b].scale(dx),
            slope[1][b].scale(dx),
            slope[2][b].scale(dx),
        ]
    };
    let (along_x, along_y, along_z) = (column(0), column(1), column(2));
    let mut plane = [particle.mass_kg, corner[0], corner[1], corner[2]];
    for i in 0..3 {
        let mut line = plane;
        for j in 0..3 {
            let wxy = w[0][i] * w[1][j];
            let mut at_node = line;
            for k in 0..3 {
                let weight = wxy * w[2][k];
                let node = &mut grid.nodes[slots[9 * i + 3 * j + k] as usize];
                for lane in 0..4 {
                    node[lane] += at_node[lane] * weight;
                }
                advance(&mut at_node, &along_z);
            }
            advance(&mut line, &along_y);
        }
        advance(&mut plane, &along_x);
    }
}

/// Moves a node's would-be share (mass and momentum) on by one node.
#[inline(always)]
fn advance<T: Real>(at_node: &mut Node<T>, along: &Vec3<T>) {
    for lane in 1..4 {
        at_node[lane] += along[lane - 1];
    }
}

/// Adds a gripped particle's spring to the clamps' share of its nodes.
fn scatter_clamp<T: Real>(
    particle: &Particle<T>,
    stencil: usize,
    stiffness: T,
    velocity: Vec3<T>,
    grid: &mut Grid<T>,
) {
    let (_, _, w) = locate(particle.position_m, grid);
    for (entry, &slot) in grid.stencils[stencil].iter().enumerate() {
        let share = w[0][entry / 9] * w[1][entry / 3 % 3] * w[2][entry % 3] * stiffness;
        let node = &mut grid.clamps[slot as usize];
        node[0] += share;
        for k in 0..3 {
            node[k + 1] += velocity[k] * share;
        }
    }
}

/// Node mass below which a node is a rounding residue of the weights, kg: 10⁻¹² of any particle here.
const NEGLIGIBLE_MASS_KG: f64 = 1e-18;

/// Turns momenta into velocities: weight, settling, table, clamps.
#[inline(always)]
fn update_nodes<T: Real>(grid: &mut Grid<T>, context: &StepContext<T>, decay: f64) {
    let fall = scaled(context.physics.gravity_m_s2, context.dt_s);
    for index in 0..grid.nodes.len() {
        let on_table = context.table_m.is_some_and(|h| grid.height_m(index) <= h + 1e-9);
        let [mass, px, py, pz] = grid.nodes[index];
        if mass.value() <= NEGLIGIBLE_MASS_KG {
            grid.nodes[index] = [mass, T::zero(), T::zero(), T::zero()];
            continue;
        }
        let free = scaled(mul([px, py, pz], T::one() / mass), decay);
        let mut velocity = add(free, fall);
        if on_table {
            velocity = table_contact(velocity, context.physics.friction);
        }
        let [vx, vy, vz] = clamp_node(velocity, mass, &grid.clamps[index]);
        grid.nodes[index] = [mass, vx, vy, vz];
    }
}

/// Unilateral contact with Coulomb friction: the table takes the downward velocity, and from the
/// tangential one at most μ times as much. In stick the tangential velocity is zero, and so is its
/// derivative with respect to μ.
#[inline(always)]
fn table_contact<T: Real>(velocity: Vec3<T>, friction: T) -> Vec3<T> {
    let [vx, vy, vz] = velocity;
    if vz.value() >= 0.0 {
        return velocity;
    }
    let square = vx * vx + vy * vy;
    let stopped = [T::zero(); 3];
    if square.value() <= f64::MIN_POSITIVE {
        return stopped;
    }
    let kept = T::one() + friction * vz / square.sqrt();
    if kept.value() <= 0.0 {
        return stopped;
    }
    [vx * kept, vy * kept, T::zero()]
}

/// Implicit springs: (m v + K v_clamp) / (m + K).
#[inline(always)]
fn clamp_node<T: Real>(velocity: Vec3<T>, mass: T, clamp: &Node<T>) -> Vec3<T> {
    let [stiffness, px, py, pz] = *clamp;
    if stiffness.value() == 0.0 {
        return velocity;
    }
    mul(
        add(mul(velocity, mass), [px, py, pz]),
        T::one() / (mass + stiffness),
    )
}

#[inline(always)]
fn gather<T: Real>(particle: &mut Particle<T>, stencil: usize, grid: &Grid<T>, dt_s: f64) {
    let (_, fraction, w) = locate(particle.position_m, grid);
    let slots = &grid.stencils[stencil];
    let mut velocity = [T::zero(); 4];
    // moment[b] = Σ w v (offset along axis b), offsets counted in cells from the middle node.
    let mut moment = [[T::zero(); 4]; 3];
    for i in 0..3 {
        let mut plane = [T::zero(); 4];
        for j in 0..3 {
            let wxy = w[0][i] * w[1][j];
            let weights = [wxy * w[2][0], wxy * w[2][1], wxy * w[2][2]];
            let first = 9 * i + 3 * j;
            let nodes = [0, 1, 2].map(|k| &grid.nodes[slots[first + k] as usize]);
            for lane in T::FIRST_LANE..4 {
                let low = nodes[0][lane] * weights[0];
                let high = nodes[2][lane] * weights[2];
                let line = low + nodes[1][lane] * weights[1] + high;
                moment[2][lane] += high - low;
                match j {
                    0 => moment[1][lane] -= line,
                    2 => moment[1][lane] += line,
                    _ => {}
                }
                plane[lane] += line;
            }
        }
        for lane in T::FIRST_LANE..4 {
            match i {
                0 => moment[0][lane] -= plane[lane],
                2 => moment[0][lane] += plane[lane],
                _ => {}
            }
            velocity[lane] += plane[lane];
        }
    }
    let velocity = [velocity[1], velocity[2], velocity[3]];
    let scale = 4.0 / grid.bounds.spacing_m;
    for b in 0..3 {
        let offset = fraction[b] - T::one();
        for a in 0..3 {
            particle.affine[a][b] = (moment[b][a + 1] - velocity[a] * offset).scale(scale);
        }
    }
    let growth = matmul(&particle.affine, &particle.deformation_gradient);
    for a in 0..3 {
        let f = &mut particle.deformation_gradient[a];
        *f = add(*f, scaled(growth[a], dt_s));
    }
    particle.velocity_m_s = velocity;
    particle.position_m = add(particle.position_m, scaled(velocity, dt_s));
}
