//! The twin world's rod against exact solutions of mechanics.

use nalgebra::Vector3;
use offline::demo::{RopeEnd, RopeSpec};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::PI;
use tests::contact::Table;
use tests::dynamics::{ClampMotion, Material, World};
use tests::effects::WorldEffects;
use tests::motion::ClampPath;
use tests::rod::{BentSection, Rod, RodSpec};

const G: f64 = 9.81;
const LENGTH: f64 = 0.25;
const DIAMETER: f64 = 0.014;

fn material(young_pa: f64, direction: [f64; 3]) -> Material {
    Material {
        rope: RopeSpec {
            length_m: LENGTH,
            diameter_m: DIAMETER,
            mass_kg: 0.0385,
            direction,
            end_mass_kg: 0.0,
            roll_rad: 0.0,
            assumed: Vec::new(),
        },
        young_pa,
        segments: 25,
        retardation_s: 0.0,
    }
}

fn fixed(grip_m: f64) -> Vec<ClampMotion> {
    vec![ClampMotion {
        end: RopeEnd::Start,
        grip_m,
        path: ClampPath::new([0.0; 3], 0.0, &[]),
        opens_at_s: None,
    }]
}

/// Drag that brings a motion of a few Hz to rest within a second.
fn settling() -> WorldEffects {
    WorldEffects {
        drag_linear_per_s: 60.0,
        ..WorldEffects::default()
    }
}

fn close(value: f64, exact: f64, relative: f64) {
    assert!(
        (value / exact - 1.0).abs() < relative,
        "{value} against {exact}, off by {:.2e}",
        value / exact - 1.0
    );
}

/// Kelvin-Voigt damping with retardation time `tau`, s.
fn damped(tau: f64) -> WorldEffects {
    WorldEffects {
        damping_s: tau,
        ..WorldEffects::default()
    }
}

fn area() -> f64 {
    PI * DIAMETER * DIAMETER / 4.0
}

fn stiffness(young_pa: f64) -> f64 {
    young_pa * PI * DIAMETER.powi(4) / 64.0
}

/// Timoshenko: sag w L⁴/(8 EI) + M g L³/(3 EI) and, of shear, (w L²/2 + M g L)/(κ G A), from the end of the grip.
#[test]
fn a_cantilever_sags_as_timoshenko_says() {
    let young = 5e7;
    let free = LENGTH - 0.02;
    for tip in [0.0, 0.002] {
        let effects = WorldEffects {
            tip_mass_kg: tip,
            ..settling()
        };
        let mut world = World::new(
            &material(young, [1.0, 0.0, 0.0]),
            [0.0; 3],
            None,
            &fixed(0.02),
            &effects,
        );
        world.advance_to(1.0);
        let weight = 0.0385 * G / LENGTH;
        let bent = weight * free.powi(4) / 8.0 + tip * G * free.powi(3) / 3.0;
        let sheared = 0.5 * weight * free.powi(2) + tip * G * free;
        let sag = bent / stiffness(young) + sheared / world.rod.shear;
        close(-world.rod.x[25].z, sag, 0.005);
    }
}

#[test]
fn a_free_rope_falls_freely() {
    let mut world = World::new(
        &material(9e5, [1.0, 0.0, 0.0]),
        [0.0; 3],
        None,
        &[],
        &WorldEffects::default(),
    );
    world.advance_to(0.4);
    for x in &world.rod.x {
        close(x.z, -0.5 * G * 0.16, 1e-3);
    }
    assert!((world.rod.x[25].x - LENGTH).abs() < 1e-9);
}

/// A bar hung up by its end stretches by ρ g L²/(2E) + M g L/(EA).
#[test]
fn a_hanging_rope_stretches_by_its_weight() {
    let young = 9e5;
    let effects = WorldEffects {
        tip_mass_kg: 0.009,
        ..settling()
    };
    let mut world = World::new(
        &material(young, [0.0, 0.0, -1.0]),
        [0.0; 3],
        None,
        &fixed(1e-4),
        &effects,
    );
    world.advance_to(0.6);
    let stretch = (0.5 * 0.0385 + 0.009) * G * LENGTH / (young * area());
    close(-world.rod.x[25].z - LENGTH, stretch, 0.002);
}

