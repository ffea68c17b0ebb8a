//! A whole simulation: from a scene and a physics to the centreline at the recorded times.

use super::clamp::{RigidMotion, grip_forces_n};
use super::error::{Cause, SimError};
use super::grid::Grid;
use super::physics::Physics;
use super::real::Real;
use super::rope::RopeLayout;
use super::scene::Scene;
use super::start::{Hang, Start};
use super::statics::{Pose, Statics};
use super::step::{Particle, StepContext, step};
use super::tensor::{Vec3, add, scaled, sub, zero3};
use rayon::prelude::*;

/// What a simulation returns.
#[derive(Clone, Debug)]
pub struct Rollout<T> {
    /// Centreline per recorded time: one point per slice, m.
    pub frames: Vec<Vec<Vec3<T>>>,
    /// Force of each grip on the rope per recorded time, N, at the end of the step that holds the time;
    /// zero at the start and where a grip is open.
    pub grip_forces_n: Vec<Vec<Vec3<T>>>,
    /// Arc length of each slice, m.
    pub arc_m: Vec<f64>,
    /// Largest x of the free tip since [`Scene::score_from_s`], m.
    pub reach_m: Option<T>,
    /// Number of steps.
    pub steps: usize,
    /// Time step, s.
    pub dt_s: f64,
}

/// Particles of the undeformed rope at rest.
pub fn initial_particles<T: Real>(scene: &Scene, layout: &RopeLayout, masses_kg: &[T]) -> Vec<Particle<T>> {
    let (side, up) = perpendicular(scene.direction);
    let straight = std::array::from_fn(|k| [scene.direction[k], side[k], up[k]].map(T::of));
    (0..layout.particles())
        .map(|index| {
            let material_m = layout.material_m(index);
            Particle {
                position_m: scene.straight_m(material_m).map(T::of),
                velocity_m_s: zero3(),
                deformation_rate: [zero3(); 3],
                deformation_gradient: straight,
                mass_kg: masses_kg[index],
                volume_m3: layout.particle_volume_m3(index),
                length_m: layout.particle_length_m(index),
                grip: scene.grip_offset(material_m),
            }
        })
        .collect()
}

/// Brings the particles to where the scene starts, if the rope hangs there.
fn hang<T: Real>(scene: &Scene, physics: &Physics<T>, particles: &mut [Particle<T>]) -> Result<(), Cause> {
    let Some(hang) = scene.start.hang() else {
        return Ok(());
    };
    let statics = Statics::new(scene, physics);
    let first = statics.solve(&hang.poses[0])?;
    let later = match (&scene.start, hang.poses.get(1)) {
        (Start::Moving(_), Some(pose)) => Some((pose.t_s - hang.poses[0].t_s, statics.solve(pose)?)),
        _ => None,
    };
    for (index, particle) in particles.iter_mut().enumerate() {
        let (x, f) = statics.particle(&first, index);
        (particle.position_m, particle.deformation_gradient) = (x, f);
        if let Some((after_s, nodes)) = &later {
            let (x1, f1) = statics.particle(nodes, index);
            particle.velocity_m_s = scaled(sub(x1, x), 1.0 / after_s);
            particle.deformation_rate = std::array::from_fn(|k| scaled(sub(f1[k], f[k]), 1.0 / after_s));
        }
    }
    Ok(())
}

/// Mass of every particle, kg: the rope's, the declared mass at its end, and what the laws change.
pub(super) fn particle_masses<T: Real>(scene: &Scene, layout: &RopeLayout, physics: &Physics<T>) -> Vec<T> {
    let density = scene.rope.density_kg_m3();
    let members = layout.section_m.len();
    let first_of_end = layout.particles() - members;
    let mut masses: Vec<T> = (0..layout.particles())
        .map(|p| {
            let end = if p >= first_of_end {
                scene.end_mass_kg / members as f64
            } else {
                0.0
            };
            T::of(density * layout.particle_volume_m3(p) + end)
        })
        .collect();
    for law in &physics.mass_laws {
        law.change_masses_kg(layout, &mut masses);
    }
    masses
}

