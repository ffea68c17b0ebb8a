//! Each switchable effect of the twin world does what its equation says, and nothing at zero.

use nalgebra::Vector3;
use offline::demo::{Observations, RopeEnd, RopeSpec};
use std::f64::consts::PI;
use tests::dynamics::{ClampMotion, Material, World};
use tests::effects::{AirJet, GripSlip, StiffPiece, WorldEffects};
use tests::motion::{ClampPath, Leg};
use tests::sample_rope::{leg, lift, limits, material};
use tests::world::{WorldSpec, record_demo, simulate};

const LENGTH: f64 = 0.25;
const DIAMETER: f64 = 0.014;
const MASS: f64 = 0.0385;

fn coarse(young_pa: f64) -> Material {
    Material {
        rope: RopeSpec {
            length_m: LENGTH,
            diameter_m: DIAMETER,
            mass_kg: MASS,
            direction: [1.0, 0.0, 0.0],
            end_mass_kg: 0.0,
            roll_rad: 0.0,
            assumed: Vec::new(),
        },
        young_pa,
        segments: 25,
        retardation_s: 1e-4,
    }
}

fn held(path: ClampPath, opens_at_s: Option<f64>) -> Vec<ClampMotion> {
    vec![ClampMotion {
        end: RopeEnd::Start,
        grip_m: 0.02,
        path,
        opens_at_s,
    }]
}

fn fixed() -> Vec<ClampMotion> {
    held(ClampPath::new([0.0; 3], 0.0, &[]), None)
}

fn world(clamps: &[ClampMotion], effects: &WorldEffects) -> World {
    World::new(&coarse(9e5), [0.0; 3], None, clamps, effects)
}

/// A short lift, quick to simulate.
fn short_lift() -> WorldSpec {
    let mut rope = material();
    rope.segments = 25;
    let mut spec = lift("short", rope, &[leg([0.0, 0.0, 0.1], 0.3)]);
    spec.duration_s = 1.2;
    spec
}

/// Largest distance between two ropes over the frames of a short lift, m.
fn difference(effects: &WorldEffects) -> f64 {
    let (plain, other) = (
        simulate(&short_lift(), &WorldEffects::default()),
        simulate(&short_lift(), effects),
    );
    let pairs = plain.iter().zip(&other);
    let nodes = pairs.flat_map(|(a, b)| a.nodes_m.iter().zip(&b.nodes_m));
    nodes.map(|(a, b)| (a - b).norm()).fold(0.0, f64::max)
}

