//! The simulator against what is known exactly: free fall, momentum, beams, friction, drag,
//! invariance, its tangents against central differences, and its refusals.

use nalgebra::{Matrix3, Rotation3, Vector3};
use offline::demo::RopeEnd;
use offline::effects;
use offline::sim::clamp::{ClampPath, Knot};
use offline::sim::lanes::Laned;
use offline::sim::rope::RopeShape;
use offline::sim::scene::{Grip, Scene, Settling, Table};
use offline::sim::tensor::value3;
use offline::sim::{Cause, Dual, Physics, Real, Rollout, simulate};
use tests::derivatives::{Slope, slope};
use tests::stepper::{Stepper, matrix, rows};

const G: f64 = 9.81;
/// At this stiffness the rope of these tests moves in steps that the speed bound sets, not the wave
/// speed: the step does not depend on E and ν, as the tangents assume.
const SOFT_PA: f64 = 0.4e6;

/// The paper's rope at 1000 kg/m³, or a piece of it.
fn rope(length_m: f64, diameter_m: f64) -> RopeShape {
    let mut shape = RopeShape {
        length_m,
        diameter_m,
        mass_kg: 1.0,
    };
    shape.mass_kg = 1000.0 * shape.volume_m3();
    shape
}

fn knot(t_s: f64, position_m: [f64; 3], velocity_m_s: [f64; 3], closed: bool) -> Knot {
    let ([x, y, z], [u, v, w]) = (position_m, velocity_m_s);
    Knot {
        t_s,
        pose: [x, y, z, 0.0, 0.0, 0.0, 1.0],
        rate: [u, v, w, 0.0, 0.0, 0.0, 0.0],
        closed,
    }
}

fn start_grip(length_m: f64, path: ClampPath) -> Vec<Grip> {
    vec![Grip {
        end: RopeEnd::Start,
        length_m,
        path,
    }]
}

/// A scene whose rope starts at the origin.
fn scene(
    shape: RopeShape,
    direction: [f64; 3],
    grips: Vec<Grip>,
    table: Option<f64>,
    times_s: Vec<f64>,
) -> Scene {
    let table = table.map(|height_m| Table { height_m });
    Scene::new(shape, [0.0; 3], direction, grips, table, 1.5, times_s).unwrap()
}

/// A short rope without grips.
fn free_scene(direction: [f64; 3], table: Option<f64>) -> Scene {
    scene(rope(0.12, 0.014), direction, vec![], table, vec![0.3])
}

/// The end point of the axis, half a slice beyond the last.
fn tip<T: Real>(frame: &[[T; 3]]) -> [f64; 3] {
    let n = frame.len();
    let (a, b) = (value3(frame[n - 1]), value3(frame[n - 2]));
    std::array::from_fn(|k| a[k] + 0.5 * (a[k] - b[k]))
}

fn with_effect(id: &str, values: &[f64], mut physics: Physics<f64>) -> Physics<f64> {
    effects::add_to(effects::find(id).unwrap(), values, &mut physics);
    physics
}

fn soft() -> Physics<f64> {
    Physics::base(SOFT_PA, 0.3, 0.5)
}

fn close(value: f64, exact: f64, relative: f64, what: &str) {
    let error = value / exact - 1.0;
    println!("{what}: {value:.6e} against {exact:.6e}, off by {error:.2e}");
    assert!(
        error.abs() < relative,
        "{what}: {value} against {exact}, off by {error:.2e}"
    );
}

/// Symplectic Euler from rest: after n steps a point has fallen by g dt² n (n + 1)/2.
#[test]
fn a_free_rope_falls_by_the_sum_of_its_steps() {
    let scene = free_scene([0.6, 0.0, 0.8], None);
    let start = simulate(
        &Scene {
            frame_times_s: vec![0.0],
            ..scene.clone()
        },
        &soft(),
    )
    .unwrap();
    let rollout = simulate(&scene, &soft()).unwrap();
    let (n, dt) = (rollout.steps as f64, rollout.dt_s);
    // The frame is read at 0.3 s, within the last step, along the velocity at its end.
    let fall = G * dt * dt * n * (n + 1.0) / 2.0 - G * n * dt * (n * dt - 0.3);
    for (a, b) in start.frames[0].iter().zip(&rollout.frames[0]) {
        assert!((b[0] - a[0]).abs() < 1e-12);
        assert!((b[1] - a[1]).abs() < 1e-12);
        assert!((a[2] - b[2] - fall).abs() < 1e-12);
    }
}

