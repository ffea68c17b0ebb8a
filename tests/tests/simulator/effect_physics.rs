//! Each effect against a result that is known exactly.

use nalgebra::{Rotation3, Unit, Vector3};
use offline::demo::RopeEnd;
use offline::effects;
use offline::sim::clamp::{ClampPath, Knot};
use offline::sim::material::Material;
use offline::sim::physics::GRAVITY_M_S2;
use offline::sim::rope::{RopeLayout, RopeShape, Sampling};
use offline::sim::scene::{Grip, Scene};
use offline::sim::{Physics, simulate};
use offline::verify::Stepper;
use tests::scenes::{knot, rope, settled, start_grip, tip};

const LEVEL: [f64; 3] = [1.0, 0.0, 0.0];
const DOWN: [f64; 3] = [0.0, 0.0, -1.0];

/// A physics with effects; Poisson's ratio zero, for which the base's uniaxial stress is exactly E ε.
fn with(young_pa: f64, list: &[(&str, &[f64])]) -> Physics<f64> {
    let mut physics = Physics::base(young_pa, 0.0, 0.5);
    for (id, values) in list {
        effects::add_to(effects::find(id).expect("in the registry"), values, &mut physics);
    }
    physics
}

fn close(value: f64, exact: f64, relative: f64, what: &str) {
    let error = value / exact - 1.0;
    println!("{what}: {value:.6e} against {exact:.6e}, off by {error:.2e}");
    assert!(
        error.abs() < relative,
        "{what}: {value} against {exact}, off by {error:.2e}"
    );
}

fn last_frame(scene: &Scene, physics: &Physics<f64>) -> Vec<[f64; 3]> {
    simulate(scene, physics).unwrap().frames.pop().unwrap()
}

/// Mean curvature vector of a centreline, 1/m: the turn of its chords over the length between them.
fn curvature_per_m(frame: &[[f64; 3]]) -> Vector3<f64> {
    let chord = |i: usize| Vector3::from(frame[i + 1]) - Vector3::from(frame[i]);
    let n = frame.len() - 1;
    let length: f64 = (0..n).map(|i| chord(i).norm()).sum();
    let (first, last) = (chord(0).normalize(), chord(n - 1).normalize());
    let share = (n - 1) as f64 / n as f64;
    first.cross(&last).normalize() * (first.angle(&last) / (length * share))
}

/// A free rope without weight takes its natural curvature, to the side and upwards, and keeps its length.
#[test]
fn a_free_rope_takes_its_rest_curvature() {
    let shape = rope(0.16, 0.014);
    let scene = settled(shape, LEVEL, vec![], 0.5, 40.0);
    for k in [[0.0, 5.0], [3.0, -4.0]] {
        let mut physics = with(0.4e6, &[("rest_curvature", &k)]);
        physics.gravity_m_s2 = [0.0; 3];
        let frame = last_frame(&scene, &physics);
        let got = curvature_per_m(&frame);
        close(got.norm(), 5.0, 0.03, "curvature");
        // The side is y and up is z; bending towards (y, z) turns x about (−z, y).
        let expected = Vector3::new(0.0, -k[1], k[0]).normalize();
        assert!(got.normalize().dot(&expected) > 0.999, "{got}");
    }
}

/// A free rope without weight whose natural curvature grows along it is a clothoid: its direction turns with the square of
/// arc length.
#[test]
fn a_free_rope_with_a_curvature_gradient_is_a_clothoid() {
    let shape = rope(0.16, 0.014);
    let scene = settled(shape, LEVEL, vec![], 0.5, 40.0);
    let growth = [24.0, -32.0];
    let mut physics = with(0.4e6, &[("curvature_gradient", &growth)]);
    physics.gravity_m_s2 = [0.0; 3];
    let frame = last_frame(&scene, &physics);
    let chord = |i: usize| Vector3::from(frame[i + 1]) - Vector3::from(frame[i]);
    let n = frame.len() - 1;
    let middle_m = |i: usize| 0.16 * (i as f64 + 0.5) / n as f64;
    for i in [n / 2, 3 * n / 4, n - 1] {
        let turn = 0.5 * 40.0 * (middle_m(i).powi(2) - middle_m(0).powi(2));
        close(chord(0).angle(&chord(i)), turn, 0.03, "turn");
        let axis = chord(0).cross(&chord(i)).normalize();
        let expected = Vector3::new(0.0, -growth[1], growth[0]).normalize();
        assert!(axis.dot(&expected) > 0.999, "{axis}");
    }
}

