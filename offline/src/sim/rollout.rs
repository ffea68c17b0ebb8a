//! A whole simulation: from a scene and a physics to the centreline at the recorded times.

use super::clamp::{Grasp, RigidMotion};
use super::engine::{Engine, OneByOne};
use super::error::{Cause, SimError};
use super::hanging::{Hung, hang_still, initial_particles};
#[cfg(target_arch = "x86_64")]
use super::lanes::{Avx2, Avx512};
use super::lanes::{Laned, Portable};
use super::legs::{Placed, placed};
use super::material::Material;
use super::physics::Physics;
use super::real::Real;
use super::recorded::Recorded;
use super::rope::RopeLayout;
use super::scene::{Grip, Scene, require};
use super::start::Start;
use super::step::{Particle, StepContext};
use super::sweep::Sweep;
use super::tensor::{Mat3, Vec3, add, rotation_of_rodrigues, scaled, sub};
use super::time_step::time_step_s;
use super::track::Track;

/// What a simulation returns.
#[derive(Clone, Debug)]
pub struct Rollout<T> {
    /// Centreline per recorded time as the cameras report it: one point per slice, m.
    pub frames: Vec<Vec<Vec3<T>>>,
    /// The same as it was, at the time when the frame was taken.
    pub tracks: Vec<Track<T>>,
    /// Force of each grip on the rope per recorded time, N, at the end of the step that holds the time;
    /// zero at the start and where a grip is open.
    pub grip_forces_n: Vec<Vec<Vec3<T>>>,
    /// Every particle per recorded time, slice by slice, m; empty unless [`Scene::keep_particles`].
    pub particles: Vec<Vec<Vec3<T>>>,
    /// Arc length of each slice, m.
    pub arc_m: Vec<f64>,
    /// Largest x of the free tip since [`Scene::score_from_s`], m.
    pub reach_m: Option<T>,
    /// Every particle at the end, slice by slice.
    pub end: Vec<Placed>,
    /// Number of steps.
    pub steps: usize,
    /// Time step, s.
    pub dt_s: f64,
}

impl Rollout<f64> {
    /// The same rollout in single precision.
    pub fn rounded(self) -> Rollout<f32> {
        let points = |list: Vec<[f64; 3]>| -> Vec<[f32; 3]> {
            list.into_iter().map(|v| v.map(|c| c as f32)).collect()
        };
        let vectors = |list: Vec<Vec<[f64; 3]>>| list.into_iter().map(points).collect();
        let track = |track: Track<f64>| Track {
            points_m: points(track.points_m),
            velocities_m_s: points(track.velocities_m_s),
        };
        Rollout {
            frames: vectors(self.frames),
            tracks: self.tracks.into_iter().map(track).collect(),
            particles: vectors(self.particles),
            grip_forces_n: vectors(self.grip_forces_n),
            arc_m: self.arc_m,
            reach_m: self.reach_m.map(|reach| reach as f32),
            end: self.end,
            steps: self.steps,
            dt_s: self.dt_s,
        }
    }
}

/// Simulates a scene, on the widest registers that this processor has.
///
/// # Errors
/// A refusal or a stop, with step, time and cause.
pub fn simulate<T: Laned>(scene: &Scene, physics: &Physics<T>) -> Result<Rollout<T>, SimError> {
    match scene.start {
        Start::Poses(_) => poses(scene, physics),
        _ => simulate_hung(scene, physics, &|| Hung::of(scene, physics)),
    }
}

/// The poses of a scene without time, for which nothing is stepped.
///
/// # Errors
/// A refusal, or no rest state was found.
///
/// # Panics
/// The scene has time.
pub fn poses<T: Real>(scene: &Scene, physics: &Physics<T>) -> Result<Rollout<T>, SimError> {
    let Start::Poses(poses) = &scene.start else {
        panic!("the scene has time");
    };
    check_parameters(physics)?;
    scene.check()?;
    hang_still(scene, physics, poses)
}