/// A thrown rope that turns and stretches: its centre flies the parabola of a point.
#[test]
fn the_centre_of_a_thrown_rope_flies_a_parabola() {
    let (scene, physics) = (free_scene([1.0, 0.0, 0.0], None), soft());
    let mut run = Stepper::new(&scene, &physics);
    let velocity = Vector3::new(0.7, -0.2, 1.5);
    let gradient = Matrix3::new(2.0, 5.0, -9.0, -5.0, 0.0, 1.0, 12.0, 0.0, 0.0);
    run.set_motion(velocity, gradient);
    let start = run.centre_m();
    let n = 1000;
    run.advance(n).unwrap();
    let t = n as f64 * run.dt_s;
    let fall = Vector3::new(0.0, 0.0, -G);
    let expected = start + velocity * t + fall * (0.5 * t * (t + run.dt_s));
    assert!((run.centre_m() - expected).norm() < 1e-12);
    assert!((run.velocity_m_s() - velocity - fall * t).norm() < 1e-12);
}

/// A rope bent by its weight is let go: whatever it does then, its momentum is that of free fall.
#[test]
fn a_bent_rope_that_is_let_go_falls_as_a_whole() {
    let path = ClampPath::new(vec![
        knot(0.0, [0.0; 3], [0.0; 3], true),
        knot(1.0, [0.0; 3], [0.0; 3], false),
    ]);
    let times = vec![1.0, 1.05, 1.1, 1.15, 1.2];
    let mut scene = scene(
        rope(0.12, 0.014),
        [1.0, 0.0, 0.0],
        start_grip(0.02, path),
        None,
        times.clone(),
    );
    scene.settling = Some(Settling {
        until_s: 1.0,
        rate_per_s: 60.0,
    });
    let rollout = simulate(&scene, &soft()).unwrap();
    let slices = scene.layout().slices;
    let centre = |frame: &Vec<[f64; 3]>, k: usize| -> f64 {
        frame
            .iter()
            .zip(&slices)
            .map(|(p, s)| p[k] * s.length_m / 0.12)
            .sum()
    };
    assert!(tip(&rollout.frames[0])[2] < -0.01, "the rope was to be bent");
    for (frame, t) in rollout.frames.iter().zip(&times).skip(1) {
        let fall = centre(&rollout.frames[0], 2) - centre(frame, 2);
        // Release falls on the first step after 1 s, which is half of g t dt at most.
        let late = G * (t - 1.0) * 2.0 * rollout.dt_s;
        assert!((fall - 0.5 * G * (t - 1.0).powi(2)).abs() < late, "{t}: {fall}");
        assert!((centre(frame, 0) - centre(&rollout.frames[0], 0)).abs() < 1e-6);
    }
}

/// The transfer keeps angular momentum up to the strain within a cell.
#[test]
fn a_turning_rope_keeps_its_angular_momentum() {
    let scene = free_scene([1.0, 0.0, 0.0], None);
    let mut physics = soft();
    physics.gravity_m_s2 = [0.0; 3];
    let mut run = Stepper::new(&scene, &physics);
    let turn = Vector3::new(1.0, 8.0, 6.0);
    run.set_motion(Vector3::zeros(), turn.cross_matrix());
    let (momentum, energy) = (run.angular_momentum(), run.energy_j());
    run.advance((std::f64::consts::TAU / turn.norm() / run.dt_s) as usize)
        .unwrap();
    let change = (run.angular_momentum() - momentum).norm() / momentum.norm();
    println!(
        "one turn: angular momentum {change:.2e}, energy {:.2e}",
        run.energy_j() / energy - 1.0
    );
    assert!(change < 0.01);
    assert!(run.velocity_m_s().norm() < 1e-12);
}

