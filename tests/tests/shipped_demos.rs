//! The demonstrations that ship with the program: they load, they are small, they can be made again.

use offline::demo::{Demo, Observations};
use std::path::{Path, PathBuf};
use tests::sample_rope::{ROPE_NAME, shipped_demos};

const MOST_BYTES: u64 = 3_000_000;

fn shipped() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../offline/demos")
}

/// Bit for bit: the twin world uses one thread and a seeded generator.
#[test]
fn shipped_demonstrations_equal_those_made_again() {
    for made in shipped_demos() {
        let loaded = Demo::load(shipped().join(ROPE_NAME).join(&made.name)).expect("a shipped demo loads");
        assert!(
            loaded == made,
            "'{}' is not what make-demos writes; run it",
            made.name
        );
    }
}

#[test]
fn shipped_demonstrations_are_small() {
    fn bytes(dir: &Path) -> u64 {
        let entries = std::fs::read_dir(dir).expect("the folder is readable");
        let size = |path: PathBuf| {
            if path.is_dir() {
                bytes(&path)
            } else {
                path.metadata().expect("the file is readable").len()
            }
        };
        entries
            .map(|entry| size(entry.expect("the entry is readable").path()))
            .sum()
    }
    let total = bytes(&shipped());
    assert!(total <= MOST_BYTES, "{total} bytes");
}

#[test]
fn every_frame_of_a_shipped_demonstration_sees_the_rope_well() {
    for made in shipped_demos() {
        let Observations::Clouds(frames) = &made.observations else {
            panic!("'{}' holds no clouds", made.name);
        };
        assert!(frames.len() > 60, "{} frames", frames.len());
        for frame in frames {
            assert_eq!(frame.points_m.len(), 250, "'{}' at {} s", made.name, frame.t_s);
        }
    }
}