/// A physical pendulum: a rod hinged at its end swings with T = 2π √(2L/3g).
#[test]
fn a_hinged_rope_swings_as_a_physical_pendulum() {
    let angle: f64 = 0.05;
    let material = material(5e7, [angle.sin(), 0.0, -angle.cos()]);
    let mut world = World::new(&material, [0.0; 3], None, &fixed(1e-4), &WorldEffects::default());
    let (mut crossing, mut before) = (None, world.rod.x[25].x);
    let step = 1e-4;
    for index in 1..4000 {
        world.advance_to(f64::from(index) * step);
        let now = world.rod.x[25].x;
        if now < 0.0 && crossing.is_none() {
            crossing = Some((f64::from(index) - now / (now - before)) * step);
        }
        before = now;
    }
    let period = 2.0 * PI * (2.0 * LENGTH / (3.0 * G)).sqrt();
    close(
        4.0 * crossing.expect("the pendulum passes below its hinge"),
        period,
        0.005,
    );
}

/// The first bending mode of a cantilever: ω = 3.516 √(EI/ρA)/L², which Kelvin-Voigt damping with
/// retardation time τ makes decay at τ ω²/2. Dropped from straight, the tip swings about its sag.
#[test]
fn a_cantilever_vibrates_and_decays_at_its_first_mode() {
    let young = 5e7;
    let tau = 1e-3;
    let mut world = World::new(
        &material(young, [1.0, 0.0, 0.0]),
        [0.0; 3],
        None,
        &fixed(0.02),
        &damped(tau),
    );
    let density = 0.0385 / LENGTH;
    let omega = 3.516 * (stiffness(young) / density).sqrt() / (LENGTH - 0.02f64).powi(2);
    swings_and_decays(&mut world, [omega, tau], |world| world.rod.x[25].z);
}

/// The first modes of stretch and twist of a rod that is held at one end, ω = π c/(2L) with c² = E/ρ and G/ρ, decay at
/// τ ω²/2 as well.
#[test]
fn a_held_rope_stretches_and_twists_at_its_first_modes_and_both_decay() {
    let young = 9e5;
    let tau = 1e-3;
    let hanging = |grip_m: f64| {
        let material = material(young, [0.0, 0.0, -1.0]);
        World::new(&material, [0.0; 3], None, &fixed(grip_m), &damped(tau))
    };
    let wave_m_s = (young * area() * LENGTH / 0.0385).sqrt();
    // Let go unstretched, it bounces about its stretch.
    let omega = 0.5 * PI * wave_m_s / LENGTH;
    swings_and_decays(&mut hanging(1e-4), [omega, tau], |world| world.rod.x[25].z);

    // Held by two segments: the section of the second is the wall.
    let mut twisted = hanging(0.02);
    let free_m = LENGTH - 0.015;
    let axis = Vector3::new(0.0, 0.0, -1.0);
    let straight = twisted.rod.sides[0];
    for (j, side) in twisted.rod.sides.iter_mut().enumerate().skip(2) {
        let share = (0.01 * j as f64 - 0.01) / free_m;
        let angle = 0.3 * (0.5 * PI * share).sin();
        *side = straight * angle.cos() + axis.cross(&straight) * angle.sin();
    }
    let omega = 0.5 * PI * wave_m_s / 2.6f64.sqrt() / free_m;
    let angle = |world: &World| axis.dot(&straight.cross(&world.rod.sides[24])).asin();
    swings_and_decays(&mut twisted, [omega, tau], angle);
}

/// Eight half swings of what is read take 8 π/ω and shrink at τ ω²/2.
fn swings_and_decays(world: &mut World, [omega, tau]: [f64; 2], read: impl Fn(&World) -> f64) {
    let step = 0.002 * PI / omega;
    let mut turns = Vec::new();
    let (mut before, mut rising) = (read(world), false);
    for index in 1..=6000 {
        let t = f64::from(index) * step;
        world.advance_to(t);
        let now = read(world);
        if (now > before) != rising {
            turns.push((t, before));
            rising = now > before;
        }
        before = now;
        if turns.len() == 10 {
            break;
        }
    }
    let [first, last] = [turns[1], turns[9]];
    close((last.0 - first.0) / 8.0, PI / omega, 0.01);
    let swing = |k: usize| (turns[k].1 - turns[k + 1].1).abs();
    let decay = (swing(1) / swing(8)).ln() / (turns[8].0 - turns[1].0);
    close(decay, 0.5 * tau * omega * omega, 0.1);
}