/// Sag of the tip of a horizontal rope clamped at one end, divided by Euler-Bernoulli's
/// q L⁴ / (8 E I), for a grid moved relative to the rope by a share of a cell.
fn cantilever_ratio(shift_cells: [f64; 3]) -> f64 {
    let (grip_m, free_m, diameter_m, young_pa) = (0.03, 0.2, 0.02, 12.0e6);
    let shape = rope(grip_m + free_m, diameter_m);
    let grips = start_grip(grip_m, ClampPath::fixed([0.0; 3]));
    let mut scene = Scene::new(shape, [0.0; 3], [1.0, 0.0, 0.0], grips, None, 1.8, vec![0.4]).unwrap();
    scene.grid.shift_cells = shift_cells;
    // Critical for the slowest mode, 48 rad/s.
    scene.settling = Some(Settling {
        until_s: 0.4,
        rate_per_s: 96.0,
    });
    let rollout = simulate(&scene, &Physics::base(young_pa, 0.3, 0.5)).unwrap();
    let second_moment = std::f64::consts::PI * diameter_m.powi(4) / 64.0;
    let load = shape.mass_kg / shape.length_m * G;
    -tip(&rollout.frames[0])[2] / (load * free_m.powi(4) / (8.0 * young_pa * second_moment))
}

#[test]
fn a_cantilever_sags_as_a_beam_wherever_the_grid_lies() {
    for axis in [0, 2] {
        let ratios = [0.0, 0.25, 0.5, 0.75].map(|share| {
            let mut shift = [0.0; 3];
            shift[axis] = share;
            cantilever_ratio(shift)
        });
        println!("cantilever, grid moved along axis {axis}: {ratios:.4?}");
        let low = ratios.iter().copied().fold(f64::INFINITY, f64::min);
        let high = ratios.iter().copied().fold(0.0, f64::max);
        assert!(
            low > 0.95 && high < 1.05 && high / low < 1.05,
            "axis {axis}: {ratios:?}"
        );
    }
}

/// Tip of a heavy elastica clamped level at the origin: E I θ'' = q (L − s) cos θ, θ(0) = 0,
/// θ'(L) = 0, by shooting from the free end with the classical Runge-Kutta rule and bisection.
fn elastica_tip_m(length_m: f64, load_over_stiffness: f64) -> [f64; 2] {
    const STEPS: usize = 2000;
    let h = length_m / STEPS as f64;
    // State at the distance u from the free end: θ, dθ/du, and x, z walked from the tip.
    let slope = |u: f64, y: [f64; 4]| {
        let (sin, cos) = y[0].sin_cos();
        [y[1], load_over_stiffness * u * cos, cos, sin]
    };
    let shoot = |tip_angle: f64| {
        let mut y = [tip_angle, 0.0, 0.0, 0.0];
        for i in 0..STEPS {
            let u = i as f64 * h;
            let moved = |k: &[f64; 4], share: f64| std::array::from_fn(|j| y[j] + share * h * k[j]);
            let k1 = slope(u, y);
            let k2 = slope(u + 0.5 * h, moved(&k1, 0.5));
            let k3 = slope(u + 0.5 * h, moved(&k2, 0.5));
            let k4 = slope(u + h, moved(&k3, 1.0));
            y = std::array::from_fn(|j| y[j] + h / 6.0 * (k1[j] + 2.0 * (k2[j] + k3[j]) + k4[j]));
        }
        y
    };
    let (mut low, mut high) = (-std::f64::consts::FRAC_PI_2, 0.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if shoot(middle)[0] < 0.0 {
            low = middle;
        } else {
            high = middle;
        }
    }
    let y = shoot(0.5 * (low + high));
    [y[2], y[3]]
}

/// Where the tip comes to rest below a level clamp that rose by `lift_m` first.
fn hanging_tip_m(lift_m: f64) -> [f64; 2] {
    let shape = rope(0.25, 0.014);
    let path = ClampPath::new(vec![
        knot(0.0, [0.0; 3], [0.0; 3], true),
        knot(0.8, [0.0, 0.0, lift_m], [0.0; 3], true),
    ]);
    let grips = start_grip(0.02, path);
    let mut scene = Scene::new(shape, [0.0; 3], [1.0, 0.0, 0.0], grips, None, 1.8, vec![2.6]).unwrap();
    // Critical for the slowest mode, some 8 rad/s.
    scene.settling = Some(Settling {
        until_s: 2.6,
        rate_per_s: 18.0,
    });
    let rollout = simulate(&scene, &Physics::base(0.9e6, 0.3, 0.5)).unwrap();
    let [x, _, z] = tip(&rollout.frames[0]);
    [x, z - lift_m]
}

