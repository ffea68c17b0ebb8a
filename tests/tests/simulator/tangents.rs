//! Forward mode against central differences: every input, each scene, several lengths up to the whole
//! rollout, through contact and release; and what it returns where there is no derivative.

use offline::sim::adjoint::Family;
use offline::sim::clamp::PathShift;
use offline::sim::physics::{ForceField, GRAVITY_M_S2};
use offline::sim::scene::{Scene, Table};
use offline::sim::{Rollout, simulate};
use tests::derivatives::{Everything, RELEASE_M, SOFT, Slope, Tangents, free, lift, slope, soft_rope, swing};

/// Largest error, as a share of the difference over the frames up to any length.
const TOLERANCE: f64 = 1e-3;
/// What rounding leaves of a coordinate at the end of a rollout, m: a difference quotient cannot be
/// better than this over its step.
const ROUNDING_M: f64 = 1e-14;

fn at(scene: &Scene, family: &Everything, theta: &[f64]) -> Rollout<f64> {
    simulate(scene, &family.physics(theta)).unwrap()
}

/// Steps of the differences are `step` times the smallest change of interest: their error goes with the
/// square of the step, and a contact that closes within it makes of the difference no derivative.
fn compare(name: &str, scene: &Scene, family: &Everything, step: f64) {
    let theta = family.theta(SOFT, 0.2);
    let tangents = Tangents::<f64>::new(scene, family, &theta).unwrap();
    let mut wrong = Vec::new();
    for (entry, (label, size)) in family.names().iter().zip(family.sizes()).enumerate() {
        if scene.table.is_none() && label.contains("friction") {
            continue;
        }
        let h = step * size;
        let sides = [-h, h].map(|by| {
            let mut moved = theta.clone();
            moved[entry] += by;
            at(scene, family, &moved)
        });
        let errors: Vec<Slope> = (1..=scene.frame_times_s.len())
            .map(|frames| slope(tangents.of_entry(entry), 0..frames, &sides, h))
            .collect();
        let list: Vec<String> = errors.iter().map(|s| format!("{:.1e}", s.error)).collect();
        println!("{name}: {label}: {}", list.join(", "));
        let last = errors[errors.len() - 1];
        let coordinates = 3 * scene.layout().slices.len();
        let off = |(k, s): (usize, &Slope)| {
            let rounding = ROUNDING_M / h * (((k + 1) * coordinates) as f64).sqrt();
            s.error * s.size > TOLERANCE * s.size + rounding
        };
        if last.size == 0.0 || errors.iter().enumerate().any(off) {
            wrong.push(label.clone());
        }
    }
    assert!(wrong.is_empty(), "{name}: {wrong:?}");
}

/// Effects and directions of the paths.
fn everything(scene: &Scene) -> Everything {
    Everything::smooth(scene, 30)
}

#[test]
fn tangents_of_a_lift_are_slopes() {
    compare("lift", &lift(), &everything(&lift()), 1e-6);
}

#[test]
fn tangents_of_a_carried_and_dropped_rope_are_slopes() {
    compare("free", &free(), &everything(&free()), 1e-6);
}

#[test]
fn tangents_of_a_swing_are_slopes_also_for_the_release_point() {
    let scene = swing(RELEASE_M);
    let path = &scene.grips[1].path;
    let mut family = everything(&scene);
    let axes = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
    family
        .shifts
        .extend(axes.map(|axis| PathShift::of_end(1, path, axis)));
    compare("swing", &scene, &family, 1e-4);
}

/// The tangent holds the timing of the drag, which in truth takes longer to a point further away; the
/// rope comes to rest before it is let go, so the reach hardly knows. Within a tenth of a millimetre: further away the
/// steps of the true task fall otherwise.
#[test]
fn the_tangent_of_the_release_point_is_the_slope_of_the_true_task() {
    let scene = swing(RELEASE_M);
    let axes = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
    let family = Everything {
        shifts: axes
            .map(|axis| PathShift::of_end(1, &scene.grips[1].path, axis))
            .into(),
        ..Everything::default()
    };
    let theta = family.theta(SOFT, 0.0);
    let tangents = Tangents::<f64>::new(&scene, &family, &theta).unwrap();
    let h = 5e-5;
    for k in 0..2 {
        let reach = |by: f64| {
            let mut release_m = RELEASE_M;
            release_m[k] += by;
            at(&swing(release_m), &family, &theta).reach_m.unwrap()
        };
        let slope = (reach(h) - reach(-h)) / (2.0 * h);
        let (rollout, lane) = tangents.of_entry(3 + k);
        let tangent = rollout.reach_m.unwrap().tangent[lane];
        println!("reach by release point, axis {k}: tangent {tangent:.4}, slope {slope:.4}");
        assert!((tangent - slope).abs() < 0.01 * slope.abs());
    }
}

