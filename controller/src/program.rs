//! How the programs of this crate answer on standard output, talk on standard error and end. Nothing here
//! panics when nobody reads: an arm may be moving.

use clap::Parser;
use clap::error::ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand;
use serde::Serialize;
use shared::one_line::OneLine;
use std::io::{self, ErrorKind, Write};
use std::process::ExitCode;

/// Standard output did not take an answer.
#[derive(Debug, thiserror::Error)]
#[error("cannot write the answer to standard output: {0}; make room, or send it elsewhere")]
pub struct AnswerError(io::Error);

/// Writes to standard output and makes sure that it has got there.
pub fn write(words: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<(), AnswerError> {
    let mut out = io::stdout().lock();
    words(&mut out).and_then(|()| out.flush()).map_err(AnswerError)
}

/// Writes one JSON object and the end of its line.
pub fn write_json(value: &impl Serialize) -> Result<(), AnswerError> {
    write(|out| {
        serde_json::to_writer(&mut *out, value)?;
        writeln!(out)
    })
}

/// Writes an answer: `value` for machines, or `text` for people.
pub fn answer(
    as_json: bool,
    value: &impl Serialize,
    text: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<(), AnswerError> {
    if as_json { write_json(value) } else { write(text) }
}

/// Tells whoever hears standard error. Where nobody does, as on a terminal that was closed, the line is lost.
pub fn tell(line: &str) {
    let _ = io::stderr().write_all(format!("{line}\n").as_bytes());
}

/// The arguments of the program called `name`. Wrong use ends it here, with one line and exit code 2; so does a question
/// for help, with its answer.
pub fn arguments<T: Parser>(name: &str) -> T {
    T::try_parse().unwrap_or_else(|error| refuse(name, &error))
}

/// Ends the program called `name` because of how it was called.
pub fn refuse(name: &str, error: &clap::Error) -> ! {
    if !error.use_stderr() || error.kind() == DisplayHelpOnMissingArgumentOrSubcommand {
        error.exit();
    }
    let words = error.to_string();
    tell(&format!(
        "{name}: {}",
        OneLine(words.strip_prefix("error: ").unwrap_or(&words))
    ));
    std::process::exit(error.exit_code())
}

/// The exit code of a program called `name` that came to this outcome; a failure also gets its line.
pub fn finish(name: &str, outcome: anyhow::Result<()>) -> ExitCode {
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if has_read_enough(&error) => ExitCode::SUCCESS,
        Err(error) => {
            tell(&format!("{name}: {}", OneLine(format_args!("{error:#}"))));
            ExitCode::FAILURE
        }
    }
}

/// Whether the reader of standard output closed it, as `head` does.
fn has_read_enough(error: &anyhow::Error) -> bool {
    error
        .downcast_ref()
        .is_some_and(|AnswerError(reason)| reason.kind() == ErrorKind::BrokenPipe)
}