/// The updated-Lagrangian form failed the second part by 27 mm (`offline::sim::grid`).
#[test]
fn a_hanging_rope_is_an_elastica_also_after_a_lift() {
    let stiffness = 0.9e6 * std::f64::consts::PI * 0.014f64.powi(4) / 64.0;
    let shape = rope(0.25, 0.014);
    let [x, z] = elastica_tip_m(0.23, shape.mass_kg / shape.length_m * G / stiffness);
    let expected = [x + 0.02, z];
    let (still, lifted) = (hanging_tip_m(0.0), hanging_tip_m(0.3));
    println!("elastica {expected:.5?}, hanging {still:.5?}, lifted {lifted:.5?}");
    for k in 0..2 {
        // 2 % of the free length: the clamp gives by a fifth of a cell, which lengthens the beam.
        assert!((still[k] - expected[k]).abs() < 0.02 * 0.23);
        assert!((still[k] - lifted[k]).abs() < 1e-3);
    }
}

/// A small-deflection check of the reference itself: q L⁴ / (8 E I).
#[test]
fn the_elastica_reference_becomes_the_beam_for_small_loads() {
    let [x, z] = elastica_tip_m(1.0, 1e-3);
    close(-z, 1e-3 / 8.0, 1e-6, "sag");
    close(x, 1.0, 1e-6, "reach");
}

#[test]
fn a_sliding_rope_stops_where_coulomb_says() {
    let (v, friction) = (0.8, 0.4);
    for direction in [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]] {
        let scene = free_scene(direction, Some(-0.007));
        let physics = Physics::base(SOFT_PA, 0.3, friction);
        let mut run = Stepper::new(&scene, &physics);
        let start = run.centre_m();
        run.set_motion(Vector3::new(v, 0.0, 0.0), Matrix3::zeros());
        run.advance((1.5 * v / (friction * G) / run.dt_s) as usize)
            .unwrap();
        let way = run.centre_m() - start;
        close(way.x, v * v / (2.0 * friction * G), 0.05, "sliding distance");
        assert!(way.y.abs() < 1e-6 && way.z.abs() < 1e-4, "{way:?}");
        assert!(run.velocity_m_s().norm() < 1e-6);
    }
}

/// The same with the gripper: it drags the rope across the table and opens while moving.
#[test]
fn a_rope_let_go_in_motion_slides_on() {
    let (v, open_s) = (0.6, 0.3);
    let path = ClampPath::new(vec![
        knot(0.0, [0.0; 3], [0.0; 3], true),
        knot(0.2, [0.1 * v, 0.0, 0.0], [v, 0.0, 0.0], true),
        knot(open_s, [0.2 * v, 0.0, 0.0], [v, 0.0, 0.0], false),
        // The open gripper moves on: the path of a clamp stands still beyond its last knot, and the
        // last closed step aims at a time just after the opening.
        knot(open_s + 0.1, [0.3 * v, 0.0, 0.0], [v, 0.0, 0.0], false),
    ]);
    let scene = scene(
        rope(0.12, 0.014),
        [1.0, 0.0, 0.0],
        start_grip(0.03, path),
        Some(-0.007),
        vec![open_s, 0.7],
    );
    let rollout = simulate(&scene, &soft()).unwrap();
    let mean =
        |k: usize| rollout.frames[k].iter().map(|p| p[0]).sum::<f64>() / rollout.frames[k].len() as f64;
    close(
        mean(1) - mean(0),
        v * v / (2.0 * 0.5 * G),
        0.05,
        "slide after the grip opened",
    );
}

#[test]
fn a_tilted_table_holds_a_rope_up_to_the_angle_of_friction() {
    let slope = 0.25f64;
    for (friction, slides) in [(0.3, false), (0.2, true)] {
        let physics = with_effect(
            "tilted_gravity",
            &[slope, 0.0],
            Physics::base(SOFT_PA, 0.3, friction),
        );
        let scene = free_scene([0.0, 1.0, 0.0], Some(-0.007));
        let mut run = Stepper::new(&scene, &physics);
        let start = run.centre_m();
        run.advance((0.4 / run.dt_s) as usize).unwrap();
        let way = run.centre_m().x - start.x;
        if slides {
            let acceleration = G * (slope.sin() - friction * slope.cos());
            close(way, 0.5 * acceleration * 0.16, 0.05, "slide down the slope");
        } else {
            println!("creep on the slope: {way:.2e} m");
            assert!(way.abs() < 1e-6);
        }
    }
}