/// The poses of a scene without time.
fn hang_still<T: Real>(scene: &Scene, physics: &Physics<T>, hang: &Hang) -> Result<Rollout<T>, SimError> {
    let statics = Statics::new(scene, physics);
    let layout = scene.layout();
    let members = layout.section_m.len();
    let frame = |pose: &Pose| {
        let nodes = statics.solve(pose).map_err(|cause| SimError {
            step: 0,
            t_s: pose.t_s,
            cause,
        })?;
        let middle = |slice: usize| {
            let of_slice = slice * members..(slice + 1) * members;
            let sum = of_slice.fold(zero3(), |sum, p| add(sum, statics.particle(&nodes, p).0));
            scaled(sum, 1.0 / members as f64)
        };
        let line: Vec<Vec3<T>> = (0..layout.slices.len()).map(middle).collect();
        Ok((line, statics.grip_forces_n(&nodes, pose)))
    };
    let found: Vec<_> = hang
        .poses
        .par_iter()
        .map(frame)
        .collect::<Result<_, SimError>>()?;
    let (frames, grip_forces_n) = found.into_iter().unzip();
    Ok(Rollout {
        frames,
        grip_forces_n,
        arc_m: layout.slices.iter().map(|s| s.arc_m).collect(),
        reach_m: None,
        steps: 0,
        dt_s: 0.0,
    })
}

/// Simulates a scene.
///
/// # Errors
/// A refusal or a stop, with step, time and cause.
pub fn simulate<T: Real>(scene: &Scene, physics: &Physics<T>) -> Result<Rollout<T>, SimError> {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") {
        // SAFETY: the processor has the instructions that the function was compiled for.
        return unsafe { run_avx2(scene, physics) };
    }
    run(scene, physics)
}

/// The same code compiled for wider registers. Fused multiply-add stays off, so the bits are the
/// same as those of the portable version.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
unsafe fn run_avx2<T: Real>(scene: &Scene, physics: &Physics<T>) -> Result<Rollout<T>, SimError> {
    run(scene, physics)
}

#[inline(always)]
fn run<T: Real>(scene: &Scene, physics: &Physics<T>) -> Result<Rollout<T>, SimError> {
    check_parameters(physics)?;
    scene.check()?;
    if let Start::Poses(hang) = &scene.start {
        return hang_still(scene, physics, hang);
    }
    let layout = scene.layout();
    let dt_s = time_step_s(scene, physics);
    // Before anything of the size of the rope is built.
    let steps = scene.steps(dt_s, layout.particles())?;
    let masses = particle_masses(scene, &layout, physics);
    let mut particles = initial_particles(scene, &layout, &masses);
    hang(scene, physics, &mut particles).map_err(SimError::at_start)?;
    let context = StepContext {
        physics,
        lame: physics.lame(),
        dt_s,
        diameter_m: scene.rope.diameter_m,
        table_m: scene.table.map(|t| t.height_m),
        section: layout.section_m.len(),
    };
    let mut grid = Grid::new(&layout, scene.grid, &masses);
    let mut recorder = Recorder::new(scene, &layout);
    recorder.record(&particles, &vec![None; scene.grips.len()], 0.0, dt_s);
    for number in 0..steps {
        let t_s = number as f64 * dt_s;
        let motions = grip_motions(scene, physics, t_s, dt_s);
        let decay = match scene.settling {
            Some(settling) if t_s < settling.until_s => libm::exp(-settling.rate_per_s * dt_s),
            _ => 1.0,
        };
        // An instability takes many steps to grow; the last state is always looked at.
        let look = number % CHECK_EVERY == 0 || number + 1 == steps;
        step(&mut particles, &mut grid, &context, &motions, decay)
            .and_then(|()| {
                if look {
                    check_state(&particles, &context, scene)
                } else {
                    Ok(())
                }
            })
            .map_err(|cause| SimError {
                step: number,
                t_s,
                cause,
            })?;
        recorder.record(&particles, &motions, t_s + dt_s, dt_s);
    }
    Ok(Rollout {
        frames: recorder.frames,
        grip_forces_n: recorder.grip_forces_n,
        arc_m: layout.slices.iter().map(|s| s.arc_m).collect(),
        reach_m: recorder.reach_m,
        steps,
        dt_s,
    })
}

/// The time step of a scene with a physics, s.
pub fn time_step_s<T: Real>(scene: &Scene, physics: &Physics<T>) -> f64 {
    let lame = physics.lame();
    let viscosities = physics.stress_laws.iter().map(|law| law.viscosity_pa_s(&lame));
    scene.time_step_s(lame.p_wave_modulus().value(), viscosities.fold(0.0, f64::max))
}

fn check_parameters<T: Real>(physics: &Physics<T>) -> Result<(), SimError> {
    let bad = |name, value| Err(SimError::at_start(Cause::BadParameter { name, value }));
    let (young, poisson) = (physics.young_pa.value(), physics.poisson.value());
    if !(young.is_finite() && young > 0.0) {
        return bad("young_pa", young);
    }
    if !(poisson > -0.99 && poisson < 0.499) {
        return bad("poisson", poisson);
    }
    let friction = physics.friction.value();
    if !(friction.is_finite() && friction >= 0.0) {
        return bad("friction", friction);
    }
    for component in physics.gravity_m_s2 {
        if !component.value().is_finite() {
            return bad("gravity_m_s2", component.value());
        }
    }
    Ok(())
}

