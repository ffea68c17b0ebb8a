//! Laws that every effect of the registry must obey: it vanishes where it says, its tangents are
//! its slopes, its stress is the slope of its energy, it does not know the frame of the world, and
//! dissipation only takes.

use nalgebra::{Matrix3, Rotation3, Vector3};
use offline::effects::{self, ALL, Slope};
use offline::sim::axial;
use offline::sim::clamp::ClampPath;
use offline::sim::curve::Curve;
use offline::sim::elastic::energy_density;
use offline::sim::material::Material;
use offline::sim::physics::ForcePoint;
use offline::sim::rope::{RopeLayout, Sampling};
use offline::sim::scene::{Scene, StepLength, Table};
use offline::sim::start::{Hang, Start};
use offline::sim::statics::Pose;
use offline::sim::tensor::matmul;
use offline::sim::{Dual, Physics, Real, Rollout, simulate};
use offline::verify::{Stepper, matrix, rows};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tests::derivatives::LANES;
use tests::scenes::{knot, rope, start_grip};

/// Effects that only take energy, and how far off their vanishing value, in sizes of interest, they
/// act strongly on a flight.
const DISSIPATIVE: [(&str, f64); 3] = [("air_drag", 0.4), ("internal_damping", 0.4), ("yield", 9.0)];

/// A quick lift of one end off the table, a part of the rope still sliding on it, and a release.
fn lift() -> Scene {
    let path = ClampPath::new(vec![
        knot(0.0, [0.0; 3], true),
        knot(0.18, [0.02, 0.0, 0.04], false),
    ]);
    let grips = start_grip(0.02, path);
    let table = Some(Table { height_m: -0.007 });
    // Ends before the released end lands: where it touches down there is no slope.
    let times = vec![0.06, 0.12, 0.18, 0.2];
    let shape = rope(0.16, 0.014);
    let mut scene = Scene::new(shape, [0.0; 3], [1.0, 0.0, 0.0], grips, table, 1.5, times).unwrap();
    // No parameter of an effect may change the step between two rollouts that are compared.
    scene.step = StepLength::Fixed(1e-4);
    scene
}

/// The same rope held level at one end, at rest, and then swung from there.
fn swing_from_rest() -> Scene {
    let shape = rope(0.16, 0.014);
    let path = ClampPath::new(vec![
        knot(0.0, [0.0; 3], true),
        knot(0.1, [0.02, 0.0, 0.04], true),
    ]);
    let grips = start_grip(0.02, path);
    let mut scene = Scene::new(
        shape,
        [0.0; 3],
        [1.0, 0.0, 0.0],
        grips,
        None,
        1.5,
        vec![0.0, 0.06, 0.12],
    )
    .unwrap();
    scene.step = StepLength::Fixed(1e-4);
    let level = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let knots = [(0.0, [0.0; 3]), (shape.length_m, [shape.length_m, 0.0, 0.0])];
    scene.start = Start::Rest(Hang {
        frames: vec![level],
        poses: vec![Pose {
            t_s: 0.0,
            guess: Curve::through(shape.length_m, &knots, 0, &level),
            pins: Vec::new(),
            near: None,
        }],
        in_plane: false,
    });
    scene
}

/// A scene in which an effect can be seen: how a rope lies in its grip shows where it hangs.
fn scene_for(effect: usize) -> Scene {
    let vanishing: Vec<f64> = ALL[effect].vanishing().collect();
    if with_effect(effect, &vanishing).grip_tilt.is_some() {
        swing_from_rest()
    } else {
        lift()
    }
}

fn base<T: Real>() -> Physics<T> {
    Physics::base(T::of(0.4e6), T::of(0.3), T::of(0.4))
}

fn with_effect<T: Real>(effect: usize, values: &[T]) -> Physics<T> {
    let mut physics = base();
    effects::add_to(effect, values, &mut physics);
    physics
}

