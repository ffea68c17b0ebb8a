//! Which points of a section are the rope's. Cameras see a table, a hand and stray points at edges too, and those lie
//! anywhere in the section, while the rope's lie together.

use nalgebra::Vector2;

/// Points that are tried as the middle of the rope's.
const TRIED: usize = 32;

/// The points that lie together, within `reach_m` of their mean; none where those are not most of them, for then nothing says
/// which are the rope's.
pub(super) fn rope_points(mut points_m: Vec<Vector2<f64>>, reach_m: f64) -> Option<Vec<Vector2<f64>>> {
    let count = points_m.len();
    let mean_m = mean(&points_m);
    if points_m.iter().all(|point| (point - mean_m).norm() <= reach_m) {
        return Some(points_m);
    }
    let around = |middle_m: &Vector2<f64>| {
        let near = points_m
            .iter()
            .filter(|point| (*point - middle_m).norm() <= reach_m);
        near.copied().collect::<Vec<_>>()
    };
    let tried = points_m.iter().step_by(count.div_ceil(TRIED));
    let densest = tried.map(around).max_by_key(Vec::len)?;
    // Beside the rope's middle, the place of one of its points reaches too far to one side.
    let middle_m = mean(&densest);
    points_m.retain(|point| (point - middle_m).norm() <= reach_m);
    (2 * points_m.len() > count).then_some(points_m)
}

fn mean(points_m: &[Vector2<f64>]) -> Vector2<f64> {
    points_m.iter().sum::<Vector2<f64>>() / points_m.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collect::stream;
    use rand::RngExt;

    const REACH_M: f64 = 0.03;

    /// Forty points of a rope 60 mm from where it was thought to be, and some anywhere around there.
    fn section(background: usize) -> Vec<Vector2<f64>> {
        let mut random = stream(3, 0);
        let mut anywhere = |size_m: f64| {
            Vector2::new(
                size_m * (2.0 * random.random::<f64>() - 1.0),
                size_m * (2.0 * random.random::<f64>() - 1.0),
            )
        };
        let rope: Vec<_> = (0..40)
            .map(|_| Vector2::new(0.06, 0.0) + anywhere(0.007))
            .collect();
        let other: Vec<_> = (0..background).map(|_| anywhere(0.12)).collect();
        // A cloud is in no order.
        let mut all = [rope, other].concat();
        let n = all.len();
        for k in 0..n {
            all.swap(k, (7 * k + 3) % n);
        }
        all
    }

    #[test]
    fn what_lies_together_is_the_rope_wherever_it_is() {
        let alone = section(0);
        assert_eq!(rope_points(alone.clone(), REACH_M), Some(alone));
        for background in [2, 10, 30] {
            let found = rope_points(section(background), REACH_M).unwrap();
            assert!(
                (40..=40 + background / 5 + 1).contains(&found.len()),
                "{}",
                found.len()
            );
            assert!((mean(&found) - Vector2::new(0.06, 0.0)).norm() < 0.003);
        }
    }

    #[test]
    fn a_section_in_which_the_rope_is_hidden_tells_nothing() {
        let hidden: Vec<_> = section(60)
            .into_iter()
            .filter(|point| (point - Vector2::new(0.06, 0.0)).norm() > 0.012)
            .collect();
        assert!(hidden.len() > 40);
        assert_eq!(rope_points(hidden, REACH_M), None);
    }
}
