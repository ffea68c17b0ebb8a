//! What every command of `offline` keeps to: exit code 2 for wrong use, one line for what went wrong and what to do,
//! and no panic where a reader has gone or a disk is full.
#![cfg(feature = "train")]

mod program;

use program::offline;
use std::process::{Output, Stdio};

const FIT: &str = "offline/demos/sample-rope/fit";

/// Exit code and what stands on standard error.
fn refusal(arguments: &[&str]) -> (Option<i32>, String) {
    let Output { status, stderr, .. } = offline(arguments).output().unwrap();
    (status.code(), String::from_utf8(stderr).unwrap())
}

/// Writes the first second of the sample rope's recording as a demonstration.
fn write_first_second(out: &str) {
    let (code, said) = refusal(&["demo", "cut", FIT, "--to", "1", "--out", out]);
    assert_eq!(code, Some(0), "{said}");
}

/// A pipe that nobody reads.
fn unread() -> Stdio {
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    writer.into()
}

#[test]
fn wrong_use_has_exit_code_2_and_says_what_is_right() {
    let cut = ["demo", "cut", FIT, "--out", "never-written"];
    let cases: &[(&[&str], &str)] = &[
        (&["run", "--held-out", FIT], "--demo <DIR>..."),
        (&["run", "--threads", "0"], "give a whole number from 1 to 1024"),
        (
            &["reproduce", "coverage", "--threads", "5000"],
            "give a whole number from 1 to 1024",
        ),
        (
            &["reproduce", "sim2sim", "--iterations", "0"],
            "give a whole number from 1 to 100000",
        ),
        (
            &["reproduce", "sim2sim", "--cells", "1"],
            "give a number from 1.5 to 8",
        ),
        (
            &["bench-diagnosis", "--seeds", "0"],
            "give a whole number from 1 to 1000",
        ),
        (
            &["bench-diagnosis", "--threads", "0"],
            "give a whole number from 1 to 1024",
        ),
        (
            &["verify", "--random", "1e9"],
            "give a whole number from 0 to 1000000",
        ),
        (
            &[&cut[..], &["--from", "5", "--to", "1"]].concat(),
            "--from 5 is after --to 1: give the earlier instant first",
        ),
        (&[&cut[..], &["--from", "nan"]].concat(), "give a finite number"),
        (&["run", "--name", "a/b"], "give it another with --name"),
        (
            &["freeze", "--task-origin-m", "0.9", "0", "0.12"],
            "the gripper cannot take the rope where its end hangs",
        ),
        (&["fit", "--name", ""], "give it one with --name"),
        (&["run", "--threads", "-2"], "give a whole number from 1 to 1024"),
        (
            &["bench-diagnosis", "--seeds", "-2"],
            "give a whole number from 1 to 1000",
        ),
        (
            &[
                "simulate",
                "--young-pa",
                "1e6",
                "--effect",
                "tip_mass=0.01",
                "tip_mass=0.02",
            ],
            "--effect tip_mass stands there twice",
        ),
        (
            &["bench-diagnosis", "--only", "zzz"],
            "look at the names with --list",
        ),
    ];
    for (arguments, words) in cases {
        let (code, said) = refusal(arguments);
        assert_eq!(code, Some(2), "{arguments:?}: {said}");
        assert!(said.contains(words), "{arguments:?}: {said}");
        assert_eq!(said.lines().count(), 1, "{arguments:?}: {said}");
    }
}

#[test]
fn a_failure_says_its_cause_once_and_what_to_do_about_it() {
    let cases: &[(&[&str], &str)] = &[
        (&["inspect", "/proc"], "; name the folder of a run"),
        (
            &["demo", "import", "deform", "nope", "--out", "never-written"],
            "; check the path, or add the file",
        ),
        (
            &["demo", "import", "recording", "nope"],
            "; check the path, or add the file",
        ),
        (
            &["demo", "export", "mcap", FIT, "/proc/x.mcap"],
            "; choose a folder that can be written to",
        ),
        (
            &["demo", "cut", FIT, "--out", "/proc/x"],
            "; choose a folder that can be written to",
        ),
        (
            &["demo", "show", FIT, "--out", "/proc/x.svg"],
            "; check the path, its permissions",
        ),
    ];
    for (arguments, remedy) in cases {
        let (code, said) = refusal(arguments);
        assert_eq!(code, Some(1), "{arguments:?}: {said}");
        assert!(said.contains(remedy), "{arguments:?}: {said}");
        assert_eq!(said.matches("os error").count(), 1, "{arguments:?}: {said}");
        assert_eq!(said.lines().count(), 1, "{arguments:?}: {said}");
    }
}