/// Values off the vanishing point, to the physical side, by `scale` of what is of interest.
fn values_off(effect: usize, scale: f64, rng: &mut ChaCha8Rng) -> Vec<f64> {
    ALL[effect]
        .parameters
        .iter()
        .map(|p| {
            let side = if p.high > p.vanishes_at { 1.0 } else { -1.0 };
            p.vanishes_at + side * scale * rng.random_range(0.5..1.0) * p.smallest_of_interest
        })
        .collect()
}

/// As far off as tangents hold: a little, or well beyond a secant's step.
fn values_with_tangents(effect: usize, rng: &mut ChaCha8Rng) -> Vec<f64> {
    let near_zero = ALL[effect].parameters.iter().all(|p| p.slope == Slope::Tangent);
    values_off(effect, if near_zero { 0.3 } else { 4.0 }, rng)
}

fn same_bits(a: &Rollout<f64>, b: &Rollout<f64>) -> bool {
    let bits =
        |r: &Rollout<f64>| -> Vec<u64> { r.frames.iter().flatten().flatten().map(|x| x.to_bits()).collect() };
    bits(a) == bits(b)
}

#[test]
fn an_effect_that_vanishes_leaves_the_base_model_bit_for_bit() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for (effect, spec) in ALL.iter().enumerate() {
        let (young, poisson, friction) = (
            10f64.powf(rng.random_range(5.0..6.0)),
            rng.random_range(0.1..0.4),
            rng.random_range(0.2..0.8),
        );
        let bare = Physics::base(young, poisson, friction);
        let mut physics = Physics::base(young, poisson, friction);
        let values: Vec<f64> = spec.vanishing().collect();
        effects::add_to(effect, &values, &mut physics);
        let scene = scene_for(effect);
        let [without, with] = [&bare, &physics].map(|physics| simulate(&scene, physics).unwrap());
        assert!(same_bits(&without, &with), "{} at E = {young:.2e} Pa", spec.id);
    }
}

/// An effect that changes nothing when it is there would pass every other test.
#[test]
fn every_effect_changes_a_motion() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for (effect, spec) in ALL.iter().enumerate() {
        let physics = with_effect(effect, &values_with_tangents(effect, &mut rng));
        let scene = scene_for(effect);
        let [without, with] = [&base(), &physics].map(|physics| simulate(&scene, physics).unwrap());
        assert!(!same_bits(&without, &with), "{}", spec.id);
    }
}

/// A motion in the plane y = 0 leaves it by what is said to act sideways, and by nothing else.
#[test]
fn what_acts_sideways_moves_a_rope_out_of_its_plane_and_nothing_else_does() {
    for (effect, spec) in ALL.iter().enumerate() {
        let scene = scene_for(effect);
        for (k, p) in spec.parameters.iter().enumerate() {
            let mut values: Vec<f64> = spec.vanishing().collect();
            values[k] = (values[k] + 0.5 * p.smallest_of_interest).min(p.high);
            let run = simulate(&scene, &with_effect(effect, &values)).unwrap();
            let points = run.frames.iter().flatten();
            let out_m = points.map(|point| point[1].abs()).fold(0.0, f64::max);
            let expected = if p.sideways { out_m > 1e-6 } else { out_m < 1e-12 };
            assert!(expected, "{} {}: {out_m:.2e} m", spec.id, p.name);
        }
    }
}