/// The centre of mass moves by g L/12 and the mass stays.
#[test]
fn a_density_gradient_moves_the_centre_of_mass() {
    let shape = rope(0.16, 0.014);
    let scene = settled(shape, LEVEL, vec![], 0.1, 0.0);
    let slope = 0.6;
    let physics = with(0.4e6, &[("density_gradient", &[slope])]);
    let run = Stepper::new(&scene, &physics);
    close(run.mass_kg(), shape.mass_kg, 1e-12, "mass");
    let exact = 0.16 * (0.5 + slope / 12.0);
    // The mean over a slice is taken at its middle: off by the square of slices per length.
    close(run.centre_m().x, exact, 1e-3, "centre of mass");
}

/// A level cantilever of the verification suite: stiff, so that it sags little.
struct Cantilever {
    shape: RopeShape,
    grip_m: f64,
}

const BEAM_PA: f64 = 12.0e6;

impl Cantilever {
    fn new() -> Self {
        let (grip_m, free_m) = (0.03, 0.2);
        Self {
            shape: rope(grip_m + free_m, 0.02),
            grip_m,
        }
    }

    /// Sag of the tip, m, and its slope, rad.
    fn rest(&self, list: &[(&str, &[f64])]) -> [f64; 2] {
        let grips = start_grip(self.grip_m, ClampPath::fixed([0.0; 3]));
        let scene = settled(self.shape, LEVEL, grips, 0.4, 96.0);
        let frame = last_frame(&scene, &with(BEAM_PA, list));
        let (a, b) = (frame[frame.len() - 2], frame[frame.len() - 1]);
        [-tip(&scene, &frame)[2], ((a[2] - b[2]) / (b[0] - a[0])).atan()]
    }
}

/// Sag goes with 1/r, stretch under the rope's own weight does not change.
#[test]
fn a_bending_ratio_changes_sag_but_not_stretch() {
    let beam = Cantilever::new();
    let [plain, _] = beam.rest(&[]);
    for ratio in [0.5, 2.0] {
        let [sag, _] = beam.rest(&[("bending_ratio", &[ratio])]);
        close(plain / sag, ratio, 0.05, "stiffness from sag");
    }
    let shape = rope(0.2, 0.014);
    let grips = || start_grip(0.02, ClampPath::fixed([0.0; 3]));
    let scene = settled(shape, DOWN, grips(), 0.4, 80.0);
    let stretch = |list: &[(&str, &[f64])]| -tip(&scene, &last_frame(&scene, &with(0.2e6, list)))[2] - 0.2;
    let exact = 1000.0 * GRAVITY_M_S2 * 0.18f64.powi(2) / (2.0 * 0.2e6);
    close(stretch(&[]), exact, 0.05, "stretch under its own weight");
    close(
        stretch(&[("bending_ratio", &[0.5])]),
        stretch(&[]),
        1e-6,
        "stretch at half the ratio",
    );
}

/// Soft pads let the rope turn by C M at the mouth: there, and not further out, and with the moment of the rope as it hangs.
#[test]
fn a_compliant_clamp_turns_with_the_moment() {
    let beam = Cantilever::new();
    let at_mouth = |list: &[(&str, &[f64])]| {
        let grips = start_grip(beam.grip_m, ClampPath::fixed([0.0; 3]));
        // A beam on soft pads is slow to come to rest.
        let scene = settled(beam.shape, LEVEL, grips, 1.0, 40.0);
        let frame = last_frame(&scene, &with(BEAM_PA, list));
        let slices = scene.layout().slices;
        let first = slices.iter().position(|s| s.arc_m > beam.grip_m).unwrap();
        let (a, b) = (frame[first], frame[first + 1]);
        let per_m = beam.shape.mass_kg / beam.shape.length_m * GRAVITY_M_S2;
        let free = slices.iter().zip(&frame).skip(first);
        let moment_n_m: f64 = free.map(|(s, x)| per_m * s.length_m * (x[0] - beam.grip_m)).sum();
        (((a[2] - b[2]) / (b[0] - a[0])).atan(), moment_n_m)
    };
    let (slope, _) = at_mouth(&[]);
    for compliance in [0.05, 0.2, 0.8] {
        let (more_slope, moment_n_m) = at_mouth(&[("clamp_compliance", &[compliance])]);
        close(
            more_slope - slope,
            compliance * moment_n_m,
            0.03,
            "turn at the mouth",
        );
    }
}

