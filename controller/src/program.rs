//! How a program of this crate ends: with code 0, or with one line on standard error and code 1.

use std::process::ExitCode;

/// The exit code of a program called `name` that came to this outcome.
pub fn finish(name: &str, outcome: anyhow::Result<()>) -> ExitCode {
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{name}: {error:#}");
            ExitCode::FAILURE
        }
    }
}