/// Linear drag: v' = g − r v, step by step; quadratic drag: v = v∞ tanh(g t / v∞).
#[test]
fn a_falling_rope_reaches_the_speed_that_drag_allows() {
    let scene = free_scene([1.0, 0.0, 0.0], None);
    let rate = 4.0;
    let physics = with_effect("air_drag", &[0.0, 0.0, rate], soft());
    let mut run = Stepper::new(&scene, &physics);
    run.advance(5000).unwrap();
    let kept = 1.0 - rate * run.dt_s;
    let exact = -G / rate * (1.0 - kept.powi(5000));
    close(run.velocity_m_s().z, exact, 1e-9, "fall with linear drag");

    let physics = with_effect("air_drag", &[2.0, 0.0, 0.0], soft());
    let mut run = Stepper::new(&scene, &physics);
    run.advance(5000).unwrap();
    let per_length = 0.5 * 1.204 * 0.014 * 2.0;
    let last = (scene.rope.mass_kg / scene.rope.length_m * G / per_length).sqrt();
    let exact = -last * (G * 5000.0 * run.dt_s / last).tanh();
    close(run.velocity_m_s().z, exact, 1e-3, "fall with quadratic drag");
}

/// The same state in a turned and moved world, gravity turned with it, steps the same way.
#[test]
fn a_turned_and_moved_world_steps_the_same_way() {
    let scene = free_scene([1.0, 0.0, 0.0], None);
    let gradient = Matrix3::new(2.0, 5.0, -9.0, -5.0, 0.0, 1.0, 12.0, 0.0, 0.0);
    let turn = Rotation3::from_euler_angles(0.4, -1.1, 2.3).into_inner();
    let shift = Vector3::new(0.31, -0.17, 1.93);
    let (level, mut turned) = (soft(), soft());
    turned.gravity_m_s2 = (turn * Vector3::from(level.gravity_m_s2)).into();
    let mut here = Stepper::new(&scene, &level);
    here.set_motion(Vector3::new(0.2, 0.1, 0.0), gradient);
    let mut there = Stepper::new(&scene, &turned);
    for (p, q) in here.particles.iter().zip(&mut there.particles) {
        q.position_m = (turn * Vector3::from(p.position_m) + shift).into();
        q.velocity_m_s = (turn * Vector3::from(p.velocity_m_s)).into();
        q.deformation_rate = rows(&(turn * matrix(&p.deformation_rate)));
        q.deformation_gradient = rows(&(turn * matrix(&p.deformation_gradient)));
    }
    here.advance(1500).unwrap();
    there.advance(1500).unwrap();
    for (p, q) in here.particles.iter().zip(&there.particles) {
        let expected = turn * Vector3::from(p.position_m) + shift;
        assert!((Vector3::from(q.position_m) - expected).norm() < 1e-9);
    }
}

/// A whole rollout with a moving grip and a table, turned about the vertical and moved.
#[test]
fn a_lift_does_not_depend_on_place_and_heading() {
    let lift = |angle: f64, shift: Vector3<f64>| {
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), angle);
        let at = |x: f64, y: f64, z: f64| -> [f64; 3] { (turn * Vector3::new(x, y, z) + shift).into() };
        let path = ClampPath::new(vec![
            knot(0.0, at(0.0, 0.0, 0.0), [0.0; 3], true),
            knot(0.25, at(0.02, 0.03, 0.06), [0.0; 3], true),
        ]);
        let direction = (turn * Vector3::x()).into();
        let table = Some(Table {
            height_m: shift.z - 0.007,
        });
        let grips = start_grip(0.02, path);
        let scene = Scene::new(
            rope(0.12, 0.014),
            shift.into(),
            direction,
            grips,
            table,
            1.5,
            vec![0.4],
        );
        let rollout = simulate(&scene.unwrap(), &soft()).unwrap();
        let back = |p: &[f64; 3]| turn.inverse() * (Vector3::from(*p) - shift);
        rollout.frames[0].iter().map(back).collect::<Vec<_>>()
    };
    let here = lift(0.0, Vector3::zeros());
    let there = lift(0.65, Vector3::new(-0.4, 0.23, 0.81));
    let worst = here
        .iter()
        .zip(&there)
        .map(|(a, b)| (a - b).norm())
        .fold(0.0, f64::max);
    println!("turned and moved lift: {worst:.2e} m");
    assert!(worst < 1e-9);
}