/// A hanging rope leans in the wind as it leans when gravity is tilted by the force over the weight.
#[test]
fn wind_leans_a_hanging_rope_as_far_as_its_force_says() {
    let shape = rope(0.2, 0.014);
    let grips = || start_grip(0.02, ClampPath::fixed([0.0; 3]));
    let scene = settled(shape, DOWN, grips(), 0.8, 16.0);
    let q = 4.0;
    let force_n_m = 0.5 * 1.204 * 1.1 * shape.diameter_m * q;
    let angle = (force_n_m / (shape.mass_kg / shape.length_m * GRAVITY_M_S2)).atan();
    for (wind, tilt) in [([q, 0.0], [angle, 0.0]), ([0.0, -q], [0.0, -angle])] {
        let leant = tip(
            &scene,
            &last_frame(&scene, &with(0.2e6, &[("steady_wind", &wind)])),
        );
        let tilted = tip(
            &scene,
            &last_frame(&scene, &with(0.2e6, &[("tilted_gravity", &tilt)])),
        );
        let axis = if wind[0] != 0.0 { 0 } else { 1 };
        // The force is across the rope, so a lean of some degrees changes it by its square.
        close(leant[axis], tilted[axis], 0.01, "lean");
        assert!(leant[axis].abs() > 1e-3);
    }
}

/// Stress and stretch of a hanging rope with a heavy end: EA (ε + c ε³) carries what hangs below.
#[test]
fn a_stiffening_rope_stretches_as_its_curve_says() {
    let (shape, young_pa, load_kg) = (rope(0.2, 0.014), 0.2e6, 0.3);
    let area = std::f64::consts::FRAC_PI_4 * shape.diameter_m.powi(2);
    let grips = || start_grip(0.02, ClampPath::fixed([0.0; 3]));
    let scene = settled(shape, DOWN, grips(), 1.0, 30.0);
    for c in [0.0, 30.0] {
        let list: [(&str, &[f64]); 2] = [("tip_mass", &[load_kg]), ("strain_stiffening", &[c])];
        let frame = last_frame(&scene, &with(young_pa, &list));
        let slices = scene.layout().slices;
        // The middle half: away from the grip and from the end that carries the mass.
        let (a, b) = (slices.len() / 4, 3 * slices.len() / 4);
        let apart = slices[b].arc_m - slices[a].arc_m;
        let strain = (frame[a][2] - frame[b][2]) / apart - 1.0;
        let below_m = shape.length_m - 0.5 * (slices[a].arc_m + slices[b].arc_m);
        let load_n = GRAVITY_M_S2 * (load_kg + below_m * shape.mass_kg / shape.length_m);
        close(
            young_pa * area * (strain + c * strain.powi(3)),
            load_n,
            0.02,
            "load from strain",
        );
        println!("strain {strain:.4}");
    }
}

/// A stretch beyond the yield strain leaves exactly the excess behind.
#[test]
fn yield_keeps_what_exceeds_the_yield_strain() {
    let (total, limit) = (0.12f64, 0.05f64);
    let physics = with(1e6, &[("yield", &[1.0 / limit])]);
    let across = (-0.5 * total).exp();
    let f = [[total.exp(), 0.0, 0.0], [0.0, across, 0.0], [0.0, 0.0, across]];
    let factor = physics.flow_laws[0].relaxation(&f).expect("beyond yield");
    close((f[0][0] * factor[0][0]).ln(), limit, 1e-9, "elastic strain");
    close(factor[0][0] * factor[1][1] * factor[2][2], 1.0, 1e-12, "volume");
    let inside = [[1.04, 0.0, 0.0], [0.0, 0.98, 0.0], [0.0, 0.0, 0.98]];
    assert!(physics.flow_laws[0].relaxation(&inside).is_none());
}