fn straight(segments: usize, retardation_s: f64) -> Rod {
    let spec = RodSpec {
        length_m: LENGTH,
        diameter_m: DIAMETER,
        mass_kg: 0.0385,
        young_pa: 9e5,
        poisson: 0.3,
        section: BentSection::SOLID,
        segments,
        retardation_s,
    };
    Rod::straight(&spec, Vector3::zeros(), Vector3::x())
}

fn crumpled(retardation_s: f64) -> Rod {
    let mut rod = straight(12, retardation_s);
    // As where a clamp gives.
    rod.bend_share[5] = 0.4;
    rod.natural_per_m.fill(7.0);
    let mut random = ChaCha8Rng::seed_from_u64(4);
    let mut vector = || Vector3::from_fn(|_, _| random.random::<f64>() - 0.5);
    for i in 0..rod.x.len() {
        rod.x[i] += vector() * 0.01;
        rod.v[i] = vector();
    }
    for j in 0..rod.directors.len() {
        let director = (rod.directors[j] + vector()).normalize();
        rod.directors[j] = director;
        rod.sides[j] = director.cross(&vector()).normalize();
        rod.turning[j] = vector() * 10.0;
    }
    rod
}

#[test]
fn elastic_forces_are_the_slope_of_the_energy() {
    let mut rod = crumpled(0.0);
    let mut force = vec![Vector3::zeros(); rod.x.len()];
    rod.add_forces(&mut force);
    let largest = force.iter().map(|f| f.norm()).fold(0.0, f64::max);
    for i in 0..rod.x.len() {
        for k in 0..3 {
            let step = 1e-7;
            let (mut up, mut down) = (rod.clone(), rod.clone());
            up.x[i][k] += step;
            down.x[i][k] -= step;
            let slope = (up.elastic_energy_j() - down.elastic_energy_j()) / (2.0 * step);
            assert!((force[i][k] + slope).abs() < 1e-6 * largest, "node {i} axis {k}");
        }
    }
    let largest = rod.torques().iter().map(|t| t.norm()).fold(0.0, f64::max);
    for (j, torque) in rod.torques().iter().enumerate() {
        for k in 0..3 {
            let turned = |angle: f64| {
                let mut rod = rod.clone();
                let axis = Vector3::from_fn(|a, _| if a == k { angle } else { 0.0 });
                rod.directors[j] = nalgebra::Rotation3::new(axis) * rod.directors[j];
                rod.sides[j] = nalgebra::Rotation3::new(axis) * rod.sides[j];
                rod.elastic_energy_j()
            };
            let step = 1e-6;
            let slope = (turned(step) - turned(-step)) / (2.0 * step);
            assert!(
                (torque[k] + slope).abs() < 1e-6 * largest,
                "director {j} axis {k}"
            );
        }
    }
}

/// Bent to a ring's arc: a solid section's moment falls behind EI κ, and the fibres stretch its axis.
#[test]
fn a_bent_section_is_squeezed_and_stretches_its_axis() {
    let curvature_per_m = 0.25 / (0.5 * DIAMETER);
    let segments = 100;
    let arc = |stretch: f64| {
        let mut rod = straight(segments, 0.0);
        for j in 0..segments {
            let angle = curvature_per_m * rod.rest_m * j as f64;
            rod.directors[j] = Vector3::new(angle.cos(), 0.0, angle.sin());
            rod.x[j + 1] = rod.x[j] + rod.directors[j] * (rod.rest_m * (1.0 + stretch));
        }
        rod
    };
    let square = 0.25f64.powi(2);
    let mut rod = arc(0.163 * square);
    let mut force = vec![Vector3::zeros(); segments + 1];
    rod.add_forces(&mut force);
    // But for the chain's corners nothing pulls, where the axis without its stretch would with 0.01 EA.
    assert!(force[50].norm() < 1e-5 * 9e5 * area(), "{}", force[50]);
    let moment = rod.torques()[0].norm();
    let expected = stiffness(9e5) * curvature_per_m * (1.0 - 0.515 * square);
    // The next order of the law, and of the chain's corners.
    close(moment, expected, 2e-3);
    let energy = |stretch: f64| arc(stretch).elastic_energy_j();
    assert!(energy(0.163 * square) < energy(0.15 * square).min(energy(0.18 * square)));
}