/// A lift off the table with a part that still lies there at the end, at θ = (ln E, ν, friction).
fn lift_at<T: Laned>(theta: [T; 3]) -> Rollout<T> {
    let path = ClampPath::new(vec![
        knot(0.0, [0.0; 3], [0.0; 3], true),
        knot(0.3, [0.02, 0.0, 0.05], [0.0; 3], true),
    ]);
    let times = vec![0.1, 0.2, 0.3, 0.4];
    let scene = scene(
        rope(0.2, 0.014),
        [1.0, 0.0, 0.0],
        start_grip(0.02, path),
        Some(-0.007),
        times,
    );
    simulate(&scene, &Physics::base(theta[0].exp(), theta[1], theta[2])).unwrap()
}

/// The derivative with respect to friction does not exist where a node goes over from sliding to
/// sticking or back, and where contact opens or closes: there each side has its own. These are
/// single steps of single nodes, so differences of 1e-6 rarely meet one.
#[test]
fn tangents_are_the_slopes_of_a_lift() {
    let theta = [SOFT_PA.ln(), 0.3, 0.4];
    let dual = lift_at::<Dual<f64, 3>>(std::array::from_fn(|k| Dual::input(theta[k], k)));
    for k in 0..3 {
        let h = 1e-6;
        let sides = [-1.0, 1.0].map(|sign| {
            let mut moved = theta;
            moved[k] += sign * h;
            lift_at(moved)
        });
        let Slope { size, error } = slope((&dual, k), 0..dual.frames.len(), &sides, h);
        println!("tangent {k}: size {size:.2e} m, relative error {error:.2e}");
        assert!(size > 0.0 && error < 1e-4, "tangent {k}: {error:.2e}");
    }
}

#[test]
fn refusals_are_typed() {
    let shape = rope(0.2, 0.014);
    let build = |grips, cells| Scene::new(shape, [0.0; 3], [1.0, 0.0, 0.0], grips, None, cells, vec![0.01]);
    let thin = build(vec![], 1.2).unwrap_err();
    assert_eq!(thin.cause, Cause::TooThin { cells: 1.2 });

    let mut grips = start_grip(0.02, ClampPath::fixed([0.0; 3]));
    grips.push(Grip {
        end: RopeEnd::End,
        length_m: 0.02,
        path: ClampPath::new(vec![
            knot(0.0, [0.2, 0.0, 0.0], [0.0; 3], true),
            knot(0.5, [0.3, 0.0, 0.0], [0.0; 3], true),
        ]),
    });
    let far = build(grips, 1.5).unwrap_err();
    assert!(
        matches!(far.cause, Cause::Unreachable { t_s, .. } if t_s == 0.5),
        "{far}"
    );

    let scene = build(vec![], 1.5).unwrap();
    for (young, poisson, friction, name) in [
        (f64::NAN, 0.3, 0.5, "young_pa"),
        (-1.0, 0.3, 0.5, "young_pa"),
        (SOFT_PA, f64::NAN, 0.5, "poisson"),
        (SOFT_PA, 0.5, 0.5, "poisson"),
        (SOFT_PA, 0.3, f64::NAN, "friction"),
    ] {
        let error = simulate(&scene, &Physics::base(young, poisson, friction)).unwrap_err();
        assert!(
            matches!(error.cause, Cause::BadParameter { name: n, .. } if n == name),
            "{name}: {error}"
        );
        assert_eq!(error.step, 0);
    }
    let drag = with_effect("air_drag", &[0.0, 0.0, f64::NAN], soft());
    let error = simulate(&scene, &drag).unwrap_err();
    assert!(matches!(error.cause, Cause::NonFinite { .. }), "{error}");
}
