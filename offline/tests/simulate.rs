//! `offline simulate` as a user calls it: a rope moved as in a demonstration, and one that swings.
#![cfg(feature = "train")]

mod program;

use offline::demo::Demo;
use program::offline;
use std::process::Output;

fn simulate(arguments: &[&str]) -> Output {
    offline(&[&["simulate"], arguments].concat()).output().unwrap()
}

fn json(arguments: &[&str]) -> serde_json::Value {
    let output = simulate(&[arguments, &["--json"]].concat());
    assert!(output.status.success(), "{output:?}");
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn a_rope_like_the_measured_one_lies_nearer_to_it_than_another() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("simulated");
    let out = out.to_str().unwrap();
    let rms_mm = |young_pa: &str, others: &[&str]| {
        let result = json(&[&["--young-pa", young_pa], others].concat());
        result["residual"]["rms_mm"].as_f64().unwrap()
    };
    // The sample rope is simulated by the twin: 0.9 MPa and 9 g at its tip.
    let alike = rms_mm("0.9e6", &["--effect", "tip_mass=0.009", "--out", out]);
    let (bare, stiff) = (
        rms_mm("0.9e6", &[]),
        rms_mm("5e6", &["--effect", "tip_mass=0.009"]),
    );
    assert!(
        2.0 * alike < bare && 2.0 * alike < stiff,
        "{alike}, {bare}, {stiff} mm"
    );
    let written = Demo::load(out).unwrap();
    assert!(written.spec.notes.contains("simulated"));
    let measured = Demo::load("demos/sample-rope/fit").unwrap();
    assert_eq!(written.times_s(), measured.times_s());
}

#[test]
fn a_heavier_tip_changes_the_reach() {
    let reach = |effects: &[&str]| {
        let base = ["--young-pa", "0.9e6", "--release", "0.15", "0.15"];
        json(&[&base, effects].concat())["reach_m"].as_f64().unwrap()
    };
    let (bare, heavy) = (reach(&[]), reach(&["--effect", "tip_mass=0.009"]));
    assert!((bare - heavy).abs() > 1e-3, "{bare} and {heavy} m");
}

#[test]
fn wrong_use_says_what_to_do() {
    let cases = [
        (
            &["--young-pa", "1e6", "--effect", "glue=1"][..],
            2,
            "effect `glue` is not known",
        ),
        (
            &["--young-pa", "1e6", "--effect", "tip_mass=heavy"],
            2,
            "`heavy` is no number",
        ),
        (
            &["--young-pa", "1e6", "--effect", "tip_mass=-1"],
            2,
            "mass_kg lies from 0",
        ),
        (
            &["--young-pa", "1e6", "--effect", "steady_wind=1"],
            2,
            "steady_wind has 2 parameters",
        ),
        (&[], 2, "--young-pa"),
        (
            &["--young-pa", "1e20"],
            2,
            "'--young-pa <YOUNG_PA>': give a number from 20000 to 200000000",
        ),
        (&["--young-pa", "1"], 2, "give a number from 20000"),
        (
            &["--young-pa", "1e6", "--poisson", "0.5"],
            2,
            "give a number from 0.05 to 0.45",
        ),
        (
            &["--young-pa", "1e6", "--cells", "9"],
            2,
            "give a number from 1.5 to 8",
        ),
        (
            &["--young-pa", "1e6", "--release", "nan", "0.1"],
            2,
            "give a finite number",
        ),
        (
            &["--young-pa", "1e6", "--release", "0.9", "0.9"],
            1,
            "the rope reaches",
        ),
        (
            &["--young-pa", "1e6", "--release", "9", "9"],
            1,
            "the release point is 12.",
        ),
        (
            &["--model", "nowhere.toml"],
            1,
            "(os error 2); name the folder of a run",
        ),
    ];
    for (arguments, code, words) in cases {
        let output = simulate(arguments);
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {said}");
        assert!(said.contains(words), "{arguments:?}: {said}");
    }
}

#[test]
fn a_malformed_model_is_named_with_its_line() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("model.toml");
    std::fs::write(&file, "format = \"genorm-model/1\"\nname = 3\n").unwrap();
    let output = simulate(&["--model", file.to_str().unwrap()]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(said.contains("model.toml:2: invalid type"), "{said}");
    assert!(!said.contains('|') && said.contains("; mend the line"), "{said}");
}