/// Simulates a scene with time where `hung` knows how the rope hangs at the start, if it does; asked once what can be
/// simulated at all is checked. Where it hangs takes double precision to find ([`Laned::Double`]), its motion from there
/// does not.
///
/// # Errors
/// A refusal or a stop, with step, time and cause.
///
/// # Panics
/// The scene has no time.
pub fn simulate_hung<T: Laned>(
    scene: &Scene,
    physics: &Physics<T>,
    hung: &dyn Fn() -> Result<Option<Hung<T>>, SimError>,
) -> Result<Rollout<T>, SimError> {
    #[cfg(target_arch = "x86_64")]
    {
        if is_x86_feature_detected!("avx512f") {
            // SAFETY: the processor has the instructions that the function was compiled for.
            return unsafe { run_avx512(scene, physics, hung) };
        }
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            // SAFETY: as above.
            return unsafe { run_avx2(scene, physics, hung) };
        }
    }
    run::<T, Sweep<T, Portable>>(scene, physics, hung)
}

/// The same simulation, one particle after the other: slow and easy to read. It is what tests hold
/// [`simulate`] against, and takes any number type.
///
/// # Errors
/// A refusal or a stop, with step, time and cause.
pub fn simulate_one_by_one<T: Real>(scene: &Scene, physics: &Physics<T>) -> Result<Rollout<T>, SimError> {
    match scene.start {
        Start::Poses(_) => poses(scene, physics),
        _ => run::<T, OneByOne<T>>(scene, physics, &|| Hung::of(scene, physics)),
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f")]
unsafe fn run_avx512<T: Laned>(
    scene: &Scene,
    physics: &Physics<T>,
    hung: &dyn Fn() -> Result<Option<Hung<T>>, SimError>,
) -> Result<Rollout<T>, SimError> {
    run::<T, Sweep<T, Avx512>>(scene, physics, hung)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
unsafe fn run_avx2<T: Laned>(
    scene: &Scene,
    physics: &Physics<T>,
    hung: &dyn Fn() -> Result<Option<Hung<T>>, SimError>,
) -> Result<Rollout<T>, SimError> {
    run::<T, Sweep<T, Avx2>>(scene, physics, hung)
}

#[inline(always)]
fn run<T: Real, E: Engine<T>>(
    scene: &Scene,
    physics: &Physics<T>,
    hung: &dyn Fn() -> Result<Option<Hung<T>>, SimError>,
) -> Result<Rollout<T>, SimError> {
    assert!(!matches!(scene.start, Start::Poses(_)), "the scene has no time");
    let setup = Setup::new(scene, physics)?;
    let mut engine: E = setup.hanging_engine(hung()?);
    let mut recorder = Recorder::new(scene);
    let mut state = 0;
    while state <= setup.steps {
        let mut motions = setup.motions(state);
        setup.sweep(&mut engine, state, &mut motions)?;
        recorder.record(&engine, state, &setup);
        if state < setup.steps {
            setup.update_nodes(&mut engine, state);
        }
        recorder.motions = motions;
        state = setup.after(state, &engine);
    }
    Ok(Rollout {
        end: placed(&engine, setup.context.section),
        ..recorder.finish(&setup)
    })
}

/// What a rollout fixes before its first step.
pub(super) struct Setup<'a, T> {
    pub(super) scene: &'a Scene,
    pub(super) layout: RopeLayout,
    pub(super) masses_kg: Vec<T>,
    /// The material before the first step.
    material: Material<T>,
    /// Length of rope of a particle of each slice, m.
    lengths_m: Vec<f64>,
    pub(super) context: StepContext<'a, T>,
    pub(super) steps: usize,
}

impl<'a, T: Real> Setup<'a, T> {
    pub(super) fn new(scene: &'a Scene, physics: &'a Physics<T>) -> Result<Self, SimError> {
        check_parameters(physics)?;
        scene.check()?;
        refuse_collapse(scene, physics)?;
        let layout = scene.layout();
        let dt_s = scene.chosen_step_s(time_step_s(scene, physics))?;
        // A camera's clock that is behind sees the rope later than it says.
        let late_s = (-scene.clock_offset_s(physics).value()).max(0.0);
        // Refuses before what every rollout needs of the size of the rope is built.
        let steps = scene.steps(dt_s, late_s, layout.particles())?;
        let material = Material::new(physics, &layout);
        let rest = material.least_rest_volume();
        if rest.is_nan() || rest <= LEAST_REST_VOLUME {
            return Err(SimError::at_start(Cause::BentAtRest { volume: rest }));
        }
        let masses_kg = masses_kg(scene, physics, &layout);
        let context = StepContext::new(scene, physics, dt_s, layout.section_m.len());
        let context = context.with_pads(scene, &layout, &masses_kg);
        let share = 1.0 / context.section as f64;
        Ok(Self {
            scene,
            masses_kg,
            material,
            lengths_m: layout.slices.iter().map(|s| s.length_m * share).collect(),
            steps,
            layout,
            context,
        })
    }

    /// Time at the start of a step, s.
    pub(super) fn time_s(&self, step: usize) -> f64 {
        step as f64 * self.context.dt_s
    }

    /// Factor on every velocity in a step.
    pub(super) fn decay(&self, step: usize) -> f64 {
        match self.scene.settling {
            Some(settling) if self.time_s(step) < settling.until_s => {
                libm::exp(-settling.rate_per_s * self.context.dt_s)
            }
            _ => 1.0,
        }
    }

    /// The step after one: the next, or where the rope has come to rest the last one of the settling.
    fn after(&self, step: usize, engine: &impl Engine<T>) -> usize {
        let next = step + 1;
        let Some(settling) = self.scene.settling else {
            return next;
        };
        if settling.still_m_s == 0.0 || step % CHECK_EVERY != 1 || self.context.physics.remembers() {
            return next;
        }
        let arrived = |grip: &Grip| grip.path.pose(self.time_s(step)) == grip.path.pose(settling.until_s);
        if self.scene.grips.iter().all(arrived) && engine.fastest().1 < settling.still_m_s {
            let last = (settling.until_s / self.context.dt_s) as usize;
            return next.max(last.min(self.steps));
        }
        next
    }

    /// Forces per length of the slices during a step.
    pub(super) fn forces(&self, step: usize) -> Option<&[Vec3<T>]> {
        let field = self.context.physics.force_field.as_ref()?;
        Some(&field.force_n_m[field.block(self.time_s(step))?])
    }

    /// Motion of each closed grip at the end of a step.
    pub(super) fn motions(&self, step: usize) -> Vec<Option<RigidMotion<T>>> {
        let dt_s = self.context.dt_s;
        grip_motions(self.scene, self.context.physics, self.time_s(step), dt_s)
    }

    /// A stop in a step.
    pub(super) fn stop(&self, step: usize, cause: Cause) -> SimError {
        SimError {
            step,
            t_s: self.time_s(step),
            cause,
        }
    }

    /// An engine with the rope as it lies at the start.
    #[inline(always)]
    pub(super) fn engine<E: Engine<T>>(&self) -> E {
        self.engine_of(initial_particles(self.scene, &self.layout, &self.masses_kg))
    }

    #[inline(always)]
    fn engine_of<E: Engine<T>>(&self, particles: Vec<Particle<T>>) -> E {
        let (layout, material) = (&self.layout, self.material.clone());
        E::new(&self.context, layout, self.scene.grid, particles, material)
    }

    /// The same where the rope may hang at the start, as `hung` says.
    fn hanging_engine<E: Engine<T>>(&self, hung: Option<Hung<T>>) -> E {
        let mut particles = initial_particles(self.scene, &self.layout, &self.masses_kg);
        if let Start::Placed(placed) = &self.scene.start {
            for (particle, at) in particles.iter_mut().zip(placed) {
                particle.position_m = at.position_m.map(T::of);
                particle.deformation_gradient = at.deformation_gradient.map(|row| row.map(T::of));
            }
        }
        if let Some(hung) = &hung {
            hung.place(&mut particles);
        }
        let mut engine: E = self.engine_of(particles);
        if let Some(velocities_m_s) = hung.and_then(|hung| hung.velocities_m_s) {
            engine.set_node_velocities(&velocities_m_s);
        }
        engine
    }

    /// Ends step `state` − 1 and begins step `state`, up to the update of the nodes; looks now and then
    /// for runaway particles, because an instability takes many steps to grow, and at the last state. Pads turn the motions.
    #[inline(always)]
    pub(super) fn sweep<E: Engine<T>>(
        &self,
        engine: &mut E,
        state: usize,
        motions: &mut [Option<RigidMotion<T>>],
    ) -> Result<(), SimError> {
        engine
            .sweep(&self.context, motions, self.decay(state))
            .map_err(|cause| self.stop(state, cause))?;
        if state % CHECK_EVERY == 1 || state == self.steps {
            let cell_per_step = self.scene.grid.spacing_m / self.context.dt_s;
            check_speed(engine.fastest(), cell_per_step)
                .map_err(|cause| self.stop(state.saturating_sub(1), cause))?;
        }
        Ok(())
    }

    /// The rest of a step.
    #[inline(always)]
    pub(super) fn update_nodes<E: Engine<T>>(&self, engine: &mut E, step: usize) {
        if let Some(force_n_m) = self.forces(step) {
            engine.push(&self.context, force_n_m, &self.lengths_m);
        }
        engine.update_nodes(&self.context, self.decay(step));
    }
}

/// Where each closed grip stands at the end of the step that begins at `t_s`.
pub fn grip_motions<T: Real>(
    scene: &Scene,
    physics: &Physics<T>,
    t_s: f64,
    dt_s: f64,
) -> Vec<Option<RigidMotion<T>>> {
    let motion = |(index, grip): (usize, &Grip)| {
        let path = &grip.path;
        let opens_late = path.closed(t_s - physics.release_delay_s.value());
        if !(path.closed(t_s) || opens_late) {
            return None;
        }
        let grasp = grasp(scene, physics, index);
        let of = |recorded: Recorded<T>| Some(RigidMotion::at(&recorded, &grasp, t_s + dt_s));
        match physics.path_shifts.iter().find(|shift| shift.grip == index) {
            Some(shift) => of(Recorded::new(path, Some(&|knot| shift.knots[knot]))),
            None => of(Recorded::new(path, None)),
        }
    };
    scene.grips.iter().enumerate().map(motion).collect()
}

/// What grip `index` does besides following its recorded path.
pub fn grasp<'a, T: Real>(scene: &Scene, physics: &'a Physics<T>, index: usize) -> Grasp<'a, T> {
    // Of poses at rest each is there long before it is seen: what comes late has arrived.
    let arrived = matches!(scene.start, Start::Poses(_));
    let first_hanging = scene.start.hang().filter(|_| index == 0);
    let tilted = first_hanging.zip(physics.grip_tilt);
    Grasp {
        laws: if arrived { &[] } else { &physics.path_laws },
        turn: tilted.map(|(hang, tilt)| tilting(&hang.frames[index], tilt)),
    }
}

