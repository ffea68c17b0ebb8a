//! What long work says while it goes on: a line for every step, and how far a step of so many pieces has come.

use std::sync::atomic::{AtomicUsize, Ordering};

/// How far a step has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// What is being done.
    pub stage: &'static str,
    /// Pieces that have ended or were there: rollouts, in training steps.
    pub done: usize,
    /// All of them.
    pub total: usize,
    /// Refused rollouts among those done.
    pub refused: usize,
}

/// Hears of long work.
pub trait Tell: Sync {
    /// A step that begins, or what came of one.
    fn say(&self, line: &str);
    /// How far the step has come that the last line told of. Only those hear it who show the time that is left.
    fn advance(&self, _progress: Progress) {}
}

impl<F: Fn(&str) + Sync> Tell for F {
    fn say(&self, line: &str) {
        self(line);
    }
}

/// Hears nothing.
pub struct Silent;

impl Tell for Silent {
    fn say(&self, _line: &str) {}
}

/// The pieces of a step, which may end on many threads.
pub struct Pieces<'a> {
    tell: &'a dyn Tell,
    stage: &'static str,
    total: usize,
    ended: AtomicUsize,
}

impl<'a> Pieces<'a> {
    /// So many pieces, none of which has ended.
    pub fn of(tell: &'a dyn Tell, stage: &'static str, total: usize) -> Self {
        Self {
            tell,
            stage,
            total,
            ended: AtomicUsize::new(0),
        }
    }

    /// One piece has ended; returns what came of it.
    pub fn ended<T>(&self, outcome: T) -> T {
        self.tell.advance(Progress {
            stage: self.stage,
            done: self.ended.fetch_add(1, Ordering::Relaxed) + 1,
            total: self.total,
            refused: 0,
        });
        outcome
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Mutex;

    #[derive(Default)]
    struct Heard(Mutex<Vec<[usize; 2]>>);

    impl Tell for Heard {
        fn say(&self, _line: &str) {}
        fn advance(&self, progress: Progress) {
            self.0.lock().unwrap().push([progress.done, progress.total]);
        }
    }

    #[test]
    fn every_piece_is_told_of_once_and_the_last_of_all_ends_the_step() {
        let heard = Heard::default();
        let pieces = Pieces::of(&heard, "refits", 3);
        let kept: Vec<i32> = (0..3).map(|piece| pieces.ended(piece)).collect();
        assert_eq!(kept, [0, 1, 2]);
        assert_eq!(*heard.0.lock().unwrap(), [[1, 3], [2, 3], [3, 3]]);
    }
}