/// A name and what switches the effect on.
type Switch = (&'static str, fn(&mut WorldEffects));

const SWITCHES: [Switch; 17] = [
    ("tip mass", |e| e.tip_mass_kg = 0.009),
    ("tilt", |e| e.tilt_rad = [0.1, 0.0]),
    ("linear drag", |e| e.drag_linear_per_s = 5.0),
    ("drag and wind", |e| {
        e.drag_normal = 1.1;
        e.wind_m_s = [-6.0, 0.0, 0.0];
    }),
    ("damping", |e| e.damping_s = 0.02),
    ("friction", |e| e.friction_change = -0.4),
    ("density", |e| e.density_slope = 0.8),
    ("lag", |e| e.gripper_lag_s = 0.03),
    ("clock", |e| e.clock_offset_s = 0.03),
    ("rest curvature", |e| e.rest_curvature_per_m = 2.0),
    ("curvature growth", |e| e.curvature_growth_per_m2 = 10.0),
    ("bending", |e| e.bending_change = 0.5),
    ("stiffening", |e| e.stiffening = 50.0),
    ("compliance", |e| e.clamp_compliance = 5.0),
    ("jet", |e| {
        e.air_jet = Some(AirJet {
            centre_m: [0.15, 0.0, 0.05],
            radius_m: 0.05,
            velocity_m_s: [0.0, 3.0, 3.0],
        });
    }),
    ("slip", |e| e.grip_slip = Some(SLIP)),
    ("stiff piece", |e| e.stiff_piece = Some(STIFF)),
];

const SLIP: GripSlip = GripSlip {
    at_s: 0.1,
    for_s: 0.1,
    by_m: 0.01,
};
const STIFF: StiffPiece = StiffPiece {
    from_m: 0.0,
    to_m: 0.25,
    factor: 2.0,
};

#[test]
fn every_effect_moves_the_rope_of_a_lift_by_half_a_millimetre_and_more() {
    assert_eq!(difference(&WorldEffects::default()), 0.0);
    for (name, switch_on) in SWITCHES {
        let mut effects = WorldEffects::default();
        switch_on(&mut effects);
        let moved = difference(&effects);
        assert!(moved > 5e-4 && moved < 0.3, "{name} moves it by {moved} m");
    }
}

/// A falling bar across the stream of air reaches √(2 m g/(ρ C d L)).
#[test]
fn a_falling_rope_reaches_its_terminal_speed() {
    let effects = WorldEffects {
        drag_normal: 1.1,
        ..WorldEffects::default()
    };
    let mut falling = world(&[], &effects);
    falling.advance_to(6.0);
    let exact = (2.0 * MASS * 9.81 / (1.204 * 1.1 * DIAMETER * LENGTH)).sqrt();
    let speed = -falling.rod.momentum().z / MASS;
    assert!((speed / exact - 1.0).abs() < 0.01, "{speed} against {exact}");
}

#[test]
fn gravity_leans_the_way_the_tilt_says() {
    let effects = WorldEffects {
        tilt_rad: [0.1, 0.0],
        ..WorldEffects::default()
    };
    assert!(
        (effects.gravity() - Vector3::new(-9.81 * 0.1f64.sin(), 0.0, -9.81 * 0.1f64.cos())).norm() < 1e-12
    );
    let effects = WorldEffects {
        tilt_rad: [0.0, 0.1],
        ..WorldEffects::default()
    };
    assert!(
        (effects.gravity() - Vector3::new(0.0, 9.81 * 0.1f64.sin(), -9.81 * 0.1f64.cos())).norm() < 1e-12
    );
}

/// A first-order lag trails a steady motion by speed times lag; the recording holds the command.
#[test]
fn a_lagging_gripper_trails_its_command() {
    let lag = 0.02;
    let effects = WorldEffects {
        gripper_lag_s: lag,
        ..WorldEffects::default()
    };
    let path = ClampPath::new(
        [0.0; 3],
        0.0,
        &[Leg {
            to_m: [0.0, 0.0, 0.5],
            limits: limits(0.25),
            pause_s: 0.0,
        }],
    );
    let middle = 0.5 * path.duration_s();
    let mut moving = world(&held(path.clone(), None), &effects);
    moving.advance_to(middle);
    let behind = path.position_m(middle).z - moving.rod.x[0].z;
    assert!((behind / (lag * 0.25) - 1.0).abs() < 0.01, "{behind}");
    let spec = short_lift();
    assert_eq!(
        record_demo(&spec, &effects, 1).clamps,
        record_demo(&spec, &WorldEffects::default(), 1).clamps
    );
}

#[test]
fn an_opened_clamp_lets_the_rope_fall() {
    let mut dropped = world(
        &held(ClampPath::new([0.0; 3], 0.0, &[]), Some(0.1)),
        &WorldEffects::default(),
    );
    dropped.advance_to(0.0999);
    assert_eq!(dropped.rod.x[0], Vector3::zeros());
    dropped.advance_to(0.1);
    let from: Vector3<f64> = centre(&dropped);
    let speed = dropped.rod.momentum().z / MASS;
    dropped.advance_to(0.3);
    let time = 0.3 - 0.1;
    let fall = speed * time - 0.5 * 9.81 * time * time;
    assert!((centre(&dropped).z - from.z - fall).abs() < 1e-3);
}

fn centre(world: &World) -> Vector3<f64> {
    let pairs = world.rod.mass.iter().zip(&world.rod.x);
    pairs.map(|(m, x)| x * (*m / MASS)).sum()
}

#[test]
fn a_slipping_rope_comes_out_of_the_clamp() {
    let effects = WorldEffects {
        grip_slip: Some(SLIP),
        ..WorldEffects::default()
    };
    let mut slipping = world(&fixed(), &effects);
    slipping.advance_to(0.1);
    assert!(slipping.rod.x[0].x.abs() < 1e-9);
    slipping.advance_to(0.25);
    assert!((slipping.rod.x[0].x - 0.01).abs() < 1e-9);
}

/// Sag of the tip of a level cantilever at rest, m.
fn sag(effects: WorldEffects) -> f64 {
    let settled = WorldEffects {
        drag_linear_per_s: 60.0,
        ..effects
    };
    let mut beam = World::new(&coarse(5e7), [0.0; 3], None, &fixed(), &settled);
    beam.advance_to(0.6);
    -beam.rod.x[25].z
}

/// A stiffer piece at the wall lowers the sag; a mass at the tip raises it by M g L³/(3EI).
#[test]
fn stiffness_and_tip_mass_change_the_sag_the_right_way() {
    let plain = sag(WorldEffects::default());
    let stiff_piece = Some(STIFF);
    let stiff = sag(WorldEffects {
        stiff_piece,
        ..WorldEffects::default()
    });
    assert!(
        (2.0 * stiff / plain - 1.0).abs() < 0.01,
        "{stiff} against {plain}"
    );
    let loaded = sag(WorldEffects {
        tip_mass_kg: 0.002,
        ..WorldEffects::default()
    });
    let exact = 0.002 * 9.81 * 0.23f64.powi(3) / (3.0 * 5e7 * PI * DIAMETER.powi(4) / 64.0);
    assert!(((loaded - plain) / exact - 1.0).abs() < 0.01);
}

#[test]
fn the_same_seed_gives_the_same_demo_and_another_gives_other_noise() {
    let plain = WorldEffects::default();
    let spec = short_lift();
    let first = record_demo(&spec, &plain, 5);
    assert_eq!(first, record_demo(&spec, &plain, 5));
    let other = record_demo(&spec, &plain, 6);
    assert_eq!(first.clamps, other.clamps);
    assert_ne!(first.observations, other.observations);
}

#[test]
fn a_wrong_camera_position_moves_only_its_own_points() {
    let shifted = WorldEffects {
        camera_offset_m: [0.0, 0.0, 0.02],
        ..WorldEffects::default()
    };
    let mut spec = short_lift();
    spec.cameras.truncate(1);
    let height = |effects: &WorldEffects| {
        let demo = record_demo(&spec, effects, 5);
        let Observations::Clouds(frames) = demo.observations else {
            panic!("the twin world records clouds");
        };
        let points = &frames[0].points_m;
        points.iter().map(|p| p[2]).sum::<f64>() / points.len() as f64
    };
    let change = height(&shifted) - height(&WorldEffects::default());
    assert!((change + 0.02).abs() < 2e-3, "{change}");
}

/// A rod without weight takes its natural curvature, upwards, and stores nothing then.
#[test]
fn a_weightless_rod_takes_its_natural_curvature() {
    let curvature: f64 = 4.0;
    let taken = |rest_curvature_per_m: f64, curvature_growth_per_m2: f64| {
        let effects = WorldEffects {
            rest_curvature_per_m,
            curvature_growth_per_m2,
            drag_linear_per_s: 20.0,
            ..WorldEffects::default()
        };
        // It falls, which does not bend it.
        let mut free = world(&[], &effects);
        free.advance_to(2.0);
        let straightened = 0.5 * curvature.powi(2) * 9e5 * PI * DIAMETER.powi(4) / 64.0 * LENGTH;
        assert!(free.rod.elastic_energy_j() < 1e-3 * straightened);
        free.rod.x
    };
    // How far the rod turns between two of its chords.
    let angle = |x: &[Vector3<f64>], from: usize, to: usize| {
        let chord = |i: usize| (x[i + 1] - x[i]).normalize();
        let turn = chord(from).cross(&chord(to));
        assert!(turn.y < 0.0, "upwards");
        turn.norm().atan2(chord(from).dot(&chord(to)))
    };
    // 24 bends of 10 mm, at nodes 1 to 24.
    let circle = angle(&taken(curvature, 0.0), 0, 24);
    assert!((circle / (curvature * 0.24) - 1.0).abs() < 0.02, "{circle}");
    let clothoid = taken(0.0, 2.0 * curvature / LENGTH);
    for (to, bends) in [(12, 78.0), (24, 300.0)] {
        let expected = 2.0 * curvature / LENGTH * 0.01 * 0.01 * bends;
        let turned = angle(&clothoid, 0, to);
        assert!((turned / expected - 1.0).abs() < 0.02, "{turned} at {to}");
    }
}

/// A spring in series at the wall adds C M to the slope: C q L²/2 · L at the tip.
#[test]
fn a_compliant_clamp_and_a_bending_change_alter_the_sag_as_beams_do() {
    let plain = sag(WorldEffects::default());
    let compliance = 0.3;
    let more = sag(WorldEffects {
        clamp_compliance: compliance,
        ..WorldEffects::default()
    }) - plain;
    let exact = compliance * 0.5 * MASS / LENGTH * 9.81 * 0.23f64.powi(3);
    assert!((more / exact - 1.0).abs() < 0.02, "{more} against {exact}");
    let softer = sag(WorldEffects {
        bending_change: -0.5,
        ..WorldEffects::default()
    });
    assert!(
        (softer / plain / 2.0 - 1.0).abs() < 0.02,
        "{softer} against {plain}"
    );
}

/// The force is the slope of the energy, natural curvature and stiffening included, in the plane.
#[test]
fn forces_of_a_curved_stiffening_rod_are_slopes_of_its_energy() {
    let effects = WorldEffects {
        rest_curvature_per_m: 6.0,
        stiffening: 40.0,
        ..WorldEffects::default()
    };
    let mut rod = world(&[], &effects).rod;
    for (i, x) in rod.x.iter_mut().enumerate() {
        *x += Vector3::new(0.001 * (i as f64).sin(), 0.0, 0.002 * (0.5 * i as f64).cos());
    }
    let mut force = vec![Vector3::zeros(); rod.x.len()];
    rod.add_forces(&mut force);
    let scale = force.iter().map(|f| f.norm()).fold(0.0, f64::max);
    for i in [0, 1, 7, 12, 24, 25] {
        for axis in [0, 2] {
            let h = 1e-7;
            let mut energy_at = |shift: f64| {
                rod.x[i][axis] += shift;
                let energy = rod.elastic_energy_j();
                rod.x[i][axis] -= shift;
                energy
            };
            let slope = (energy_at(h) - energy_at(-h)) / (2.0 * h);
            assert!(
                (force[i][axis] + slope).abs() < 1e-5 * scale,
                "node {i}, axis {axis}"
            );
        }
    }
}

#[test]
fn a_late_clamp_opens_later_and_a_turned_rig_turns_what_is_seen() {
    let late = WorldEffects {
        release_delay_s: 0.05,
        ..WorldEffects::default()
    };
    let opening = |at, effects: &WorldEffects| {
        let mut dropped = world(&held(ClampPath::new([0.0; 3], 0.0, &[]), Some(at)), effects);
        dropped.advance_to(0.3);
        dropped.rod.x[0]
    };
    let difference = opening(0.1, &late) - opening(0.15, &WorldEffects::default());
    assert!(difference.norm() < 1e-4, "{difference}");
    let turned = WorldEffects {
        rig_shift_m: [0.0, 0.0, 0.01],
        rig_turn_rad: [0.0, 0.0, 0.1],
        ..WorldEffects::default()
    };
    let [x, y, z] = turned.seen_at([1.5, 1.0, 1.0], [0.5, 1.0, 1.0]);
    let expected = [0.5 + 0.1f64.cos(), 1.0 + 0.1f64.sin(), 1.01];
    assert!((x - expected[0]).abs() < 1e-12 && (y - expected[1]).abs() < 1e-12 && z == expected[2]);
}
