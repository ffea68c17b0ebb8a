//! Tests of the policy network, its normaliser and its region of release points.

use super::*;
use crate::fixtures;
use proptest::prelude::*;

/// The forward pass once more in f64, written output by output.
fn reference<const I: usize, const O: usize>(layer: &Layer<I, O>, input: &[f64], relu: bool) -> [f64; O] {
    core::array::from_fn(|o| {
        let mut sum = f64::from(layer.bias[o]);
        for i in 0..I {
            sum += f64::from(layer.weights[i][o]) * input[i];
        }
        if relu { sum.max(0.0) } else { sum }
    })
}

#[test]
fn forward_agrees_with_a_plain_f64_network() {
    let network = fixtures::network();
    for input in [[0.0, 0.0, 0.0], [1.0, -2.0, 0.5], [-0.3, 1.5, -1.0]] {
        let wide = input.map(f64::from);
        let first = reference(&network.first, &wide, true);
        let second = reference(&network.second, &first, true);
        let third = reference(&network.third, &second, true);
        let expected = reference(&network.last, &third, false);
        let found = network.forward(&input);
        for k in 0..OUTPUTS {
            assert!(
                (f64::from(found[k]) - expected[k]).abs() < 1e-5,
                "{found:?} {expected:?}"
            );
        }
    }
}

#[test]
fn forward_bits_are_fixed() {
    let outputs = fixtures::network().forward(&[0.5, -0.25, 1.0]);
    assert_eq!(outputs.map(f32::to_bits), GOLDEN_BITS, "outputs {outputs:?}");
}

/// What the fixture's network gave when this test was written; any other summation order shows here.
const GOLDEN_BITS: [u32; OUTPUTS] = [3164271031, 1019722018];

#[test]
fn answers_change_with_every_input_and_lie_in_the_region() {
    let policy = fixtures::policy();
    let base = policy.network.forward(&policy.normaliser.inputs(0.33, 1e6, 0.3));
    for other in [(0.34, 1e6, 0.3), (0.33, 1.2e6, 0.3), (0.33, 1e6, 0.31)] {
        let inputs = policy.normaliser.inputs(other.0, other.1, other.2);
        assert_ne!(policy.network.forward(&inputs), base);
        assert!(
            policy
                .region
                .contains(policy.release_point_m(other.0, other.1, other.2))
        );
    }
}

#[test]
fn a_bad_input_shows_at_the_output() {
    let policy = fixtures::policy();
    for (goal, young, poisson) in [(f64::NAN, 1e6, 0.3), (0.3, -1.0, 0.3), (0.3, 1e6, f64::NAN)] {
        let release = policy.release_point_m(goal, young, poisson);
        assert!(release.iter().all(|value| value.is_nan()), "{release:?}");
        assert!(!policy.ranges.contain(goal, young, poisson));
    }
}

#[test]
fn wrong_sizes_and_unusable_parts_are_refused() {
    assert!(matches!(
        Layer::<2, 3>::from_rows(&[0.0; 5], &[0.0; 3]),
        Err(PolicyError::Shape { weights: 5, .. })
    ));
    let good = fixtures::policy();
    let mut bad = good.clone();
    bad.network.third.bias[3] = f32::NAN;
    assert_eq!(bad.check(), Err(PolicyError::Weights));
    let mut bad = good.clone();
    bad.normaliser.log_young.scale = 0.0;
    assert_eq!(bad.check(), Err(PolicyError::Normaliser("ln E")));
    let mut bad = good.clone();
    bad.ranges.goal_x_m.high = 0.0;
    assert_eq!(bad.check(), Err(PolicyError::Range("goal")));
    let mut bad = good;
    bad.region.radius_m = 0.05;
    assert_eq!(bad.check(), Err(PolicyError::Region));
}

fn region() -> ReleaseRegion {
    ReleaseRegion::new(&SwingTask::PAPER, 0.98 * 0.23)
}

proptest! {
    #[test]
    fn projection_is_the_nearest_point_of_the_region(
        x in -0.3f64..0.6, z in -0.3f64..0.6, share_x in 0f64..1.0, share_z in 0f64..1.0,
    ) {
        let region = region();
        let nearest = region.project([x, z]);
        prop_assert!(region.contains(nearest), "{nearest:?}");
        let other = [region.x_m.at(share_x), region.z_m.at(share_z)];
        if region.contains(other) {
            let square = |p: [f64; 2]| (p[0] - x).powi(2) + (p[1] - z).powi(2);
            prop_assert!(square(nearest) <= square(other) + 1e-12);
        }
    }

    #[test]
    fn projection_leaves_inner_points_alone(share_x in 0f64..1.0, share_z in 0f64..1.0) {
        let region = region();
        let point = [region.x_m.at(share_x), region.z_m.at(share_z)];
        prop_assume!(region.contains(point));
        prop_assert_eq!(region.project(point), point);
    }
}
