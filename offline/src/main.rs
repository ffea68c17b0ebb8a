//! The program `offline`: arguments in, library calls, messages and exit codes out.

fn main() {}
