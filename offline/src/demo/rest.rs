//! How long the rope of a demonstration lies or hangs still at first: what moves in these frames is noise.

use super::{ClampSample, Demo, StartState};

/// A clamp that has moved by no more than this has not moved, m: below what arms repeat.
const MOVED_M: f64 = 1e-4;
/// A clamp whose quaternion differs by no more than this has not turned.
const TURNED: f64 = 1e-4;
/// A straight rope lies on the table where no clamp holds it higher than so many of its diameters.
const LYING_DIAMETERS: f64 = 2.0;

impl Demo {
    /// How many of the frames at `times_s` show the rope at rest: before any clamp moves, turns, opens or closes. None where
    /// nothing holds the rope or says that it rests: one that begins straight does so lying on a table alone.
    pub fn rest_frames(&self, times_s: &[f64]) -> usize {
        let rests = match self.spec.start {
            StartState::Straight => self.lies_on_the_table(),
            StartState::Rest => true,
            StartState::Moving => false,
        };
        if !rests || self.spec.is_static() || self.clamps.is_empty() {
            return 0;
        }
        let until_s = self.clamps.iter().filter_map(|path| changes_at_s(path));
        let until_s = until_s.fold(f64::INFINITY, f64::min);
        times_s.iter().filter(|&&t_s| t_s < until_s).count()
    }

    /// Whether a straight rope begins on the table and not in the air above it, from where it falls.
    fn lies_on_the_table(&self) -> bool {
        let Some(table) = &self.spec.table else {
            return false;
        };
        let most_m = table.height_m + LYING_DIAMETERS * self.spec.rope.diameter_m;
        let mut firsts = self.clamps.iter().filter_map(|path| path.first());
        firsts.all(|first| first.position_m[2] <= most_m)
    }
}

/// Whether a clamp has moved or turned from one sample to another.
pub(super) fn has_moved(sample: &ClampSample, from: &ClampSample) -> bool {
    let apart = |a: &[f64], b: &[f64], most: f64| a.iter().zip(b).any(|(a, b)| (a - b).abs() > most);
    apart(&sample.position_m, &from.position_m, MOVED_M)
        || apart(&sample.quaternion_xyzw, &from.quaternion_xyzw, TURNED)
}

/// Until when a clamp is as at first, s: it opens or closes at the sample that says so, but may move from the last sample
/// at which it has not.
fn changes_at_s(path: &[ClampSample]) -> Option<f64> {
    let first = path.first()?;
    path.windows(2).find_map(|pair| {
        if has_moved(&pair[1], first) {
            Some(pair[0].t_s.next_up())
        } else {
            (pair[1].closed != first.closed).then_some(pair[1].t_s)
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn lifted() -> Demo {
        Demo::load(Path::new(env!("CARGO_MANIFEST_DIR")).join("demos/sample-rope/fit")).unwrap()
    }

    /// The clamp stays where it is for ever.
    fn held() -> Demo {
        let mut demo = lifted();
        demo.clamps[0].truncate(1);
        demo
    }

    #[test]
    fn a_rope_rests_until_its_clamp_moves() {
        let demo = lifted();
        let times_s = demo.times_s();
        let frames = demo.rest_frames(&times_s);
        assert!((1..times_s.len()).contains(&frames), "{frames}");
        assert_eq!(held().rest_frames(&times_s), times_s.len());
    }

    /// Between two samples of a slow log the gripper is on its way already.
    #[test]
    fn a_clamp_that_is_seldom_logged_moves_from_the_last_sample_at_rest() {
        let mut demo = held();
        let times_s = demo.times_s();
        let sample = |t_s: f64, z_m: f64| {
            let mut sample = ClampSample {
                t_s,
                ..demo.clamps[0][0]
            };
            sample.position_m[2] += z_m;
            sample
        };
        let log = [(times_s[0], 0.0), (times_s[3], 0.0), (times_s[9], 0.04)];
        demo.clamps[0] = log.map(|(t_s, z_m)| sample(t_s, z_m)).into();
        assert_eq!(demo.rest_frames(&times_s), 4);
    }

    /// What follows is the swing, not the noise of a rope at rest.
    #[test]
    fn a_clamp_that_opens_ends_the_rest() {
        let mut demo = held();
        let times_s = demo.times_s();
        let opens = ClampSample {
            t_s: times_s[5],
            closed: false,
            ..demo.clamps[0][0]
        };
        demo.clamps[0].push(opens);
        assert_eq!(demo.rest_frames(&times_s), 5);
    }

    #[test]
    fn a_rope_that_nothing_keeps_from_falling_does_not_rest() {
        let times_s = lifted().times_s();
        let mut free = held();
        free.clamps.clear();
        let mut in_the_air = held();
        in_the_air.spec.table = None;
        let mut above_the_table = held();
        above_the_table.clamps[0][0].position_m[2] += 0.1;
        let mut moving = held();
        moving.spec.start = StartState::Moving;
        for demo in [free, in_the_air, above_the_table, moving] {
            assert_eq!(demo.rest_frames(&times_s), 0);
        }
    }
}