/// A mistyped path must not cost a measurement.
#[test]
fn what_is_drawn_or_exported_replaces_no_file_but_a_drawing() {
    let folder = tempfile::tempdir().unwrap();
    let measured = folder.path().join("demo.toml");
    let recorded = folder.path().join("original.mcap");
    for file in [&measured, &recorded] {
        std::fs::write(file, "measured").unwrap();
        let path = file.to_str().unwrap();
        for arguments in [
            ["demo", "show", FIT, "--out", path],
            ["demo", "export", "mcap", FIT, path],
        ] {
            let (code, said) = refusal(&arguments);
            assert_eq!(code, Some(1), "{arguments:?}: {said}");
            assert!(
                said.contains("it would be replaced; choose another name"),
                "{said}"
            );
            assert_eq!(std::fs::read(file).unwrap(), b"measured");
        }
    }
    let drawing = folder.path().join("rope.svg");
    for _ in 0..2 {
        let (code, said) = refusal(&["demo", "show", FIT, "--out", drawing.to_str().unwrap()]);
        assert_eq!(code, Some(0), "{said}");
    }
}

#[test]
fn a_part_may_begin_before_the_recording() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("part");
    let (code, said) = refusal(&["demo", "cut", FIT, "--from", "-1", "--out", out.to_str().unwrap()]);
    assert_eq!(code, Some(0), "{said}");
}

/// Hours later would be a bad time to say so, and a controller that believed it would drive its gripper into the table.
#[test]
fn a_rope_that_hangs_on_the_table_gets_no_policy() {
    let folder = tempfile::tempdir().unwrap();
    let long = folder.path().join("long");
    let long = long.to_str().unwrap();
    write_first_second(long);
    let spec = std::path::Path::new(long).join("demo.toml");
    let text = std::fs::read_to_string(&spec).unwrap();
    let text = text.replace("length_m = 0.25", "length_m = 0.29");
    std::fs::write(&spec, text).unwrap();
    let out = folder.path().join("run");
    // A whole run tells what it can, of a rope that is as long as it is said to be.
    let played = folder.path().join("played");
    let played = played.to_str().unwrap();
    let (code, said) = refusal(&["simulate", "--young-pa", "9e5", "--demo", long, "--out", played]);
    assert_eq!(code, Some(0), "{said}");
    let (code, said) = refusal(&["run", "--demo", played, "--out", out.to_str().unwrap()]);
    assert_eq!(code, Some(1), "{said}");
    assert!(
        said.lines()
            .last()
            .unwrap()
            .contains("there is a diagnosis, but no policy: a rope of 0.290 m")
    );
    assert!(out.join("report.html").exists() && !out.join("policy.blob").exists());
    let out = folder.path().join("other");
    for command in ["collect", "train", "freeze"] {
        let (code, said) = refusal(&[command, "--demo", long, "--out", out.to_str().unwrap()]);
        assert_eq!(code, Some(1), "{said}");
        assert!(
            said.contains("a rope of 0.290 m") && said.contains("at most 0.268 m"),
            "{said}"
        );
        assert_eq!(said.lines().count(), 1, "{said}");
    }
}

#[test]
fn a_file_in_the_place_of_a_demonstration_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("f.txt");
    std::fs::write(&file, "precious").unwrap();
    let out = file.to_str().unwrap();
    let commands: [&[&str]; 2] = [
        &["demo", "cut", FIT, "--to", "1", "--out", out],
        &["simulate", "--young-pa", "1e6", "--out", out],
    ];
    for arguments in commands {
        let (code, said) = refusal(arguments);
        assert_eq!(code, Some(1), "{arguments:?}: {said}");
        assert!(said.contains("f.txt: this is no folder; choose"), "{said}");
        assert_eq!(said.lines().count(), 1, "{said}");
        assert_eq!(std::fs::read(&file).unwrap(), b"precious");
    }
}

