//! The swing task in the twin world.

use shared::profile::MotionLimits;
use shared::task::SwingTask;
use tests::effects::WorldEffects;
use tests::sample_rope::material;
use tests::swing::{reach_m, swing};
use tests::world::{record_demo, simulate};

fn reach(young_pa: f64, effects: &WorldEffects) -> f64 {
    let mut rope = material();
    rope.segments = 25;
    rope.young_pa = young_pa;
    let spec = swing(
        "swing",
        rope,
        &SwingTask::PAPER,
        [0.15, 0.15],
        &MotionLimits::PAPER,
    );
    reach_m(&simulate(&spec, effects))
}

/// Pulled back by 0.1 m and let go, a rope without losses swings at least as far to the other side,
/// whatever its stiffness; Kelvin-Voigt damping (ζ = τω/2) takes more from a stiffer, faster one.
#[test]
fn damping_shortens_the_reach_of_a_stiff_rope_more_than_that_of_a_soft_one() {
    let damped = WorldEffects {
        damping_s: 0.01,
        ..WorldEffects::default()
    };
    let loss = |young_pa: f64| {
        let free = reach(young_pa, &WorldEffects::default());
        assert!(free > 0.35 && free < 0.45, "{free}");
        free - reach(young_pa, &damped)
    };
    let (soft, stiff) = (loss(0.2e6), loss(4.3e6));
    assert!(soft > 1e-3 && stiff > 3.0 * soft, "{soft} and {stiff}");
}

#[test]
fn a_mass_at_the_tip_changes_the_reach() {
    let loaded = WorldEffects {
        tip_mass_kg: 0.009,
        ..WorldEffects::default()
    };
    let change = reach(0.9e6, &loaded) - reach(0.9e6, &WorldEffects::default());
    assert!(change.abs() > 2e-3, "{change}");
}

#[test]
fn a_recorded_swing_is_a_sound_demo_whose_gripper_opens() {
    let mut rope = material();
    rope.segments = 25;
    let mut spec = swing(
        "swing",
        rope,
        &SwingTask::PAPER,
        [0.15, 0.15],
        &MotionLimits::PAPER,
    );
    spec.frame_rate_hz = 5.0;
    let demo = record_demo(&spec, &WorldEffects::default(), 1);
    let parent = tempfile::tempdir().expect("a temporary folder");
    let dir = parent.path().join("swing");
    demo.save(&dir).expect("the demo is sound");
    assert_eq!(offline::demo::Demo::load(&dir).expect("it was saved"), demo);
    assert!(demo.clamps[0].iter().all(|sample| sample.closed));
    let opens = demo.clamps[1]
        .iter()
        .find(|sample| !sample.closed)
        .expect("it opens")
        .t_s;
    let released = spec.duration_s - 1.0;
    assert!((opens - released).abs() <= 0.01, "{opens} against {released}");
}
