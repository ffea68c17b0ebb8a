//! The program `offline`: arguments in, library calls, messages and exit codes out.

// What prints goes through `cli::output`, which does not panic where the reader has gone.
#![warn(clippy::print_stdout, clippy::print_stderr)]

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    match cli::arguments() {
        Ok(arguments) => cli::run(arguments),
        Err(wrong_use) => wrong_use,
    }
}
