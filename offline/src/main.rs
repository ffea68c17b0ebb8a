//! The program `offline`: arguments in, library calls, messages and exit codes out.

mod cli;

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    cli::run(cli::Arguments::parse())
}
