//! A whole simulation: from a scene and a physics to the centreline at the recorded times.

use super::clamp::RigidMotion;
use super::error::{Cause, SimError};
use super::grid::{Grid, GridSpec};
#[cfg(target_arch = "x86_64")]
use super::lanes::{Avx2, Avx512};
use super::lanes::{Instructions, Laned, Portable};
use super::physics::Physics;
use super::real::Real;
use super::rope::RopeLayout;
use super::scene::Scene;
use super::step::{Particle, StepContext, grid_to_particles, particles_to_grid, update_nodes};
use super::sweep::Sweep;
use super::tensor::{Vec3, add, norm, scaled, sub, value3, zero3};
use crate::demo::RopeEnd;

/// What a simulation returns.
#[derive(Clone, Debug)]
pub struct Rollout<T> {
    /// Centreline per recorded time: one point per slice, m.
    pub frames: Vec<Vec<Vec3<T>>>,
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
    (0..layout.particles())
        .map(|index| {
            let s = layout.slice_of(index).arc_m;
            let [a, b] = layout.section_m[index % layout.section_m.len()];
            let position: [f64; 3] =
                std::array::from_fn(|k| scene.start_m[k] + s * scene.direction[k] + a * side[k] + b * up[k]);
            let grip = scene.grips.iter().position(|grip| {
                let from_end = match grip.end {
                    RopeEnd::Start => s,
                    RopeEnd::End => layout.shape.length_m - s,
                };
                from_end <= grip.length_m
            });
            Particle {
                position_m: position.map(T::of),
                velocity_m_s: zero3(),
                deformation_rate: [zero3(); 3],
                deformation_gradient: std::array::from_fn(|k| {
                    [scene.direction[k], side[k], up[k]].map(T::of)
                }),
                mass_kg: masses_kg[index],
                volume_m3: layout.particle_volume_m3(index),
                length_m: layout.particle_length_m(index),
                grip: grip.map(|g| {
                    let first = scene.grips[g].path.knots()[0].pose;
                    (g, std::array::from_fn(|k| position[k] - first[k]))
                }),
            }
        })
        .collect()
}

/// Simulates a scene, on the widest registers that this processor has.
///
/// # Errors
/// A refusal or a stop, with step, time and cause.
pub fn simulate<T: Laned>(scene: &Scene, physics: &Physics<T>) -> Result<Rollout<T>, SimError> {
    #[cfg(target_arch = "x86_64")]
    {
        if is_x86_feature_detected!("avx512f") {
            // SAFETY: the processor has the instructions that the function was compiled for.
            return unsafe { run_avx512(scene, physics) };
        }
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            // SAFETY: as above.
            return unsafe { run_avx2(scene, physics) };
        }
    }
    run_lanes::<T, Portable>(scene, physics)
}

