//! All that the program prints. `println!` panics where its reader has gone or the disk is full; nothing here does.

use std::fmt::Display;
use std::io::{ErrorKind, Write};

/// Prints a result, and ends its line, on standard output.
///
/// A reader that has gone, such as `head`, has seen what it wanted: the command goes on, and its exit code says how
/// it went.
///
/// # Errors
/// What was asked for did not get where it was sent.
pub fn print(text: impl Display) -> anyhow::Result<()> {
    let mut output = std::io::stdout().lock();
    match writeln!(output, "{text}").and_then(|()| output.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(anyhow::anyhow!(
            "cannot write to standard output: {error}; check where it goes and the free space there"
        )),
        _ => Ok(()),
    }
}

/// Prints a line of progress or of an error on standard error. That nobody can read it ends no run.
pub fn note(text: impl Display) {
    let _ = writeln!(std::io::stderr().lock(), "{text}");
}

/// The command as it was given, for people; what is no UTF-8 is replaced.
pub fn command_line() -> String {
    let words = std::env::args_os().map(|word| word.to_string_lossy().into_owned());
    words.collect::<Vec<_>>().join(" ")
}