/// Where a node changes between sliding and sticking, or contact closes, there is no derivative;
/// differences this small rarely meet such a step.
#[test]
fn tangents_are_slopes_for_every_parameter() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for (effect, spec) in ALL.iter().enumerate() {
        let count = spec.parameters.len();
        assert!(count <= LANES);
        if spec.parameters.iter().any(|p| p.slope == Slope::Secant) {
            continue;
        }
        let scene = scene_for(effect);
        let values = values_with_tangents(effect, &mut rng);
        let inputs: Vec<Dual<f64, LANES>> = values
            .iter()
            .enumerate()
            .map(|(k, &v)| Dual::input(v, k))
            .collect();
        let dual = simulate(&scene, &with_effect(effect, &inputs)).unwrap();
        for (k, parameter) in spec.parameters.iter().enumerate() {
            // Large steps meet more changes between sliding and sticking, small ones drown in
            // rounding where the effect is small (tangential drag: micrometres per unit).
            let error = [1e-4, 1e-5]
                .map(|share| {
                    let h = share * parameter.smallest_of_interest;
                    slope_error(&scene, effect, &values, (k, h), &dual)
                })
                .into_iter()
                .fold(f64::INFINITY, f64::min);
            println!("{}.{}: relative error {error:.2e}", spec.id, parameter.name);
            assert!(error < 1e-3, "{}.{}: {error:.2e}", spec.id, parameter.name);
        }
    }
}

/// Difference between tangents and the central difference of step h, relative to its size.
fn slope_error(
    scene: &Scene,
    effect: usize,
    values: &[f64],
    (k, h): (usize, f64),
    dual: &Rollout<Dual<f64, LANES>>,
) -> f64 {
    let shifted = |sign: f64| {
        let mut moved = values.to_vec();
        moved[k] += sign * h;
        simulate(scene, &with_effect(effect, &moved)).unwrap()
    };
    let (plus, minus) = (shifted(1.0), shifted(-1.0));
    assert!(
        plus.dt_s == minus.dt_s,
        "the step must not depend on {}",
        ALL[effect].id
    );
    let (mut wrong, mut size) = (0.0, 0.0);
    for (f, frame) in dual.frames.iter().enumerate() {
        for (p, point) in frame.iter().enumerate() {
            for c in 0..3 {
                let slope = (plus.frames[f][p][c] - minus.frames[f][p][c]) / (2.0 * h);
                wrong += (point[c].tangent[k] - slope).powi(2);
                size += slope * slope;
            }
        }
    }
    assert!(size > 0.0, "{}: parameter {k} does nothing", ALL[effect].id);
    f64::sqrt(wrong / size)
}

/// A random state of a particle: well inside the range of strains and speeds of a rope.
struct State {
    velocity: Vector3<f64>,
    f: Matrix3<f64>,
    l: Matrix3<f64>,
}

fn random_state(rng: &mut ChaCha8Rng) -> State {
    let mut matrix = |size: f64| Matrix3::from_fn(|_, _| rng.random_range(-size..size));
    let (f, l) = (Matrix3::identity() + matrix(0.2), matrix(20.0));
    let velocity = matrix(3.0).column(0).into_owned();
    State { velocity, f, l }
}

fn turned(state: &State, turn: &Matrix3<f64>) -> State {
    State {
        velocity: turn * state.velocity,
        f: turn * state.f,
        l: turn * state.l * turn.transpose(),
    }
}

/// First column of the stress of the axial laws, Pa; zero where there is none.
fn axial_column_pa(physics: &Physics<f64>, state: &State) -> Vector3<f64> {
    let cubic_pa = physics.cubic_pa(&physics.lame()).unwrap_or(0.0);
    axial::piola_column(axial::axis(&rows(&state.f)), cubic_pa).into()
}

fn force_n(physics: &Physics<f64>, state: &State) -> Vector3<f64> {
    let point = ForcePoint {
        position_m: [0.1, 0.2, 0.3],
        velocity_m_s: state.velocity.into(),
        tangent: state.f.column(0).normalize().into(),
        length_m: 0.001,
        diameter_m: 0.014,
        mass_kg: 1e-4,
    };
    physics
        .force_laws
        .iter()
        .map(|law| Vector3::from(law.force_n(&point)))
        .sum()
}

