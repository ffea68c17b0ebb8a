//! What is proposed is what helps, and where nothing helps that is said.

use super::*;

fn prospect(id: &str, power: Option<f64>, half_width: Option<f64>) -> MotionProspect {
    MotionProspect {
        id: id.into(),
        words: format!("do {id}"),
        duration_s: 3.0,
        noncentrality: power,
        power,
        half_width,
        swing_mm: half_width.map(|w| 10.0 * w),
        failed: None,
    }
}

fn models() -> Vec<Vec<String>> {
    let names = |list: &[&str]| list.iter().map(ToString::to_string).collect();
    vec![
        names(&["camera_offset", "tip_mass"]),
        names(&["camera_offset", "air_drag"]),
    ]
}

#[test]
fn of_motions_that_tell_as_much_the_easiest_is_proposed() {
    let motions = [
        prospect("repeat", Some(0.3), None),
        prospect("slower", Some(0.992), None),
        prospect("weighted", Some(0.999), None),
    ];
    let (proposed, words) = choose_separating(&motions, &models());
    assert_eq!(proposed.as_deref(), Some("slower"));
    assert_eq!(
        words,
        "do slower: it would tell tip mass from air drag with 99 % power"
    );
}

#[test]
fn where_nothing_helps_that_is_said() {
    let motions = [
        prospect("repeat", Some(0.05), None),
        prospect("slower", Some(0.2), None),
    ];
    let (proposed, words) = choose_separating(&motions, &models());
    assert_eq!(proposed, None);
    assert!(
        words.starts_with("none of the motions") && words.contains("20 % power"),
        "{words}"
    );
    let (proposed, words) = choose_separating(&[prospect("repeat", None, None)], &models());
    assert!(
        proposed.is_none() && words.contains("could be simulated"),
        "{words}"
    );
}

#[test]
fn an_interval_is_narrowed_by_the_easiest_motion_that_does_it_nearly_as_well() {
    let motions = [
        prospect("repeat", None, Some(0.7)),
        prospect("slower", None, Some(0.21)),
        prospect("faster", None, Some(0.2)),
    ];
    let (proposed, words) = choose_narrowing(&motions, "air drag", 1.0, 10.0);
    assert_eq!(proposed.as_deref(), Some("slower"));
    assert!(
        words.contains("± 10.0 mm") && words.contains("lower that to ± 2.1 mm"),
        "{words}"
    );
    let (proposed, words) = choose_narrowing(&motions[..1], "air drag", 0.9, 10.0);
    assert!(
        proposed.is_none() && words.contains("would narrow it much"),
        "{words}"
    );
}