/// Steps between two looks for runaway particles.
const CHECK_EVERY: usize = 16;

/// Looks for particles that are not finite or move too far per step.
fn check_state<T: Real>(
    particles: &[Particle<T>],
    context: &StepContext<T>,
    scene: &Scene,
) -> Result<(), Cause> {
    let fastest_m_s = 0.5 * scene.grid.spacing_m / context.dt_s;
    for (particle, p) in particles.iter().enumerate() {
        let speed_m_s = p
            .velocity_m_s
            .iter()
            .map(|c| c.value().powi(2))
            .sum::<f64>()
            .sqrt();
        if !speed_m_s.is_finite() || p.position_m.iter().any(|c| !c.value().is_finite()) {
            return Err(Cause::NonFinite { particle });
        }
        if speed_m_s > fastest_m_s {
            return Err(Cause::TooFast { particle, speed_m_s });
        }
    }
    Ok(())
}

/// Where each closed grip stands at the end of the step that begins at `t_s`.
pub fn grip_motions<T: Real>(
    scene: &Scene,
    physics: &Physics<T>,
    t_s: f64,
    dt_s: f64,
) -> Vec<Option<RigidMotion<T>>> {
    scene
        .grips
        .iter()
        .map(|grip| {
            grip.path.closed(t_s).then(|| {
                let pose = grip.path.real_pose(&physics.path_laws, t_s + dt_s);
                RigidMotion::between(&grip.path.knots()[0].pose, &pose)
            })
        })
        .collect()
}

/// Takes down the centreline at the scene's frame times and the tip's reach.
struct Recorder<'a, T> {
    scene: &'a Scene,
    section: usize,
    frames: Vec<Vec<Vec3<T>>>,
    grip_forces_n: Vec<Vec<Vec3<T>>>,
    reach_m: Option<T>,
}

impl<'a, T: Real> Recorder<'a, T> {
    fn new(scene: &'a Scene, layout: &RopeLayout) -> Self {
        Self {
            scene,
            section: layout.section_m.len(),
            frames: Vec::with_capacity(scene.frame_times_s.len()),
            grip_forces_n: Vec::with_capacity(scene.frame_times_s.len()),
            reach_m: None,
        }
    }

    fn record(
        &mut self,
        particles: &[Particle<T>],
        motions: &[Option<RigidMotion<T>>],
        now_s: f64,
        dt_s: f64,
    ) {
        while let Some(&due) = self.scene.frame_times_s.get(self.frames.len()) {
            if due > now_s + 1e-12 {
                break;
            }
            // Frames fall between steps: go back along the velocity, less than one step.
            self.frames.push(centreline(particles, self.section, due - now_s));
            self.grip_forces_n.push(grip_forces_n(particles, motions, dt_s));
        }
        if now_s >= self.scene.score_from_s {
            let tip = self.tip_x(particles);
            if self.reach_m.is_none_or(|best| tip.value() > best.value()) {
                self.reach_m = Some(tip);
            }
        }
    }

    /// x of the end point of the axis, half a slice beyond the last slice.
    fn tip_x(&self, particles: &[Particle<T>]) -> T {
        let n = particles.len();
        let mean = |range: std::ops::Range<usize>| {
            let mut sum = T::zero();
            for p in &particles[range] {
                sum += p.position_m[0];
            }
            sum.scale(1.0 / self.section as f64)
        };
        let (last, before) = (
            mean(n - self.section..n),
            mean(n - 2 * self.section..n - self.section),
        );
        last + (last - before).scale(0.5)
    }
}

fn centreline<T: Real>(particles: &[Particle<T>], section: usize, ahead_s: f64) -> Vec<Vec3<T>> {
    particles
        .chunks(section)
        .map(|slice| {
            let mut sum = zero3();
            for p in slice {
                sum = add(sum, add(p.position_m, scaled(p.velocity_m_s, ahead_s)));
            }
            scaled(sum, 1.0 / section as f64)
        })
        .collect()
}

/// Two unit vectors that complete `axis` to a right-handed frame.
pub(super) fn perpendicular(axis: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    let helper = if axis[2].abs() < 0.9 {
        [0.0, 0.0, 1.0]
    } else {
        [0.0, 1.0, 0.0]
    };
    let along = axis.iter().zip(&helper).map(|(a, h)| a * h).sum::<f64>();
    let up = sub(helper, axis.map(|a| a * along));
    let length = up.iter().map(|c| c * c).sum::<f64>().sqrt();
    let up = up.map(|c| c / length);
    (super::tensor::cross(up, axis), up)
}
