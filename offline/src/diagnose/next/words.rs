//! Which motion is proposed, and in what words.

use super::MotionProspect;
use crate::effects;

/// Power below which a motion does not help.
const LEAST_POWER: f64 = 0.5;
/// Power within which two motions count as equal; the one that takes less effort is proposed.
const EQUAL_POWER: f64 = 0.01;
/// Share of an interval that has to remain at most, else a motion does not help.
const LEAST_NARROWING: f64 = 0.7;
/// Ratio of two intervals within which they count as equal.
const EQUAL_WIDTH: f64 = 1.1;

fn title(id: &str) -> &str {
    effects::find(id).map_or(id, |effect| effects::ALL[effect].title)
}

/// The motion to propose for telling models apart, and the words for it.
pub(super) fn choose_separating(
    motions: &[MotionProspect],
    models: &[Vec<String>],
) -> (Option<String>, String) {
    let model = |names: &Vec<String>| {
        names
            .iter()
            .map(|id| title(id))
            .collect::<Vec<_>>()
            .join(" with ")
    };
    // What all of them share tells nothing.
    let shared = |id: &String| models.iter().all(|m| m.contains(id));
    let own = models
        .iter()
        .map(|m| m.iter().filter(|id| !shared(id)).cloned().collect());
    let alike = own
        .map(|m: Vec<String>| model(&m))
        .collect::<Vec<_>>()
        .join(" from ");
    let powers = motions.iter().filter_map(|m| m.power);
    let best = powers.fold(f64::NEG_INFINITY, f64::max);
    let Some(motion) = motions
        .iter()
        .find(|m| m.power.is_some_and(|p| p >= best - EQUAL_POWER))
    else {
        return (
            None,
            "none of the motions that were considered could be simulated".into(),
        );
    };
    let percent = 100.0 * motion.power.unwrap_or(0.0);
    if best < LEAST_POWER {
        let words = format!(
            "none of the motions that were considered would tell {alike}: the best of them ({}) would with {percent:.0} % power only",
            motion.words
        );
        return (None, words);
    }
    let words = format!(
        "{}: it would tell {alike} with {percent:.0} % power",
        motion.words
    );
    (Some(motion.id.clone()), words)
}

/// The motion to propose for narrowing an effect, and the words for it.
pub(super) fn choose_narrowing(
    motions: &[MotionProspect],
    effect: &str,
    half_width: f64,
    open_mm: f64,
) -> (Option<String>, String) {
    let least = motions
        .iter()
        .filter_map(|m| m.half_width)
        .fold(f64::INFINITY, f64::min);
    let open = format!(
        "of what these data leave open, {effect} matters most for the swing: its interval is worth ± {open_mm:.1} mm of the reach"
    );
    let near = |m: &&MotionProspect| m.half_width.is_some_and(|w| w <= EQUAL_WIDTH * least);
    match motions.iter().find(near) {
        Some(motion) if least <= LEAST_NARROWING * half_width => {
            let after = motion.swing_mm.unwrap_or(open_mm);
            let words = format!("{open}; {}: it would lower that to ± {after:.1} mm", motion.words);
            (Some(motion.id.clone()), words)
        }
        Some(_) => (
            None,
            format!("{open}; none of the motions that were considered would narrow it much"),
        ),
        None => (
            None,
            format!("{open}; none of the motions that were considered could be simulated"),
        ),
    }
}

#[cfg(test)]
mod tests {
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
}