/// Turning the state turns stresses along the axis, forces and plastic flow. Other stresses: see the turned rope below.
#[test]
fn laws_turn_with_the_rope() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for effect in 0..ALL.len() {
        let id = ALL[effect].id;
        for _ in 0..50 {
            let physics = with_effect(effect, &values_off(effect, 5.0, &mut rng));
            let state = random_state(&mut rng);
            let (turn, _) = random_turn(&mut rng);
            let there = turned(&state, &turn);
            let column = axial_column_pa(&physics, &state);
            let error = (axial_column_pa(&physics, &there) - turn * column).norm();
            assert!(error <= 1e-12 * column.norm(), "{id}: {error:.2e} Pa");
            for law in &physics.flow_laws {
                let relaxed = |state: &State| law.relaxation(&rows(&state.f)).map(|m| matrix(&m));
                let difference = relaxed(&there).unwrap_or_default() - relaxed(&state).unwrap_or_default();
                assert!(difference.norm() <= 1e-12, "{id}");
            }
            // A wind blows from somewhere: its force knows the world.
            if id != "steady_wind" {
                let force = force_n(&physics, &state);
                let error = (force_n(&physics, &there) - turn * force).norm();
                assert!(error <= 1e-12 * force.norm(), "{id}");
            }
        }
    }
}

fn random_turn(rng: &mut ChaCha8Rng) -> (Matrix3<f64>, Matrix3<f64>) {
    let angles: [f64; 3] = std::array::from_fn(|_| rng.random_range(-3.0..3.0));
    let turn = Rotation3::from_euler_angles(angles[0], angles[1], angles[2]).into_inner();
    (turn, Vector3::from(angles).cross_matrix() * 30.0)
}

/// A short rope in a state of large, random strain, which may change.
struct StrainedRope {
    layout: RopeLayout,
    gradients: Vec<[[f64; 3]; 3]>,
    rates: Vec<[[f64; 3]; 3]>,
}

impl StrainedRope {
    fn new(rng: &mut ChaCha8Rng) -> Self {
        let layout = RopeLayout::new(rope(0.04, 0.014), &[], 0.009, Sampling::default());
        let strained =
            |_| rows(&(Matrix3::identity() + Matrix3::from_fn(|_, _| rng.random_range(-0.1..0.1))));
        Self {
            gradients: (0..layout.particles()).map(strained).collect(),
            rates: vec![[[0.0; 3]; 3]; layout.particles()],
            layout,
        }
    }

    /// The same, changing at random rates.
    fn moving(rng: &mut ChaCha8Rng) -> Self {
        let mut strained = Self::new(rng);
        for rate in &mut strained.rates {
            *rate = rows(&Matrix3::from_fn(|_, _| rng.random_range(-20.0..20.0)));
        }
        strained
    }

    fn turned(&self, turn: &Matrix3<f64>, spin: &Matrix3<f64>) -> Self {
        let turned = |f: &[[f64; 3]; 3]| turn * matrix(f);
        let rate = |(f, rate): (_, _)| rows(&(turned(rate) + spin * turned(f)));
        Self {
            gradients: self.gradients.iter().map(|f| rows(&turned(f))).collect(),
            rates: self.gradients.iter().zip(&self.rates).map(rate).collect(),
            layout: self.layout.clone(),
        }
    }

    fn material(&self, physics: &Physics<f64>) -> Material<f64> {
        let mut material = Material::new(physics, &self.layout);
        material.advance(physics, 1e-4, |index| {
            (&self.gradients[index], &self.rates[index])
        });
        material
    }

    fn energy_j(&self, physics: &Physics<f64>) -> f64 {
        let volumes: Vec<f64> = (0..self.layout.particles())
            .map(|p| self.layout.particle_volume_m3(p))
            .collect();
        self.material(physics)
            .energy_j(physics, |index| &self.gradients[index], &volumes)
    }

    fn piola_pa(&self, physics: &Physics<f64>) -> Vec<Matrix3<f64>> {
        let (material, lame) = (self.material(physics), physics.lame());
        let motion = |index| (&self.gradients[index], &self.rates[index]);
        (0..self.gradients.len())
            .map(|index| matrix(&material.piola(index, motion(index).0, physics, &lame).0))
            .collect()
    }
}

