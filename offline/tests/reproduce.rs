//! What `offline reproduce` promises: a table with every row, the same for any number of threads, and a
//! second run that goes on where the first one ended.
#![cfg(feature = "train")]

mod program;

use program::offline;
use std::path::Path;
use std::process::Output;

fn reproduce(arguments: &[&str], out: &Path) -> Output {
    offline(&[&["reproduce"], arguments].concat())
        .arg("--out")
        .arg(out)
        .output()
        .expect("the program starts")
}

/// One rope, two steps of Adam, the coarsest grid.
const TINY: [&str; 10] = [
    "sim2sim",
    "--truths",
    "1",
    "--iterations",
    "2",
    "--cells",
    "1.5",
    "--pointnet-demonstrations",
    "0",
    "--json",
];

#[test]
fn a_tiny_table_has_all_rows_and_repeats() {
    let folder = tempfile::tempdir().unwrap();
    let (first, second) = (folder.path().join("a"), folder.path().join("b"));
    let one = reproduce(&[&TINY[..], &["--threads", "1"]].concat(), &first);
    assert!(one.status.success(), "{}", String::from_utf8_lossy(&one.stderr));
    let two = reproduce(&[&TINY[..], &["--threads", "2"]].concat(), &second);
    assert_eq!(one.stdout, two.stdout);
    let tables: serde_json::Value = serde_json::from_slice(&one.stdout).unwrap();
    let rows = tables[0]["rows"].as_array().unwrap();
    // Two iterates of four descents, ours on particles and on cameras.
    assert_eq!(rows.len(), 10, "{tables}");
    assert_eq!(rows[0]["printed"][0], "11.69 ± 8.28");
    let written = std::fs::read_to_string(first.join("table.md")).unwrap();
    assert!(written.contains("ours, two cameras with 2 mm noise"), "{written}");

    let estimate = first.join("estimates").join("ours-particles-0.json");
    let before = std::fs::metadata(&estimate).unwrap().modified().unwrap();
    std::fs::remove_file(
        first
            .join("estimates")
            .join("gradient-all-paper-particles-0.json"),
    )
    .unwrap();
    let again = reproduce(&TINY, &first);
    assert_eq!(again.stdout, one.stdout);
    assert_eq!(std::fs::metadata(&estimate).unwrap().modified().unwrap(), before);
}

#[test]
fn only_the_estimators_that_were_asked_for_are_made() {
    let folder = tempfile::tempdir().unwrap();
    let only = [&TINY[..], &["--only", "gradient-last-paper"]].concat();
    let made = reproduce(&only, folder.path());
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    let tables: serde_json::Value = serde_json::from_slice(&made.stdout).unwrap();
    let rows = tables[0]["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 2, "{tables}");
    assert_eq!(rows[0]["printed"][0], "13.74 ± 6.75");
}

#[test]
fn wrong_use_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    for wrong in [
        &["sim2sim", "--truths", "0"][..],
        &["sim2sim", "--data", "real"],
        &["sim2sim", "--only", "theirs"],
        &["coverage", "--noise-mm", "0"],
    ] {
        assert_eq!(
            reproduce(wrong, folder.path()).status.code(),
            Some(2),
            "{wrong:?}"
        );
    }
    let missing = reproduce(&["real2sim", "--demo", "no-such-folder"], folder.path());
    assert_eq!(missing.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&missing.stderr).contains("no-such-folder"));
}