/// The turn that tilts the tangent of a frame (tangent, side, up) toward side and up, by the tangents of half the angles.
fn tilting<T: Real>([_, side, up]: &Mat3<f64>, [toward_side, toward_up]: [T; 2]) -> Mat3<T> {
    rotation_of_rodrigues(std::array::from_fn(|k| {
        toward_side.scale(up[k]) - toward_up.scale(side[k])
    }))
}

/// Masses of the particles, kg: the rope's, the declared mass at its end, and what the laws change.
pub fn masses_kg<T: Real>(scene: &Scene, physics: &Physics<T>, layout: &RopeLayout) -> Vec<T> {
    let density = scene.rope.density_kg_m3();
    let members = layout.section_m.len();
    let first_of_end = layout.particles() - members;
    let end_kg = |p: usize| {
        if p < first_of_end {
            0.0
        } else {
            scene.rope.end_mass_kg / members as f64
        }
    };
    let mut masses: Vec<T> = (0..layout.particles())
        .map(|p| T::of(density * layout.particle_volume_m3(p) + end_kg(p)))
        .collect();
    for law in &physics.mass_laws {
        law.change_masses_kg(layout, &mut masses);
    }
    masses
}

fn check_parameters<T: Real>(physics: &Physics<T>) -> Result<(), SimError> {
    let (young, poisson) = (physics.young_pa.value(), physics.poisson.value());
    require("young_pa", young, young.is_finite() && young > 0.0)?;
    require("poisson", poisson, poisson > -0.99 && poisson < 0.499)?;
    let friction = physics.friction.value();
    require("friction", friction, friction.is_finite() && friction >= 0.0)?;
    for component in physics.gravity_m_s2.map(T::value) {
        require("gravity_m_s2", component, component.is_finite())?;
    }
    let times = [
        ("release_delay_s", physics.release_delay_s.value()),
        ("clock_offset_s", physics.clock_offset_s().value()),
    ];
    for (name, value) in times {
        require(name, value, value.is_finite())?;
    }
    Ok(())
}