/// A rope that two grips stretch beyond yield and one lets go keeps the stretch less its elastic part.
#[test]
fn a_stretched_rope_keeps_what_exceeds_its_yield_strain() {
    let (shape, grip_m, stretch, limit) = (rope(0.16, 0.014), 0.02, 0.019f64, 0.005);
    let free_m = shape.length_m - 2.0 * grip_m;
    let end = |t_s: f64, by: f64, closed| knot(t_s, [shape.length_m + by * free_m, 0.0, 0.0], closed);
    let pulled = ClampPath::new(vec![
        end(0.0, 0.0, true),
        end(0.2, stretch, true),
        end(0.3, stretch, false),
    ]);
    let mut grips = start_grip(grip_m, ClampPath::fixed([0.0; 3]));
    grips.push(Grip {
        end: RopeEnd::End,
        length_m: grip_m,
        path: pulled,
    });
    let scene = settled(shape, LEVEL, grips, 0.8, 40.0);
    let longer = |list: &[(&str, &[f64])]| {
        let mut physics = with(0.4e6, list);
        physics.gravity_m_s2 = [0.0; 3];
        (tip(&scene, &last_frame(&scene, &physics))[0] - shape.length_m) / free_m
    };
    let elastic = longer(&[]);
    println!("an elastic rope keeps {elastic:.1e}");
    assert!(elastic.abs() < 1e-4);
    // For ν = 0 the equivalent of a uniaxial strain is two thirds of it.
    let kept = (stretch.ln_1p() - 1.5 * limit).exp() - 1.0;
    close(
        longer(&[("yield", &[1.0 / limit])]),
        kept,
        0.1,
        "stretch that stays",
    );
}

