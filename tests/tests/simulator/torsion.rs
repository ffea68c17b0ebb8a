//! Twist. A rope in a grip that turns about its axis rings at the first mode of a held rod, whose period is four lengths over
//! the speed of shear waves, but for one known error: masses on nodes give every section a rotary inertia that is too large.

use offline::demo::RopeEnd;
use offline::sim::clamp::ClampPath;
use offline::sim::scene::{Grip, Scene};
use offline::sim::simulate;
use offline::verify::setup::{DIAMETER_M, POISSON, elastic, rope};

const LENGTH_M: f64 = 0.25;
const GRIP_M: f64 = 0.02;
const YOUNG_PA: f64 = 1e6;
const DENSITY_KG_M3: f64 = 1000.0;
const FRAME_S: f64 = 5e-4;
/// How far the grip turns, rad, and in what time, s.
const TURN: (f64, f64) = (0.05, 0.01);

/// A weightless rope whose grip turns and then holds still.
fn turned(cells: f64) -> Scene {
    let (turn_rad, within_s) = TURN;
    let sample = |i: u32| {
        let t_s = 1e-3 * f64::from(i);
        let u = (t_s / within_s).min(1.0);
        let half_rad = 0.5 * turn_rad * u * u * (3.0 - 2.0 * u);
        (
            t_s,
            [0.0, 0.0, 0.0, half_rad.sin(), 0.0, 0.0, half_rad.cos()],
            true,
        )
    };
    let samples: Vec<_> = (0..=300).map(sample).collect();
    let grips = vec![Grip {
        end: RopeEnd::Start,
        length_m: GRIP_M,
        path: ClampPath::from_samples(&samples),
    }];
    let times_s = (0..=600).map(|i| FRAME_S * f64::from(i)).collect();
    let shape = rope(LENGTH_M, DIAMETER_M);
    let mut scene = Scene::new(shape, [0.0; 3], [1.0, 0.0, 0.0], grips, None, cells, times_s).unwrap();
    scene.keep_particles = true;
    scene
}

/// How far the last slice has turned about the rope's axis in every frame, rad.
fn tip_turns_rad(cells: f64) -> Vec<f64> {
    let mut physics = elastic(YOUNG_PA);
    physics.gravity_m_s2 = [0.0; 3];
    let rollout = simulate(&turned(cells), &physics).unwrap();
    let first = &rollout.particles[0];
    let last_slice = first.len() - first.len() / rollout.arc_m.len()..first.len();
    let turn = |frame: &Vec<[f64; 3]>| {
        let pairs = first[last_slice.clone()].iter().zip(&frame[last_slice.clone()]);
        let (mut sine, mut cosine) = (0.0, 0.0);
        for ([_, y0, z0], [_, y, z]) in pairs {
            sine += y0 * z - z0 * y;
            cosine += y0 * y + z0 * z;
        }
        sine.atan2(cosine)
    };
    rollout.particles.iter().map(turn).collect()
}

/// Period of what rings about the grip's last turn, s, from where it passes through that.
fn period_s(turns_rad: &[f64]) -> f64 {
    let (turn_rad, within_s) = TURN;
    let beyond: Vec<f64> = turns_rad.iter().map(|turn| turn - turn_rad).collect();
    let passes: Vec<f64> = (1..beyond.len())
        .filter(|&i| beyond[i - 1] * beyond[i] < 0.0)
        .map(|i| FRAME_S * (i as f64 - beyond[i] / (beyond[i] - beyond[i - 1])))
        .filter(|t_s| *t_s > 2.0 * within_s)
        .collect();
    let [first, .., last] = passes[..] else {
        panic!("it does not ring: {passes:?}");
    };
    2.0 * (last - first) / (passes.len() - 1) as f64
}

/// The stiffness is right: a section turns as slowly as one whose inertia, per mass, is r²/2 about the axis and, for masses
/// on the nodes of quadratic splines h apart, h²/4 more about each diameter (their second moment about a particle).
#[test]
fn a_rope_rings_in_twist_at_the_period_of_its_stiffness_and_of_its_nodes_inertia() {
    let shear_pa = YOUNG_PA / (2.0 * (1.0 + POISSON));
    let right_s = 4.0 * (LENGTH_M - GRIP_M) / (shear_pa / DENSITY_KG_M3).sqrt();
    let of_section_m2 = DIAMETER_M.powi(2) / 8.0;
    for cells in [1.5, 2.5] {
        let of_nodes_m2 = (DIAMETER_M / cells).powi(2) / 2.0;
        let expected_s = right_s * (1.0 + of_nodes_m2 / of_section_m2).sqrt();
        let found_s = period_s(&tip_turns_rad(cells));
        println!("{cells} cells: {found_s:.5} s, expected {expected_s:.5} s, of a rod {right_s:.5} s");
        assert!(
            (found_s / expected_s - 1.0).abs() < 0.03,
            "{cells} cells: {found_s} s, not {expected_s} s"
        );
    }
}