/// A simulation took the place of the measurement it had been asked to repeat; a part of one, that of another.
#[test]
fn no_demonstration_is_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let measured = folder.path().join("measured");
    write_first_second(measured.to_str().unwrap());
    let clouds = || std::fs::read_dir(measured.join("clouds")).unwrap().count();
    let before = clouds();
    let (read, out) = (
        measured.to_str().unwrap(),
        format!("{}/../measured", measured.display()),
    );
    let commands: [&[&str]; 3] = [
        &["demo", "cut", read, "--to", "0.5", "--out", &out],
        &["demo", "cut", FIT, "--to", "0.5", "--out", &out],
        &["simulate", "--young-pa", "1e6", "--demo", read, "--out", &out],
    ];
    for arguments in commands {
        let (code, said) = refusal(arguments);
        assert_eq!(code, Some(1), "{arguments:?}: {said}");
        assert!(
            said.contains("would be replaced") && said.contains("choose another folder"),
            "{said}"
        );
        assert_eq!(clouds(), before);
    }
}

#[test]
fn cells_are_listed_for_machines() {
    let list = ["bench-diagnosis", "--quick", "--list", "--json"];
    let output = offline(&list).output().unwrap();
    let names: Vec<String> = serde_json::from_slice(&output.stdout).unwrap();
    assert!(names.len() > 10, "{names:?}");
}

#[test]
fn a_reader_that_has_gone_ends_no_command() {
    let output = offline(&["demo", "check", FIT, FIT])
        .stdout(unread())
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    assert!(output.stderr.is_empty(), "{output:?}");
}

#[test]
fn a_run_goes_on_when_nobody_reads_its_progress() {
    let folder = tempfile::tempdir().unwrap();
    let output = offline(&["fit", "--demo", FIT, "--out"])
        .arg(folder.path())
        .stderr(unread())
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    assert!(folder.path().join("model.toml").exists());
}

#[test]
fn answers_that_are_not_there_are_not_counted() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("bench");
    let (code, said) = refusal(&[
        "bench-diagnosis",
        "--count",
        "--quick",
        "--out",
        out.to_str().unwrap(),
    ]);
    assert_eq!(code, Some(1), "{said}");
    assert!(said.contains("holds no answers"), "{said}");
    assert!(!out.exists(), "a table of nothing was written");
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_one_line_and_a_failure() {
    let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
    let output = offline(&["demo", "check", FIT]).stdout(full).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(
        said.contains("cannot write to standard output: No space left"),
        "{said}"
    );
    assert_eq!(said.lines().count(), 1, "{said}");
}

/// `freeze --out my-run` without `--demo` took the sample rope's recordings, removed the diagnosis of one's own rope, and
/// would have frozen the sample rope's policy in its place.
#[test]
fn a_run_of_ones_own_rope_is_not_made_the_sample_ropes() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_str().unwrap();
    let own = "offline/demos/sample-rope/held-out-1";
    let fitted = offline(&["fit", "--demo", own, "--name", "mine", "--out", out]).output();
    assert!(fitted.unwrap().status.success());
    let model = || std::fs::read(folder.path().join("model.toml")).unwrap();
    let before = model();
    for command in ["fit", "freeze"] {
        let (code, said) = refusal(&[command, "--out", out]);
        assert_eq!(code, Some(1), "{said}");
        assert!(
            said.contains("fitted: held-out-1") && said.contains("--demo"),
            "{said}"
        );
    }
    assert_eq!(model(), before);
}

/// A forgotten `--held-out` or `--seed` removed a diagnosis of hours before it had anything to put in its place.
#[test]
fn a_diagnosis_outlives_a_command_of_other_recordings_or_settings() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_str().unwrap();
    let fitted = offline(&["fit", "--demo", FIT, "--out", out]).output();
    assert!(fitted.unwrap().status.success());
    let diagnosis = folder.path().join("diagnosis.json");
    let hours = br#"{"verdict": "of hours"}"#;
    std::fs::write(&diagnosis, hours).unwrap();
    let judge = "offline/demos/sample-rope/held-out-1";
    let commands: [(&[&str], &str); 3] = [
        (&["diagnose", "--demo", judge], "fitted: fit; held out: none"),
        (&["run", "--demo", FIT, "--held-out", judge], "held out: none"),
        (&["fit", "--demo", FIT, "--seed", "2"], "another seed"),
    ];
    for (command, words) in commands {
        let (code, said) = refusal(&[command, &["--out", out]].concat());
        assert_eq!(code, Some(1), "{command:?}: {said}");
        assert!(said.contains(words) && said.contains("--out"), "{said}");
        assert_eq!(std::fs::read(&diagnosis).unwrap(), hours);
    }
}