/// A piece of rope that is stretched at a steady rate and then held pulls by its share of the modulus more, and lets that go:
/// g τ r (1 − e^(−T/τ)) e^(−t/τ) of E, for each relaxation time by itself.
#[test]
fn a_stretch_that_is_held_relaxes_as_a_maxwell_branch_says() {
    let (young_pa, rate_per_s, stretched_s) = (1.0e6, 1e-3, 0.05);
    let layout = RopeLayout::new(rope(0.04, 0.014), &[], 0.009, Sampling::default());
    let dt_s = 1e-4;
    for (shares, time_s) in [([0.5, 0.0], 0.1), ([0.0, 0.5], 1.0)] {
        let physics = with(young_pa, &[("relaxation", &shares)]);
        let mut material = Material::new(&physics, &layout);
        let gradient = |strain: f64| [[1.0 + strain, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let strain_at = |t_s: f64| rate_per_s * t_s.min(stretched_s);
        for step in 0..2500 {
            let t_s = f64::from(step) * dt_s;
            let rate = if t_s < stretched_s { rate_per_s } else { 0.0 };
            let rate = [[rate, 0.0, 0.0], [0.0; 3], [0.0; 3]];
            let here = gradient(strain_at(t_s));
            material.advance(&physics, dt_s, |_| (&here, &rate));
            let now_s = t_s + dt_s;
            let seen_s = [0.05, 0.1, 0.25];
            if !seen_s.iter().any(|at| f64::abs(now_s - at) < 0.5 * dt_s) {
                continue;
            }
            let pull_pa = material
                .piola(0, &gradient(strain_at(now_s)), &physics, &physics.lame())
                .0[0][0];
            let loaded = 1.0 - f64::exp(-stretched_s / time_s);
            let left = f64::exp(-(now_s - stretched_s) / time_s);
            close(
                pull_pa - young_pa * strain_at(now_s),
                0.5 * young_pa * time_s * rate_per_s * loaded * left,
                0.01,
                "pull beyond the elastic one",
            );
        }
    }
}

/// What the cameras show at t happened at t − τ.
#[test]
fn a_clock_offset_shifts_time() {
    let path = ClampPath::new(vec![
        knot(0.0, [0.0; 3], true),
        knot(0.2, [0.0, 0.02, 0.03], true),
    ]);
    let seen = |times_s: Vec<f64>, offset_s: f64| {
        let grips = start_grip(0.02, path.clone());
        let scene = Scene::new(rope(0.12, 0.014), [0.0; 3], LEVEL, grips, None, 1.5, times_s).unwrap();
        simulate(&scene, &with(0.4e6, &[("clock_offset", &[offset_s])]))
            .unwrap()
            .frames
    };
    let plain = seen(vec![0.05, 0.1, 0.15], 0.0);
    for (shown, offset) in [(vec![0.08, 0.13, 0.18], 0.03), (vec![0.02, 0.07, 0.12], -0.03)] {
        for (a, b) in plain.iter().flatten().zip(seen(shown, offset).iter().flatten()) {
            assert!((0..3).all(|k| (a[k] - b[k]).abs() < 1e-9), "{a:?} {b:?}");
        }
    }
    let early = seen(vec![0.0, 0.01], 0.03);
    assert_eq!(early[0], early[1], "before the start the rope lies still");
}

/// A grip that opens late opens as one that was told to open then.
#[test]
fn a_release_delay_opens_the_grip_later() {
    let seen = |opens_s: f64, delay_s: f64| {
        let path = ClampPath::new(vec![knot(0.0, [0.0; 3], true), knot(opens_s, [0.0; 3], false)]);
        let grips = start_grip(0.02, path);
        let scene = Scene::new(rope(0.12, 0.014), [0.0; 3], LEVEL, grips, None, 1.5, vec![0.3]).unwrap();
        last_frame(&scene, &with(0.4e6, &[("release_delay", &[delay_s])]))
    };
    assert_eq!(seen(0.1, 0.05), seen(0.15, 0.0));
    assert!(seen(0.1, 0.0)[0][2] < seen(0.15, 0.0)[0][2] - 0.01);
}

/// All points move as one rigid body about where the rope's start was.
#[test]
fn a_camera_offset_is_a_rigid_motion_of_what_is_seen() {
    let grips = || start_grip(0.02, ClampPath::fixed([0.3, -0.1, 0.2]));
    let mut scene = settled(rope(0.12, 0.014), LEVEL, grips(), 0.1, 0.0);
    scene.start_m = [0.3, -0.1, 0.2];
    let (shift, axis, angle) = (
        Vector3::new(0.01, -0.02, 0.03),
        Vector3::new(2.0, -1.0, 2.0) / 3.0,
        0.15f64,
    );
    let turn = axis * (2.0 * (0.5 * angle).tan());
    let values = [shift.x, shift.y, shift.z, turn.x, turn.y, turn.z];
    let there = last_frame(&scene, &with(0.4e6, &[("camera_offset", &values)]));
    let here = last_frame(&scene, &with(0.4e6, &[]));
    let rotation = Rotation3::from_axis_angle(&Unit::new_normalize(axis), angle);
    let pivot = Vector3::from(scene.start_m);
    for (a, b) in here.iter().zip(&there) {
        let expected = pivot + rotation * (Vector3::from(*a) - pivot) + shift;
        assert!((Vector3::from(*b) - expected).norm() < 1e-12);
    }
}

/// A knot with the speed of a steady motion.
fn moving(t_s: f64, x_m: f64, speed_m_s: f64) -> Knot {
    Knot {
        rate: [speed_m_s, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        ..knot(t_s, [x_m, 0.0, 0.0], true)
    }
}

/// A first-order lag trails a steady motion by speed times lag, once it has lasted some lags.
#[test]
fn a_lagging_gripper_trails_a_steady_motion() {
    let (speed, lag) = (0.2, 0.02);
    let path = ClampPath::new(vec![moving(0.0, 0.0, speed), moving(1.0, speed, speed)]);
    let grips = start_grip(0.02, path);
    let times = vec![0.35];
    let scene = Scene::new(rope(0.12, 0.014), [0.0; 3], LEVEL, grips, None, 1.5, times).unwrap();
    let at = |values: &[f64]| last_frame(&scene, &with(0.4e6, &[("gripper_lag", values)]))[0][0];
    close(at(&[0.0]) - at(&[lag]), speed * lag, 0.01, "way behind");
}