/// Tangents in single precision against the same in double. The carried rope counts until it touches
/// down, right after the release: from then on the two precisions meet contacts in different steps, and
/// derivatives go apart by a tenth and more.
#[test]
fn single_precision_keeps_the_tangents() {
    for (name, mut scene, frames) in [
        ("lift", lift(), 4),
        ("free", free(), 2),
        ("swing", swing(RELEASE_M), 5),
    ] {
        scene.frame_times_s.truncate(frames);
        let family = Everything::default();
        let theta = family.theta(SOFT, 0.0);
        let single = Tangents::<f32>::new(&scene, &family, &theta).unwrap();
        let double = Tangents::<f64>::new(&scene, &family, &theta).unwrap();
        for entry in 0..2 {
            let ((a, lane), (b, _)) = (single.of_entry(entry), double.of_entry(entry));
            let (mut wrong, mut size) = (0.0, 0.0);
            let pairs = a
                .frames
                .iter()
                .flatten()
                .flatten()
                .zip(b.frames.iter().flatten().flatten());
            for (x, y) in pairs {
                wrong += (f64::from(x.tangent[lane]) - y.tangent[lane]).powi(2);
                size += y.tangent[lane].powi(2);
            }
            let error = f64::sqrt(wrong / size);
            println!(
                "{name}: {}: single precision is off by {error:.1e}",
                family.names()[entry]
            );
            assert!(error < 1e-2, "{name}, entry {entry}: {error:.1e}");
        }
    }
}

/// A rope at rest on a table, pushed along the table by `share` of what friction can hold, from 20 ms
/// on; θ's fourth entry is the force.
fn pushed() -> (Scene, Everything, f64) {
    let shape = soft_rope(0.1);
    let table = Some(Table { height_m: -0.007 });
    let times = vec![0.1];
    let scene = Scene::new(shape, [0.0; 3], [0.0, 1.0, 0.0], vec![], table, 1.5, times).unwrap();
    let slices = scene.layout().slices.len();
    let field = ForceField {
        block_s: 0.02,
        force_n_m: (0..5)
            .map(|block| vec![[if block > 0 { 1.0 } else { 0.0 }, 0.0, 0.0]; slices])
            .collect(),
    };
    let family = Everything {
        fields: vec![field],
        ..Everything::default()
    };
    let holds_n_m = SOFT[2] * shape.mass_kg / shape.length_m * GRAVITY_M_S2;
    (scene, family, holds_n_m)
}

/// Mean way along x, m, and its tangents with respect to friction and force.
fn way(share: f64) -> (f64, [f64; 2]) {
    let (scene, family, holds_n_m) = pushed();
    let mut theta = family.theta(SOFT, 0.0);
    theta[3] = share * holds_n_m;
    let tangents = Tangents::<f64>::new(&scene, &family, &theta).unwrap();
    let mean = |entry: usize| {
        let (rollout, lane) = tangents.of_entry(entry);
        let points = &rollout.frames[0];
        let sum = points.iter().map(|p| p[0].tangent[lane]).sum::<f64>();
        (
            points.iter().map(|p| p[0].value).sum::<f64>() / points.len() as f64,
            sum / points.len() as f64,
        )
    };
    (mean(2).0, [mean(2).1, mean(3).1])
}

/// From sticking to sliding there is no derivative: the way is zero up to the force that friction holds
/// and grows from there. On either side the code returns the derivative of that side: nothing while the
/// rope sticks, the sliding slope as soon as it slides, never a mean of both.
#[test]
fn where_a_rope_begins_to_slide_each_side_has_its_own_derivative() {
    let (scene, _, holds_n_m) = pushed();
    let (stuck, of_stuck) = way(0.98);
    let (slid, of_slid) = way(1.02);
    println!("stuck: {stuck:.2e} m, {of_stuck:?}; slid: {slid:.2e} m, {of_slid:?}");
    assert!(stuck.abs() < 1e-9);
    assert_eq!(of_stuck, [0.0; 2], "a rope that sticks does not know by how much");
    // x = (f/m − μ g) t²/2 per length, t = 80 ms.
    let per_length = scene.rope.mass_kg / scene.rope.length_m;
    let half_square = 0.5 * 0.08f64.powi(2);
    let exact = [-GRAVITY_M_S2 * half_square, half_square / per_length];
    for k in 0..2 {
        assert!(
            (of_slid[k] / exact[k] - 1.0).abs() < 0.05,
            "{of_slid:?} against {exact:?}"
        );
    }
    let across = (slid - stuck) / (0.04 * holds_n_m);
    assert!(
        across < 0.6 * exact[1],
        "a difference across the corner is neither: {across}"
    );
}
