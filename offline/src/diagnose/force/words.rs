//! A force in a sentence.

use super::terms::STABLE;
use super::{DemoForce, ResidualForce};
use crate::fit::KNOTS;
use crate::sim::tensor::norm;

/// Shares and ratios beyond which something is said.
const MOSTLY: f64 = 0.7;
const FASTER: f64 = 1.3;
/// Height above or below the rest of the rope from which on where it pushes is said, m.
const HIGHER_M: f64 = 0.02;

/// What the force is like. Never a cause.
pub(super) fn sentence(force: &ResidualForce) -> String {
    if !force.explains() {
        // Simulated under it, a clock that runs late leaves more than before, a grip that slips as much.
        return format!(
            "no force along the rope explains it (the nearest takes away {:.0} % of what is left above the noise): it may \
             lie in a clock, a camera or a grip. A hint, not a cause",
            100.0 * force.removed.max(0.0)
        );
    }
    let mut parts = vec![format!(
        "a force along the rope of {:.2} of its weight (rms) would take away {:.0} % of what is left above the noise",
        force.of_weight,
        100.0 * force.removed
    )];
    if let Some((s_m, t_s, size_n_m)) = force.demos.first().and_then(strongest) {
        parts.push(format!(
            "it is strongest, {size_n_m:.2} N/m, at s = {s_m:.2} m around {t_s:.1} s"
        ));
    }
    parts.push(if force.static_share >= MOSTLY {
        format!(
            "{:.0} % of it does not change over time",
            100.0 * force.static_share
        )
    } else {
        format!(
            "{:.0} % of it changes over time",
            100.0 * (1.0 - force.static_share)
        )
    });
    let [given, taken] = force.work_j;
    if given + taken > 0.0 {
        let share = taken / (given + taken);
        parts.push(if share >= MOSTLY {
            "it takes energy out of the rope".into()
        } else if share <= 1.0 - MOSTLY {
            "it puts energy into the rope".into()
        } else {
            "it gives and takes energy".into()
        });
    }
    parts.extend(where_it_pushes(force));
    let stable: Vec<String> = force
        .terms
        .iter()
        .filter(|term| term.share > STABLE)
        .map(|term| {
            format!(
                "{} ({:.0} % of the halves of the data)",
                term.words,
                100.0 * term.share
            )
        })
        .collect();
    parts.push(if stable.is_empty() {
        "no simple law describes it".into()
    } else {
        format!("described best by {}", stable.join(" and by "))
    });
    format!("{}. A hint, not a cause", parts.join("; "))
}

/// On which of the rope it pushes, where it is not on all alike.
fn where_it_pushes(force: &ResidualForce) -> Vec<String> {
    let mut parts = Vec::new();
    if force.speed_ratio >= FASTER {
        parts.push("it pushes where the rope is fast".into());
    } else if force.speed_ratio <= 1.0 / FASTER {
        parts.push("it pushes where the rope is slow".into());
    }
    if force.higher_m.abs() >= HIGHER_M {
        let side = if force.higher_m > 0.0 { "above" } else { "below" };
        parts.push(format!(
            "on the whole it pushes {:.0} mm {side} the middle of the rope",
            1e3 * force.higher_m.abs()
        ));
    }
    parts
}

/// Arc length, time and size of the strongest push.
fn strongest(force: &DemoForce) -> Option<(f64, f64, f64)> {
    let blocks = force.force_n_m.iter().enumerate();
    let all =
        blocks.flat_map(|(block, forces)| (0..KNOTS).map(move |knot| (block, knot, norm(forces[knot]))));
    let (block, knot, size_n_m) = all.max_by(|a, b| a.2.total_cmp(&b.2))?;
    Some((force.knots_m[knot], force.middle_s(block), size_n_m))
}

#[cfg(test)]
mod tests {
    use super::super::terms::TermShare;
    use super::*;

    fn force(removed: f64, work_j: [f64; 2], share: f64) -> ResidualForce {
        ResidualForce {
            in_words: String::new(),
            demos: vec![DemoForce {
                demo: "lift".into(),
                block_s: 0.2,
                knots_m: [0.0, 0.1, 0.2, 0.3],
                force_n_m: vec![[[0.0; 3]; 4], [[0.0; 3], [0.0, 0.3, 0.4], [0.0; 3], [0.0; 3]]],
            }],
            removed,
            of_weight: 0.25,
            static_share: 0.2,
            work_j,
            speed_ratio: 2.0,
            higher_m: 0.05,
            terms: vec![TermShare {
                id: "velocity".into(),
                words: "a force along the velocity".into(),
                share,
            }],
        }
    }

    #[test]
    fn a_force_is_told_with_place_time_energy_and_law() {
        let words = sentence(&force(0.9, [0.1, 0.9], 0.95));
        for part in [
            "0.25 of its weight",
            "90 % of what is left",
            "0.50 N/m, at s = 0.10 m around 0.3 s",
            "80 % of it changes over time",
            "takes energy out of the rope",
            "where the rope is fast",
            "50 mm above the middle of the rope",
            "a force along the velocity (95 % of the halves",
            "A hint, not a cause",
        ] {
            assert!(words.contains(part), "no '{part}' in: {words}");
        }
        assert!(sentence(&force(0.9, [0.5, 0.5], 0.8)).contains("no simple law"));
    }

    #[test]
    fn what_no_force_explains_is_sought_elsewhere() {
        let words = sentence(&force(-0.9, [0.1, 0.9], 0.95));
        assert!(
            words.contains("takes away 0 %") && words.contains("a clock, a camera or a grip"),
            "{words}"
        );
        assert!(!words.contains("velocity"));
    }
}