/// Least volume of a shape at rest over the undeformed one. A rope that is bent further at rest and starts
/// straight is stretched by two thirds on its inner side: what it springs back with turned a third of such
/// ropes inside out (41 of 98 random scenes, 7 of 922 of those bent less), whatever the step.
const LEAST_REST_VOLUME: f64 = 0.6;

/// Refuses a straight rope between two grips that its own weight would compress to nothing.
fn refuse_collapse<T: Real>(scene: &Scene, physics: &Physics<T>) -> Result<(), SimError> {
    let [a, b] = &scene.grips[..] else { return Ok(()) };
    if scene.start.hang().is_some() || !(a.path.closed(0.0) && b.path.closed(0.0)) {
        return Ok(());
    }
    let gravity = physics.gravity_m_s2.map(T::value);
    let along = (0..3).map(|k| gravity[k] * scene.direction[k]).sum::<f64>().abs();
    let free_m = scene.rope.length_m - a.length_m - b.length_m;
    let strain = 0.5 * scene.rope.density_kg_m3() * along * free_m / physics.young_pa.value();
    if strain >= 1.0 {
        return Err(SimError::at_start(Cause::Collapses { strain }));
    }
    Ok(())
}

/// Steps between two looks for runaway particles.
const CHECK_EVERY: usize = 16;

