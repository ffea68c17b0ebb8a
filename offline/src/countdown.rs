//! How far work of so many pieces has come, and how long the rest takes at the pace so far.

use crate::words::duration;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

/// Pieces of work that may end on many threads.
pub struct Countdown {
    start: Instant,
    total: usize,
    ended: AtomicUsize,
    made: AtomicUsize,
}

impl Countdown {
    /// So many pieces, the first of which begins now.
    pub fn of(total: usize) -> Self {
        Self {
            start: Instant::now(),
            total,
            ended: AtomicUsize::new(0),
            made: AtomicUsize::new(0),
        }
    }

    /// One more piece: how far that is, in words. One that was there already, or is left out, tells nothing of the pace.
    pub fn ended(&self, made: bool) -> String {
        let made = self.made.fetch_add(usize::from(made), Ordering::Relaxed) + usize::from(made);
        let ended = self.ended.fetch_add(1, Ordering::Relaxed) + 1;
        in_words(self.start.elapsed().as_secs_f64(), made, [ended, self.total])
    }
}

/// "3 of 9, about 12 min left", where `made` of those that ended took all the time.
pub fn in_words(spent_s: f64, made: usize, [ended, total]: [usize; 2]) -> String {
    let left = total.saturating_sub(ended);
    if left == 0 || made == 0 {
        return format!("{ended} of {total}");
    }
    let left_s = spent_s / made as f64 * left as f64;
    format!("{ended} of {total}, about {} left", duration(left_s))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_there_already_does_not_make_the_rest_look_quick() {
        assert_eq!(in_words(60.0, 1, [31, 41]), "31 of 41, about 10 min left");
        assert_eq!(in_words(60.0, 4, [4, 5]), "4 of 5, about 15 s left");
        assert_eq!(in_words(60.0, 5, [5, 5]), "5 of 5");
        assert_eq!(in_words(60.0, 0, [3, 5]), "3 of 5");
    }

    #[test]
    fn every_piece_counts_once() {
        let countdown = Countdown::of(3);
        assert_eq!(countdown.ended(false), "1 of 3");
        assert!(countdown.ended(true).starts_with("2 of 3, about "));
        assert_eq!(countdown.ended(true), "3 of 3");
    }
}