/// P V = ∂W/∂F for the whole rope: elasticity, axial laws, stress-free shape and bending together.
/// Plastic flow has no energy of its own.
#[test]
fn stress_is_the_slope_of_the_stored_energy() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    for effect in 0..ALL.len() {
        let physics = with_effect(effect, &values_off(effect, 5.0, &mut rng));
        if !physics.flow_laws.is_empty() {
            continue;
        }
        let mut strained = StrainedRope::new(&mut rng);
        let stress = strained.piola_pa(&physics);
        for _ in 0..30 {
            let index = rng.random_range(0..strained.gradients.len());
            let (a, b) = (rng.random_range(0..3), rng.random_range(0..3));
            let middle = strained.gradients[index][a][b];
            let h = 1e-5;
            let mut energy_at = |value: f64| {
                strained.gradients[index][a][b] = value;
                strained.energy_j(&physics)
            };
            let slope = (energy_at(middle + h) - energy_at(middle - h)) / (2.0 * h);
            strained.gradients[index][a][b] = middle;
            let expected = slope / strained.layout.particle_volume_m3(index);
            let error = (stress[index][(a, b)] - expected).abs();
            assert!(
                error < 1e-6 * physics.young_pa,
                "{}: {} Pa against {expected} Pa",
                ALL[effect].id,
                stress[index][(a, b)]
            );
        }
    }
}

/// The same for the stress of the whole material: P(Q F) = Q P(F), and no energy in a rotation.
#[test]
fn a_turned_rope_stores_the_same_energy_and_its_stress_turns() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    for effect in 0..ALL.len() {
        let physics = with_effect(effect, &values_off(effect, 5.0, &mut rng));
        let strained = StrainedRope::moving(&mut rng);
        let (turn, spin) = random_turn(&mut rng);
        let there = strained.turned(&turn, &spin);
        let (here_j, there_j) = (strained.energy_j(&physics), there.energy_j(&physics));
        assert!((there_j / here_j - 1.0).abs() < 1e-9, "{}", ALL[effect].id);
        let pairs = strained
            .piola_pa(&physics)
            .into_iter()
            .zip(there.piola_pa(&physics));
        for (here, there) in pairs {
            assert!(
                (there - turn * here).norm() < 1e-9 * physics.young_pa,
                "{}",
                ALL[effect].id
            );
        }
    }
}

/// Drag does negative work on every velocity, Kelvin-Voigt positive work on every rate of strain, and
/// plastic flow lowers the elastic energy.
#[test]
fn dissipative_laws_take_power_in_every_state() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for (id, _) in DISSIPATIVE {
        let effect = effects::find(id).unwrap();
        for _ in 0..200 {
            let physics = with_effect(effect, &values_off(effect, 5.0, &mut rng));
            let state = random_state(&mut rng);
            let power_w = force_n(&physics, &state).dot(&state.velocity);
            let rate = 0.5 * (state.l + state.l.transpose());
            let mut released = 0.0;
            for law in &physics.memory_laws {
                let viscosity = law.viscosity(&physics.lame());
                released +=
                    2.0 * viscosity.mu * rate.norm_squared() + viscosity.lambda * rate.trace().powi(2);
            }
            for law in &physics.flow_laws {
                let (f, lame) = (rows(&state.f), physics.lame());
                let relaxed = law.relaxation(&f).map_or(f, |relaxed| matmul(&f, &relaxed));
                released += energy_density(&f, &lame) - energy_density(&relaxed, &lame);
            }
            assert!(power_w <= 0.0 && released >= 0.0, "{id}");
            let acts = power_w < 0.0 || released > 0.0;
            assert!(acts, "{id} must do something");
        }
    }
}

