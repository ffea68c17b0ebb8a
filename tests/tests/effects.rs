//! Laws that every effect of the registry must obey: it vanishes where it says, its tangents are
//! its slopes, it does not know the frame of the world, and dissipation only takes.

use nalgebra::{Matrix3, Rotation3, Vector3};
use offline::effects::{self, ALL};
use offline::sim::physics::{ForcePoint, StressPoint};
use offline::sim::{Dual, Physics, Real, Rollout, simulate};
use offline::verify::{Stepper, matrix, rows};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tests::derivatives::{Slope, lift, slope};

/// Most parameters that an effect has.
const MOST: usize = 3;
/// Effects that only take energy.
const DISSIPATIVE: [&str; 2] = ["air_drag", "internal_damping"];

/// A rope that steps at the speed bound, so that no parameter of an effect changes the step.
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

fn same_bits(a: &Rollout<f64>, b: &Rollout<f64>) -> bool {
    let bits =
        |r: &Rollout<f64>| -> Vec<u64> { r.frames.iter().flatten().flatten().map(|x| x.to_bits()).collect() };
    bits(a) == bits(b)
}

#[test]
fn an_effect_that_vanishes_leaves_the_base_model_bit_for_bit() {
    let scene = lift();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for (effect, spec) in ALL.iter().enumerate() {
        let (young, poisson, friction) = (
            10f64.powf(rng.random_range(5.0..6.0)),
            rng.random_range(0.1..0.4),
            rng.random_range(0.2..0.8),
        );
        let bare = Physics::base(young, poisson, friction);
        let mut physics = Physics::base(young, poisson, friction);
        let values: Vec<f64> = spec.parameters.iter().map(|p| p.vanishes_at).collect();
        effects::add_to(effect, &values, &mut physics);
        let (without, with) = (
            simulate(&scene, &bare).unwrap(),
            simulate(&scene, &physics).unwrap(),
        );
        assert!(same_bits(&without, &with), "{} at E = {young:.2e} Pa", spec.id);
    }
}

/// An effect that changes nothing when it is there would pass every other test.
#[test]
fn every_effect_changes_a_lift() {
    let scene = lift();
    let without = simulate(&scene, &base()).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for (effect, spec) in ALL.iter().enumerate() {
        let with = simulate(&scene, &with_effect(effect, &values_off(effect, 0.3, &mut rng))).unwrap();
        assert!(!same_bits(&without, &with), "{}", spec.id);
    }
}

/// Where a node changes between sliding and sticking, or contact closes, there is no derivative;
/// differences this small rarely meet such a step.
#[test]
fn tangents_are_slopes_for_every_parameter() {
    let scene = lift();
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for (effect, spec) in ALL.iter().enumerate() {
        let count = spec.parameters.len();
        assert!(count <= MOST);
        let values = values_off(effect, 0.3, &mut rng);
        let inputs: Vec<Dual<f64, MOST>> = values
            .iter()
            .enumerate()
            .map(|(k, &v)| Dual::input(v, k))
            .collect();
        let dual = simulate(&scene, &with_effect(effect, &inputs)).unwrap();
        for (k, parameter) in spec.parameters.iter().enumerate() {
            // Tangential drag moves the rope by micrometres per unit: differences much
            // smaller drown in rounding, larger ones in steps between sliding and sticking.
            let h = 1e-4 * parameter.smallest_of_interest;
            let sides = [-1.0, 1.0].map(|sign| {
                let mut moved = values.clone();
                moved[k] += sign * h;
                simulate(&scene, &with_effect(effect, &moved)).unwrap()
            });
            let Slope { size, error } = slope((&dual, k), 0..dual.frames.len(), &sides, h);
            println!("{}.{}: relative error {error:.2e}", spec.id, parameter.name);
            assert!(
                size > 0.0 && error < 1e-3,
                "{}.{}: {error:.2e}",
                spec.id,
                parameter.name
            );
        }
    }
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

fn turned(state: &State, turn: &Matrix3<f64>, spin: &Matrix3<f64>) -> State {
    State {
        velocity: turn * state.velocity,
        f: turn * state.f,
        l: turn * state.l * turn.transpose() + spin,
    }
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

fn kirchhoff_pa(physics: &Physics<f64>, state: &State) -> Matrix3<f64> {
    let (f, l) = (rows(&state.f), rows(&state.l));
    let point = StressPoint {
        deformation_gradient: &f,
        velocity_gradient: &l,
        volume_ratio: state.f.determinant(),
        lame: &physics.lame(),
    };
    physics
        .stress_laws
        .iter()
        .map(|law| matrix(&law.kirchhoff_pa(&point)))
        .sum()
}

/// Turning the state turns force and stress, and a rigid spin on top adds no stress.
#[test]
fn laws_turn_with_the_rope() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for effect in 0..ALL.len() {
        for _ in 0..50 {
            let physics = with_effect(effect, &values_off(effect, 5.0, &mut rng));
            let state = random_state(&mut rng);
            let angles: [f64; 3] = std::array::from_fn(|_| rng.random_range(-3.0..3.0));
            let turn = Rotation3::from_euler_angles(angles[0], angles[1], angles[2]).into_inner();
            let spin = Vector3::from(angles).cross_matrix() * 30.0;
            let there = turned(&state, &turn, &spin);
            let (force, stress) = (force_n(&physics, &state), kirchhoff_pa(&physics, &state));
            let id = ALL[effect].id;
            assert!(
                (force_n(&physics, &there) - turn * force).norm() <= 1e-12 * force.norm(),
                "{id}"
            );
            let expected = turn * stress * turn.transpose();
            let error = (kirchhoff_pa(&physics, &there) - expected).norm();
            assert!(error <= 1e-12 * stress.norm(), "{id}: {error:.2e} Pa");
        }
    }
}

/// Drag does negative work on every velocity, Kelvin-Voigt positive work on every rate of strain.
#[test]
fn dissipative_laws_take_power_in_every_state() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for id in DISSIPATIVE {
        let effect = effects::find(id).unwrap();
        for _ in 0..200 {
            let physics = with_effect(effect, &values_off(effect, 5.0, &mut rng));
            let state = random_state(&mut rng);
            let power_w = force_n(&physics, &state).dot(&state.velocity);
            let rate = 0.5 * (state.l + state.l.transpose());
            let dissipated = kirchhoff_pa(&physics, &state).dot(&rate);
            assert!(power_w <= 0.0 && dissipated >= 0.0, "{id}");
            assert!(power_w < 0.0 || dissipated > 0.0, "{id} must do something");
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
/// undamped rope wave a little; a damped one may rise by no more than that.
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
        let mut energies = vec![run.energy_j()];
        for _ in 0..40 {
            run.advance(50).unwrap();
            energies.push(run.energy_j());
        }
        energies
    };
    let undamped = flight(&base());
    let wave = largest_rise(&undamped);
    println!(
        "undamped: {:.3e} J to {:.3e} J, rise {wave:.1e} J",
        undamped[0], undamped[40]
    );
    assert!(wave < 5e-3 * undamped[0]);
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    for id in DISSIPATIVE {
        let effect = effects::find(id).unwrap();
        let damped = flight(&with_effect(effect, &values_off(effect, 0.4, &mut rng)));
        let rise = largest_rise(&damped);
        println!(
            "{id}: {:.3e} J to {:.3e} J, rise {rise:.1e} J",
            damped[0], damped[40]
        );
        assert!(
            rise <= wave && damped[40] < undamped[40],
            "{id}: rise {rise:.1e} J"
        );
    }
}
