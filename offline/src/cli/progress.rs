//! Progress on standard error: a bar with the time left on a terminal, plain lines elsewhere.

use super::output::note;
use indicatif::{HumanDuration, ProgressBar, ProgressState, ProgressStyle};
use offline::countdown::in_words;
use offline::tell::{Progress, Tell};
use std::io::IsTerminal;
use std::sync::Mutex;
use std::time::Instant;

/// Tells the user how far a run has come.
pub struct Reporter {
    start: Instant,
    terminal: bool,
    state: Mutex<State>,
}

struct State {
    stage: &'static str,
    stage_start: Instant,
    last_line_s: f64,
    bar: Option<ProgressBar>,
}

/// Seconds between plain lines of one stage.
const LINE_EVERY_S: f64 = 10.0;

impl Reporter {
    /// A reporter that counts time from now.
    pub fn new() -> Self {
        Self {
            start: Instant::now(),
            terminal: std::io::stderr().is_terminal(),
            state: Mutex::new(State {
                stage: "",
                stage_start: Instant::now(),
                last_line_s: 0.0,
                bar: None,
            }),
        }
    }

    /// Time since the start, s.
    pub fn elapsed_s(&self) -> f64 {
        self.start.elapsed().as_secs_f64()
    }

    /// A step that has begun.
    pub fn say(&self, line: &str) {
        let mut state = self.lock();
        if let Some(bar) = state.bar.take() {
            bar.finish_and_clear();
        }
        note(format_args!("[{:6.1} s] {line}", self.elapsed_s()));
    }

    /// Work that no line has told of; where lines are shown, the first says how much there is to do.
    pub fn advance(&self, progress: Progress) {
        self.show(progress, true);
    }

    /// Shows how far a step has come; `announce` where no line has told of it.
    fn show(&self, progress: Progress, announce: bool) {
        let mut state = self.lock();
        if state.stage != progress.stage || progress.done <= 1 && progress.total > 1 {
            if let Some(bar) = state.bar.take() {
                bar.finish_and_clear();
            }
            state.stage = progress.stage;
            state.stage_start = Instant::now();
            state.last_line_s = self.elapsed_s();
            if self.terminal {
                let style = ProgressStyle::with_template("{msg:>12} [{bar:32}] {pos}/{len}{left}")
                    .expect("the template is a constant")
                    .with_key("left", left);
                let bar = ProgressBar::new(progress.total as u64).with_style(style);
                bar.set_message(progress.stage);
                state.bar = Some(bar);
            } else if announce {
                note(format_args!(
                    "[{:6.1} s] {}: {} to do",
                    self.elapsed_s(),
                    progress.stage,
                    progress.total
                ));
            }
        }
        match &state.bar {
            Some(bar) => bar.set_position(progress.done as u64),
            None => self.plain_line(&mut state, progress),
        }
        if progress.done >= progress.total
            && let Some(bar) = state.bar.take()
        {
            bar.finish_and_clear();
        }
    }

    fn plain_line(&self, state: &mut State, progress: Progress) {
        let now = self.elapsed_s();
        if now - state.last_line_s < LINE_EVERY_S {
            return;
        }
        state.last_line_s = now;
        let spent = state.stage_start.elapsed().as_secs_f64();
        let far = in_words(spent, progress.done, [progress.done, progress.total]);
        note(format_args!("[{now:6.1} s] {}: {far}", progress.stage));
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, State> {
        // A panic elsewhere must not hide its message behind another one here.
        self.state
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner)
    }
}

impl Tell for Reporter {
    fn say(&self, line: &str) {
        self.say(line);
    }

    fn advance(&self, progress: Progress) {
        self.show(progress, false);
    }
}

/// The time left, which nobody knows before a piece has ended.
fn left(state: &ProgressState, out: &mut dyn std::fmt::Write) {
    if state.pos() > 0 {
        // What a bar shows cannot fail to be written, and nobody could be told of it.
        let _ = write!(out, ", {:#} left", HumanDuration(state.eta()));
    }
}