fn check_speed((particle, speed_m_s): (usize, f64), cell_per_step: f64) -> Result<(), Cause> {
    if !speed_m_s.is_finite() {
        return Err(Cause::NonFinite { particle });
    }
    if speed_m_s > 0.5 * cell_per_step {
        return Err(Cause::TooFast { particle, speed_m_s });
    }
    Ok(())
}

/// Where a frame lies: after which step, and how far from its end (within the last step, so negative).
#[derive(Clone, Copy)]
pub(super) struct FrameMark {
    pub(super) state: usize,
    pub(super) ahead_s: f64,
}

/// Takes down the centreline at the scene's frame times, as the cameras report it, and the tip's reach.
pub(super) struct Recorder<'a, T> {
    scene: &'a Scene,
    frames: Vec<Vec<Vec3<T>>>,
    tracks: Vec<Track<T>>,
    grip_forces_n: Vec<Vec<Vec3<T>>>,
    particles: Vec<Vec<Vec3<T>>>,
    reach_m: Option<T>,
    /// Motions of the grips in the step before.
    pub(super) motions: Vec<Option<RigidMotion<T>>>,
    /// Where each frame was taken.
    pub(super) marks: Vec<FrameMark>,
    /// After which step the tip reached furthest.
    pub(super) reach_state: usize,
}

