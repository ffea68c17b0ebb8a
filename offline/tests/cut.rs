//! A part of a recording is a demonstration of its own: it loads, its times begin at zero, and its clamps are
//! where they were.

use offline::demo::{ClampSample, Demo, DemoSpec, MarkerSample, Observations, SceneKind, StartState};

/// A rope that hangs from a clamp which turns about y at 1 rad/s and moves along x at 0.1 m/s; frames at 10 Hz,
/// the clamp at 4 Hz.
fn recording() -> Demo {
    let clamp = (0..=8).map(|k| {
        let t_s = 0.25 * f64::from(k);
        let half = 0.5 * t_s;
        ClampSample {
            t_s,
            position_m: [0.1 * t_s, 0.0, 1.0],
            quaternion_xyzw: [0.0, half.sin(), 0.0, half.cos()],
            closed: true,
        }
    });
    let markers = (0..=20).map(|k| MarkerSample {
        t_s: 0.1 * f64::from(k),
        marker: "tip".into(),
        s_m: 0.25,
        position_m: [0.01 * f64::from(k), 0.0, 0.75],
    });
    let mut demo = Demo::load("demos/sample-rope/fit").unwrap();
    demo.spec = DemoSpec {
        scene: SceneKind::Free,
        start: StartState::Rest,
        table: None,
        cameras: Vec::new(),
        ..demo.spec
    };
    demo.spec.rope.direction = [0.0, 0.0, -1.0];
    demo.clamps = vec![clamp.collect()];
    demo.observations = Observations::Markers(markers.collect());
    demo
}

fn near(got: &[f64], wanted: &[f64]) {
    for (a, b) in got.iter().zip(wanted) {
        assert!((a - b).abs() < 1e-9, "{got:?}, not {wanted:?}");
    }
}

#[test]
fn the_beginning_starts_as_the_recording_does() {
    let part = recording()
        .cut(f64::NEG_INFINITY, 0.61, StartState::Moving)
        .unwrap();
    assert_eq!(part.spec, recording().spec);
    near(&part.times_s(), &[0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6]);
    // The sample after the last frame says where the clamp is in that frame.
    let times: Vec<f64> = part.clamps[0].iter().map(|s| s.t_s).collect();
    near(&times, &[0.0, 0.25, 0.5, 0.75]);
}

#[test]
fn a_part_from_the_middle_begins_at_zero_where_the_clamp_was() {
    let part = recording().cut(0.55, 1.3, StartState::Moving).unwrap();
    assert_eq!(part.spec.start, StartState::Moving);
    near(&part.times_s()[..2], &[0.0, 0.1]);
    assert_eq!(part.times_s().len(), 8);
    let first = &part.clamps[0][0];
    assert_eq!(first.t_s, 0.0);
    near(&first.position_m, &[0.06, 0.0, 1.0]);
    near(&first.quaternion_xyzw, &[0.0, 0.3_f64.sin(), 0.0, 0.3_f64.cos()]);
    // The clamp has turned by 0.6 rad, and the gripped piece with it.
    let direction = [-(0.6_f64.sin()), 0.0, -(0.6_f64.cos())];
    near(&part.spec.clamps[0].direction.unwrap(), &direction);
    near(&part.spec.rope.direction, &direction);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("part");
    part.save(&path).unwrap();
    assert_eq!(Demo::load(&path).unwrap().times_s(), part.times_s());
}

#[test]
fn a_rope_whose_clamp_moves_is_not_at_rest() {
    let refused = recording().cut(0.55, 1.3, StartState::Rest).unwrap_err();
    assert!(refused.to_string().contains("a clamp moves at 0.6"), "{refused}");
    let mut held = recording();
    let still = held.clamps[0][0];
    for sample in &mut held.clamps[0] {
        *sample = ClampSample {
            t_s: sample.t_s,
            ..still
        };
    }
    held.cut(0.55, 1.3, StartState::Rest).unwrap();
}

#[test]
fn parts_of_parts_are_those_of_the_whole() {
    let whole = recording();
    let once = whole.cut(0.95, 1.65, StartState::Moving).unwrap();
    let twice = whole.cut(0.45, f64::INFINITY, StartState::Moving).unwrap();
    let twice = twice.cut(0.45, 1.15, StartState::Moving).unwrap();
    near(&twice.times_s(), &once.times_s());
    for (a, b) in twice.clamps[0].iter().zip(&once.clamps[0]) {
        near(&[a.t_s], &[b.t_s]);
        near(&a.position_m, &b.position_m);
        near(&a.quaternion_xyzw, &b.quaternion_xyzw);
    }
    near(&twice.spec.rope.direction, &once.spec.rope.direction);
}

#[test]
fn clouds_of_a_rope_in_motion_begin_no_part() {
    let clouds = Demo::load("demos/sample-rope/fit").unwrap();
    let refused = clouds.cut(1.0, 1.5, StartState::Moving).unwrap_err().to_string();
    assert!(
        refused.contains("the part begins at 1 s") && refused.contains("--start rest"),
        "{refused}"
    );
    assert!(clouds.cut(2.7, 3.1, StartState::Rest).is_ok());
}

#[test]
fn a_time_when_nothing_was_seen_is_refused() {
    let error = recording().cut(5.0, 6.0, StartState::Moving).unwrap_err();
    assert!(
        error.to_string().contains("choose times between 0 and 2 s"),
        "{error}"
    );
}

#[test]
fn what_no_clamp_holds_at_first_or_one_grips_later_is_refused() {
    let mut demo = recording();
    for sample in &mut demo.clamps[0] {
        sample.closed = sample.t_s < 0.9;
    }
    for start in [StartState::Moving, StartState::Rest] {
        let error = demo.cut(1.0, 2.0, start).unwrap_err().to_string();
        assert!(error.contains("no clamp holds the rope at 1 s"), "{error}");
    }
    for sample in &mut demo.clamps[0] {
        sample.closed = sample.t_s > 1.4;
    }
    let error = demo.cut(1.0, 2.0, StartState::Moving).unwrap_err();
    assert!(error.to_string().contains("clamp 0 closes"), "{error}");
}
