//! Records the shipped demonstrations in the twin world and writes them to a folder.

use clap::Parser;
use std::path::PathBuf;
use tests::sample_rope::{ROPE_NAME, shipped_demos};

/// Records the shipped demonstrations.
///
/// Example: cargo run --release -p tests --bin make-demos -- --out offline/demos
#[derive(Parser)]
struct Arguments {
    /// Folder that gets the rope's folder, relative to the present one.
    #[arg(long, default_value = "offline/demos")]
    out: PathBuf,
}

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    for demo in shipped_demos() {
        let dir = arguments.out.join(ROPE_NAME).join(&demo.name);
        demo.save(&dir)?;
        println!("{}", dir.display());
    }
    Ok(())
}