impl<'a, T: Real> Recorder<'a, T> {
    pub(super) fn new(scene: &'a Scene) -> Self {
        Self {
            scene,
            frames: Vec::with_capacity(scene.frame_times_s.len()),
            tracks: Vec::with_capacity(scene.frame_times_s.len()),
            grip_forces_n: Vec::with_capacity(scene.frame_times_s.len()),
            particles: Vec::new(),
            reach_m: None,
            motions: vec![None; scene.grips.len()],
            marks: Vec::new(),
            reach_state: 0,
        }
    }

    /// Looks at the rope after `state` steps.
    #[inline(always)]
    pub(super) fn record(&mut self, engine: &impl Engine<T>, state: usize, setup: &Setup<T>) {
        let now_s = setup.time_s(state);
        let physics = setup.context.physics;
        let offset_s = self.scene.clock_offset_s(physics).value();
        while let Some(&due) = self.scene.frame_times_s.get(self.frames.len()) {
            // Before the start the rope lies as at the start.
            let due = (due - offset_s).max(0.0);
            if due > now_s + 1e-12 {
                break;
            }
            // Frames fall between steps: go back along the velocity, less than one step.
            let ahead_s = due - now_s;
            let middles = (0..engine.slices()).map(|slice| engine.slice_mean(slice));
            let track = Track {
                points_m: middles.clone().map(|(p, v)| add(p, scaled(v, ahead_s))).collect(),
                velocities_m_s: middles.map(|(_, v)| v).collect(),
            };
            self.frames.push(track.seen(physics, self.scene));
            self.tracks.push(track);
            if self.scene.keep_particles {
                let at = |(place, velocity): (Vec3<T>, Vec3<T>)| add(place, scaled(velocity, ahead_s));
                let members = setup.context.section;
                let of_slice = |slice| (0..members).map(move |member| at(engine.member(slice, member)));
                self.particles
                    .push((0..engine.slices()).flat_map(of_slice).collect());
            }
            self.marks.push(FrameMark { state, ahead_s });
            self.grip_forces_n
                .push(engine.grip_forces_n(&self.motions, setup.context.clamp_per_kg()));
        }
        if now_s >= self.scene.score_from_s {
            let tip = tip_x(engine, setup.layout.end_weights());
            if self.reach_m.is_none_or(|best| tip.value() > best.value()) {
                self.reach_m = Some(tip);
                self.reach_state = state;
            }
        }
    }

    pub(super) fn finish(&mut self, setup: &Setup<T>) -> Rollout<T> {
        Rollout {
            frames: std::mem::take(&mut self.frames),
            tracks: std::mem::take(&mut self.tracks),
            grip_forces_n: std::mem::take(&mut self.grip_forces_n),
            particles: std::mem::take(&mut self.particles),
            arc_m: setup.layout.slices.iter().map(|s| s.arc_m).collect(),
            reach_m: self.reach_m,
            end: Vec::new(),
            steps: setup.steps,
            dt_s: setup.context.dt_s,
        }
    }
}

/// x of the end point of the axis, from the last slice and the one before.
#[inline(always)]
fn tip_x<T: Real>(engine: &impl Engine<T>, weights: [f64; 2]) -> T {
    let n = engine.slices();
    engine.slice_x(n - 1).scale(weights[0]) + engine.slice_x(n - 2).scale(weights[1])
}

/// Two unit vectors (side, up) that complete `axis` to a right-handed frame. Up is z for a level rope; a
/// rope that hangs or stands is one that was turned about y without a roll, so that properties of the
/// material keep their side from a lift to a swing.
pub(super) fn perpendicular(axis: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    let helper = if axis[2].abs() < 0.9 {
        [0.0, 0.0, 1.0]
    } else {
        [-axis[2].signum(), 0.0, 0.0]
    };
    let along = axis.iter().zip(&helper).map(|(a, h)| a * h).sum::<f64>();
    let up = sub(helper, axis.map(|a| a * along));
    let length = up.iter().map(|c| c * c).sum::<f64>().sqrt();
    let up = up.map(|c| c / length);
    (super::tensor::cross(up, axis), up)
}