/// The same simulation, one particle after the other: slow and easy to read. It is what tests hold
/// [`simulate`] against, and takes any number type.
///
/// # Errors
/// A refusal or a stop, with step, time and cause.
pub fn simulate_one_by_one<T: Real>(scene: &Scene, physics: &Physics<T>) -> Result<Rollout<T>, SimError> {
    run::<T, OneByOne<T>>(scene, physics)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f")]
unsafe fn run_avx512<T: Laned>(scene: &Scene, physics: &Physics<T>) -> Result<Rollout<T>, SimError> {
    run_lanes::<T, Avx512>(scene, physics)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
unsafe fn run_avx2<T: Laned>(scene: &Scene, physics: &Physics<T>) -> Result<Rollout<T>, SimError> {
    run_lanes::<T, Avx2>(scene, physics)
}

#[inline(always)]
fn run_lanes<T: Laned, I: Instructions>(scene: &Scene, physics: &Physics<T>) -> Result<Rollout<T>, SimError> {
    run::<T, Sweep<T, I>>(scene, physics)
}

/// A way to do the steps.
trait Engine<T> {
    /// A rope in the state of `particles`, which lie slice by slice.
    fn new(
        context: &StepContext<T>,
        layout: &RopeLayout,
        grid: GridSpec,
        particles: Vec<Particle<T>>,
    ) -> Self;
    /// Moves the particles with the nodes, which completes a step, and sums up the next one at the nodes.
    fn sweep(&mut self, context: &StepContext<T>, motions: &[Option<RigidMotion<T>>]) -> Result<(), Cause>;
    /// Updates the nodes.
    fn update_nodes(&mut self, context: &StepContext<T>, decay: f64);
    /// The fastest particle and its speed, m/s; NaN counts as fastest.
    fn fastest(&self) -> (usize, f64);
    /// Number of slices.
    fn slices(&self) -> usize;
    /// Middle of a slice and its velocity, m and m/s.
    fn slice_mean(&self, slice: usize) -> (Vec3<T>, Vec3<T>);
}

impl<T: Laned, I: Instructions> Engine<T> for Sweep<T, I> {
    #[inline(always)]
    fn new(
        context: &StepContext<T>,
        layout: &RopeLayout,
        grid: GridSpec,
        particles: Vec<Particle<T>>,
    ) -> Self {
        Sweep::new(context, layout, grid, &particles)
    }
    #[inline(always)]
    fn sweep(&mut self, context: &StepContext<T>, motions: &[Option<RigidMotion<T>>]) -> Result<(), Cause> {
        Sweep::sweep(self, context, motions)
    }
    #[inline(always)]
    fn update_nodes(&mut self, context: &StepContext<T>, decay: f64) {
        Sweep::update_nodes(self, context, decay);
    }
    #[inline(always)]
    fn fastest(&self) -> (usize, f64) {
        Sweep::fastest(self)
    }
    fn slices(&self) -> usize {
        Sweep::slices(self)
    }
    #[inline(always)]
    fn slice_mean(&self, slice: usize) -> (Vec3<T>, Vec3<T>) {
        Sweep::slice_mean(self, slice)
    }
}

/// One particle after the other.
struct OneByOne<T: Real> {
    particles: Vec<Particle<T>>,
    grid: Grid<T>,
    section: usize,
}

impl<T: Real> Engine<T> for OneByOne<T> {
    fn new(
        context: &StepContext<T>,
        layout: &RopeLayout,
        grid: GridSpec,
        particles: Vec<Particle<T>>,
    ) -> Self {
        let masses: Vec<T> = particles.iter().map(|p| p.mass_kg).collect();
        Self {
            grid: Grid::new(layout, grid, &masses),
            particles,
            section: context.section,
        }
    }
    fn sweep(&mut self, context: &StepContext<T>, motions: &[Option<RigidMotion<T>>]) -> Result<(), Cause> {
        grid_to_particles(&mut self.particles, &self.grid, context.dt_s);
        particles_to_grid(&self.particles, &mut self.grid, context, motions)
    }
    fn update_nodes(&mut self, context: &StepContext<T>, decay: f64) {
        update_nodes(&mut self.grid, context, decay);
    }
    fn fastest(&self) -> (usize, f64) {
        let mut fastest = (0, 0.0);
        for (index, p) in self.particles.iter().enumerate() {
            let speed = norm(value3(p.velocity_m_s));
            if speed > fastest.1 || speed.is_nan() {
                fastest = (index, speed);
            }
        }
        fastest
    }
    fn slices(&self) -> usize {
        self.particles.len() / self.section
    }
    fn slice_mean(&self, slice: usize) -> (Vec3<T>, Vec3<T>) {
        let members = &self.particles[slice * self.section..(slice + 1) * self.section];
        let (mut place, mut velocity) = (zero3(), zero3());
        for p in members {
            place = add(place, p.position_m);
            velocity = add(velocity, p.velocity_m_s);
        }
        let share = 1.0 / members.len() as f64;
        (scaled(place, share), scaled(velocity, share))
    }
}

#[inline(always)]
fn run<T: Real, E: Engine<T>>(scene: &Scene, physics: &Physics<T>) -> Result<Rollout<T>, SimError> {
    check_parameters(physics)?;
    let layout = scene.layout();
    let density = scene.rope.density_kg_m3();
    let mut masses: Vec<T> = (0..layout.particles())
        .map(|p| T::of(density * layout.particle_volume_m3(p)))
        .collect();
    for law in &physics.mass_laws {
        law.change_masses_kg(&layout, &mut masses);
    }
    let lame = physics.lame();
    let viscosity = physics
        .stress_laws
        .iter()
        .map(|law| law.viscosity_pa_s(&lame))
        .fold(0.0, f64::max);
    let dt_s = scene.chosen_step_s(lame.p_wave_modulus().value(), viscosity)?;
    let context = StepContext {
        physics,
        lame,
        dt_s,
        diameter_m: scene.rope.diameter_m,
        table_m: scene.table.map(|t| t.height_m),
        section: layout.section_m.len(),
    };
    let particles = initial_particles(scene, &layout, &masses);
    let mut engine = E::new(&context, &layout, scene.grid, particles);
    let mut recorder = Recorder::new(scene);
    let steps = (scene.duration_s / dt_s).ceil() as usize;
    for number in 0..=steps {
        let t_s = number as f64 * dt_s;
        let stop = |step: usize, cause| SimError {
            step,
            t_s: step as f64 * dt_s,
            cause,
        };
        let motions = grip_motions(scene, physics, t_s, dt_s);
        engine
            .sweep(&context, &motions)
            .map_err(|cause| stop(number, cause))?;
        if number % CHECK_EVERY == 1 {
            check_speed(engine.fastest(), scene.grid.spacing_m / dt_s)
                .map_err(|cause| stop(number - 1, cause))?;
        }
        recorder.record(&engine, t_s);
        if number == steps {
            break;
        }
        let decay = match scene.settling {
            Some(settling) if t_s < settling.until_s => (-settling.rate_per_s * dt_s).exp(),
            _ => 1.0,
        };
        engine.update_nodes(&context, decay);
    }
    Ok(Rollout {
        frames: recorder.frames,
        arc_m: layout.slices.iter().map(|s| s.arc_m).collect(),
        reach_m: recorder.reach_m,
        steps,
        dt_s,
    })
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
    Ok(())
}

/// Steps between two looks for runaway particles: an instability takes many steps to grow.
const CHECK_EVERY: usize = 16;

fn check_speed((particle, speed_m_s): (usize, f64), cell_per_step: f64) -> Result<(), Cause> {
    if speed_m_s.is_nan() {
        return Err(Cause::NonFinite { particle });
    }
    if speed_m_s > 0.5 * cell_per_step {
        return Err(Cause::TooFast { particle, speed_m_s });
    }
    Ok(())
}

fn grip_motions<T: Real>(
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
    frames: Vec<Vec<Vec3<T>>>,
    reach_m: Option<T>,
}

impl<'a, T: Real> Recorder<'a, T> {
    fn new(scene: &'a Scene) -> Self {
        Self {
            scene,
            frames: Vec::with_capacity(scene.frame_times_s.len()),
            reach_m: None,
        }
    }

    #[inline(always)]
    fn record(&mut self, engine: &impl Engine<T>, now_s: f64) {
        while let Some(&due) = self.scene.frame_times_s.get(self.frames.len()) {
            if due > now_s + 1e-12 {
                break;
            }
            // Frames fall between steps: go back along the velocity, less than one step.
            let point = |slice| {
                let (place, velocity) = engine.slice_mean(slice);
                add(place, scaled(velocity, due - now_s))
            };
            self.frames.push((0..engine.slices()).map(point).collect());
        }
        if now_s >= self.scene.score_from_s {
            let tip = tip_x(engine);
            if self.reach_m.is_none_or(|best| tip.value() > best.value()) {
                self.reach_m = Some(tip);
            }
        }
    }
}

/// x of the end point of the axis, half a slice beyond the last slice.
#[inline(always)]
fn tip_x<T: Real>(engine: &impl Engine<T>) -> T {
    let n = engine.slices();
    let x = |slice| engine.slice_mean(slice).0[0];
    let (last, before) = (x(n - 1), x(n - 2));
    last + (last - before).scale(0.5)
}

/// Two unit vectors that complete `axis` to a right-handed frame.
fn perpendicular(axis: [f64; 3]) -> ([f64; 3], [f64; 3]) {
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