/// Laws that remember strain take work on the way from a shape and back to it, at every pace; elasticity takes none.
#[test]
fn a_cycle_of_strain_costs_work_under_every_law_that_remembers() {
    const STEPS: usize = 4000;
    let mut rng = ChaCha8Rng::seed_from_u64(12);
    let layout = RopeLayout::new(rope(0.04, 0.014), &[], 0.009, Sampling::default());
    let cases: [(&str, &[f64]); 3] = [
        ("internal_damping", &[0.08]),
        ("relaxation", &[0.5, 0.0]),
        ("relaxation", &[0.0, 0.5]),
    ];
    for (id, values) in cases {
        let physics = with_effect(effects::find(id).unwrap(), values);
        for period_s in [0.02, 0.5, 3.0] {
            let far = Matrix3::from_fn(|_, _| rng.random_range(-0.1..0.1));
            let dt_s = period_s / STEPS as f64;
            // Work over the volume, Pa: the integral of P : dF, once round.
            let work_pa = |physics: &Physics<f64>| -> f64 {
                let mut material = Material::new(physics, &layout);
                let power = |k: usize| {
                    let (sin, cos) = (k as f64 / STEPS as f64 * std::f64::consts::TAU).sin_cos();
                    let (f, rate) = (
                        Matrix3::identity() + sin * far,
                        cos / period_s * std::f64::consts::TAU * far,
                    );
                    let motion = (rows(&f), rows(&rate));
                    material.advance(physics, dt_s, |_| (&motion.0, &motion.1));
                    let stress = matrix(&material.piola(0, &motion.0, physics, &physics.lame()).0);
                    stress.dot(&rate) * dt_s
                };
                (0..STEPS).map(power).sum()
            };
            let stored_pa = energy_density(&rows(&(Matrix3::identity() + far)), &physics.lame());
            let [taken, elastic] = [&physics, &base()].map(|physics| work_pa(physics) / stored_pa);
            println!("{id} {values:?}, {period_s} s: {taken:.4} of what is stored, elastic {elastic:.1e}");
            assert!(
                taken > 1e-3 && elastic.abs() < 1e-6,
                "{id} {values:?} {period_s}: {taken} {elastic}"
            );
        }
    }
}

/// Largest rise of an energy between any earlier and any later time, J.
fn largest_rise(energies: &[f64]) -> f64 {
    let mut low = f64::INFINITY;
    let mut rise = 0f64;
    for &e in energies {
        low = low.min(e);
        rise = rise.max(e - low);
    }
    rise
}

/// Energy of a free rope that turns and bends in flight. Symplectic Euler lets the energy of an
/// rope wave a little, by the square of the step; a damped one may rise by no more than that.
#[test]
fn dissipative_effects_never_add_energy_to_a_flight() {
    let mut scene = lift();
    scene.grips.clear();
    scene.table = None;
    let flight = |physics: &Physics<f64>| {
        let mut run = Stepper::new(&scene, physics);
        run.set_motion(
            Vector3::new(1.0, 0.5, 0.0),
            Matrix3::new(4.0, 0.0, -9.0, 3.0, 0.0, 0.0, 12.0, 0.0, 0.0),
        );
        let mut energies = vec![run.energy_of_step_j().unwrap()];
        for _ in 0..40 {
            run.advance(50).unwrap();
            energies.push(run.energy_of_step_j().unwrap());
        }
        energies
    };
    let undamped = flight(&base());
    let wave = largest_rise(&undamped);
    println!(
        "undamped: {:.3e} J to {:.3e} J, rise {wave:.1e} J",
        undamped[0], undamped[40]
    );
    let waves = 1e-5 * undamped[0];
    assert!(wave < waves);
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    for (id, strength) in DISSIPATIVE {
        let effect = effects::find(id).unwrap();
        let damped = flight(&with_effect(effect, &values_off(effect, strength, &mut rng)));
        let rise = largest_rise(&damped);
        println!(
            "{id}: {:.3e} J to {:.3e} J, rise {rise:.1e} J",
            damped[0], damped[40]
        );
        assert!(
            rise < waves && damped[40] < undamped[40],
            "{id}: rise {rise:.1e} J"
        );
    }
}
