//! The simulator: the verification suite on its quickest grid, random scenes, and tangents against
//! central differences.

use offline::sim::Laned;
use offline::sim::clamp::ClampPath;
use offline::sim::scene::StepLength;
use offline::sim::{Dual, Physics, Rollout, simulate};
use offline::verify::setup::{SOFT_PA, knot, rope, scene, start_grip};
use offline::verify::{Extent, random, table, verify};
use tests::derivatives::{LANES, Slope, slope};

#[test]
fn the_simulator_agrees_with_what_is_known_exactly() {
    let report = verify(Extent::Quick, &|_| ());
    println!("{}", table(&report));
    assert!(report.cases.len() > 60, "the suite has all its families");
    for case in &report.cases {
        assert!(case.passed, "{} fails: {case:?}", case.name);
    }
}

/// A small share of what `offline verify --random 10000` runs.
#[test]
fn random_scenes_run_or_are_refused_by_name() {
    let outcomes = random::run(60, 7, &|_| ());
    println!("{}", outcomes.text());
    for case in outcomes.cases() {
        assert!(case.passed, "{case:?}");
    }
    assert_eq!(outcomes.counts.values().sum::<usize>(), 60);
    assert!(
        outcomes.counts["ran"] > 20 && outcomes.counts.len() > 2,
        "{:?}",
        outcomes.counts
    );
}

/// A lift off the table with a part that still lies there at the end, at θ = (ln E, ν, friction).
fn lift_at<T: Laned>(theta: [T; 3]) -> Rollout<T> {
    let path = ClampPath::new(vec![
        knot(0.0, [0.0; 3], [0.0; 3], true),
        knot(0.3, [0.02, 0.0, 0.05], [0.0; 3], true),
    ]);
    let grips = start_grip(0.02, path);
    let mut scene = scene(rope(0.2, 0.014), [1.0, 0.0, 0.0], grips, Some(-0.007), 1.5, 0.4).unwrap();
    scene.frame_times_s = vec![0.1, 0.2, 0.3, 0.4];
    // Differences must not change the step.
    scene.step = StepLength::Fixed(1e-4);
    simulate(&scene, &Physics::base(theta[0].exp(), theta[1], theta[2])).unwrap()
}

/// The derivative with respect to friction does not exist where a node goes over from sliding to
/// sticking or back, and where contact opens or closes: there each side has its own. These are
/// single steps of single nodes, so differences of 1e-6 rarely meet one.
#[test]
fn tangents_are_the_slopes_of_a_lift() {
    let theta = [SOFT_PA.ln(), 0.3, 0.4];
    let dual = lift_at::<Dual<f64, LANES>>(std::array::from_fn(|k| Dual::input(theta[k], k)));
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
