//! The program `offline`, called from the repository's folder as its users do.

use std::path::Path;
use std::process::Command;

pub fn offline(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_offline"));
    command
        .args(arguments)
        .current_dir(Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap());
    command
}