#[test]
fn inner_forces_change_neither_momentum_nor_angular_momentum() {
    let mut rod = crumpled(1e-3);
    let mut force = vec![Vector3::zeros(); rod.x.len()];
    rod.add_forces(&mut force);
    let scale: f64 = force.iter().map(|f| f.norm()).sum();
    let sum: Vector3<f64> = force.iter().sum();
    let torque: Vector3<f64> = rod.x.iter().zip(&force).map(|(x, f)| x.cross(f)).sum();
    let torque = torque + rod.torques().iter().sum::<Vector3<f64>>();
    assert!(sum.norm() < 1e-12 * scale, "{}", sum.norm());
    assert!(torque.norm() < 1e-12 * scale, "{}", torque.norm());
    rod.retardation_s = 1e-2;
    force.fill(Vector3::zeros());
    rod.add_forces(&mut force);
    let sum: Vector3<f64> = force.iter().sum();
    assert!(sum.norm() < 1e-12 * scale, "{}", sum.norm());
}

/// A thrown, vibrating rod keeps its momentum (none from gravity across the fall) and its energy.
#[test]
fn a_thrown_rope_keeps_its_energy() {
    let mut world = World::new(
        &material(9e5, [1.0, 0.0, 0.0]),
        [0.0; 3],
        None,
        &[],
        &WorldEffects::default(),
    );
    for (i, v) in world.rod.v.iter_mut().enumerate() {
        *v = Vector3::new(0.2, 0.3 * (PI * i as f64 / 25.0).sin(), 0.1);
    }
    let energy = |rod: &Rod| {
        let lifted: f64 = rod.mass.iter().zip(&rod.x).map(|(m, x)| m * G * x.z).sum();
        rod.kinetic_energy_j() + lifted + rod.elastic_energy_j()
    };
    let (before, across) = (energy(&world.rod), world.rod.momentum());
    world.advance_to(0.3);
    close(energy(&world.rod), before, 0.01);
    assert!((world.rod.momentum() - across).xy().norm() < 1e-9);
}

fn on_table(friction: f64, effects: &WorldEffects) -> World {
    let table = Table {
        height_m: 0.0,
        friction,
    };
    let start = [0.0, 0.0, 0.5 * DIAMETER];
    World::new(&material(9e5, [1.0, 0.0, 0.0]), start, Some(table), &[], effects)
}

/// A body sliding at speed v on a table stops after v²/(2 μ g).
#[test]
fn a_sliding_rope_stops_where_coulomb_says() {
    for along in [Vector3::x(), Vector3::y()] {
        let mut world = on_table(0.5, &WorldEffects::default());
        world.advance_to(0.05);
        world.rod.v.fill(along * 0.5);
        let from = world.rod.x[12];
        world.advance_to(0.3);
        let way = (world.rod.x[12] - from).dot(&along);
        close(way, 0.25 / (2.0 * 0.5 * G), 0.01);
    }
}

#[test]
fn a_tilted_table_holds_the_rope_below_the_friction_angle_and_lets_it_slide_above() {
    for (tilt, slides) in [(0.4f64, false), (0.55, true)] {
        let effects = WorldEffects {
            tilt_rad: [0.0, tilt],
            ..WorldEffects::default()
        };
        let mut world = on_table(0.5, &effects);
        // The table takes the weight within the first milliseconds.
        world.advance_to(0.05);
        let from = world.rod.x[12].y;
        world.advance_to(0.5);
        let way = world.rod.x[12].y - from;
        if slides {
            let acceleration = G * (tilt.sin() - 0.5 * tilt.cos());
            close(way, 0.5 * acceleration * (0.25 - 0.0025), 0.01);
        } else {
            assert!(way.abs() < 1e-9, "it crept {way} m");
        }
    }
}

#[test]
fn a_resting_rope_sinks_into_the_table_by_no_more_than_a_hundredth_of_a_millimetre() {
    let mut world = on_table(0.5, &WorldEffects::default());
    world.advance_to(0.2);
    for x in &world.rod.x {
        let depth = 0.5 * DIAMETER - x.z;
        assert!((0.0..1.1e-5).contains(&depth), "{depth}");
    }
}
