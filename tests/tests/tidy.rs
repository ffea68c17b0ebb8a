//! The rules of this repository. Each rule is a function from text to complaints, and has a test that
//! shows it a sample that breaks the rule.
//!
//! 1. A Rust file starts with `//!` and has at most [`MOST_FILE_LINES`] lines.
//! 2. A function has at most [`MOST_FUNCTION_LINES`] lines, from `fn` to its closing brace.
//! 3. Nothing is left for later: none of [`unfinished`] stands in a text file.
//! 4. No text file names a folder of the machine it was written on.
//! 5. Beside dot files the top level holds exactly [`TOP_LEVEL`].
//! 6. `shared` is `no_std` and never brings in `alloc`.
//! 7. Crates depend on one another only as [`MAY_DEPEND_ON`] says.
//! 8. Every path in the README's code map exists.
//! 9. The README's table of dependencies names every direct dependency, and nothing else.
//! 10. `.ci/run` runs the README's test command, word for word.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;

const MOST_FILE_LINES: usize = 600;
const MOST_FUNCTION_LINES: usize = 70;

const TOP_LEVEL: [&str; 10] = [
    "CHANGELOG.md",
    "Cargo.lock",
    "Cargo.toml",
    "LICENSE-APACHE",
    "LICENSE-MIT",
    "README.md",
    "controller",
    "offline",
    "shared",
    "tests",
];

/// Each crate and the crates of this workspace that it may depend on.
const MAY_DEPEND_ON: [(&str, &[&str]); 4] = [
    ("shared", &[]),
    ("offline", &["shared"]),
    ("controller", &["shared"]),
    ("tests", &["shared", "offline", "controller"]),
];

/// Words of unfinished work, put together here so that this file does not hold them.
fn unfinished() -> [String; 4] {
    [
        ("to", "do!("),
        ("unimple", "mented!("),
        ("TO", "DO"),
        ("FIX", "ME"),
    ]
    .map(|(a, b)| format!("{a}{b}"))
}

/// Folders of a developer's machine.
fn machine_folders() -> [String; 3] {
    ["root", "work", "home"].map(|name| format!("/{name}/"))
}

// The files.

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Paths of all tracked files relative to the root; of all files where there is no git.
fn files() -> Vec<String> {
    let listed = Command::new("git")
        .args(["ls-files", "-z"])
        .current_dir(root())
        .output()
        .ok()
        .filter(|output| output.status.success() && !output.stdout.is_empty());
    let Some(output) = listed else {
        let mut found = Vec::new();
        walk(&root(), "", &mut found);
        return found;
    };
    String::from_utf8(output.stdout)
        .expect("paths are UTF-8")
        .split_terminator('\0')
        .filter(|path| root().join(path).is_file())
        .map(String::from)
        .collect()
}

fn walk(dir: &Path, prefix: &str, found: &mut Vec<String>) {
    const SKIPPED: [&str; 3] = ["target", "runs", ".git"];
    for entry in std::fs::read_dir(dir).expect("the folder is readable") {
        let entry = entry.expect("the entry is readable");
        let name = entry.file_name().into_string().expect("names are UTF-8");
        let path = format!("{prefix}{name}");
        if !entry.path().is_dir() {
            found.push(path);
        } else if !SKIPPED.contains(&name.as_str()) {
            walk(&entry.path(), &format!("{path}/"), found);
        }
    }
}

fn read(path: &str) -> String {
    std::fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// Complaints of a rule about all text files with one of these endings, each with its file's path.
fn complaints(ending: &str, rule: impl Fn(&str) -> Vec<String>) -> Vec<String> {
    let is_text = |path: &String| !path.ends_with(".ply") && path.ends_with(ending);
    files()
        .iter()
        .filter(|path| is_text(path))
        .flat_map(|path| {
            rule(&read(path))
                .into_iter()
                .map(move |complaint| format!("{path}: {complaint}"))
        })
        .collect()
}

fn assert_none(complaints: &[String]) {
    assert!(complaints.is_empty(), "\n{}\n", complaints.join("\n"));
}

// The rules.

fn file_shape(text: &str) -> Vec<String> {
    let mut list = Vec::new();
    if !text.starts_with("//!") {
        list.push("the first line does not start with //!".into());
    }
    let lines = text.lines().count();
    if lines > MOST_FILE_LINES {
        list.push(format!("{lines} lines"));
    }
    list
}

/// Whether a line starts a function: `fn` after nothing but qualifiers.
fn starts_function(line: &str) -> bool {
    let before = line.split("fn ").next().unwrap_or(line);
    let qualifier = |word: &str| {
        matches!(word, "const" | "async" | "unsafe" | "extern" | "\"C\"") || word.starts_with("pub")
    };
    line.contains("fn ") && before.split_whitespace().all(qualifier)
}

/// Relies on rustfmt: a function ends at the first line as deep as its own that closes a brace or,
/// without a body, ends in a semicolon.
fn function_lengths(text: &str) -> Vec<String> {
    let lines: Vec<&str> = text.lines().collect();
    let depth = |line: &str| line.len() - line.trim_start().len();
    let mut list = Vec::new();
    for (first, line) in lines.iter().enumerate() {
        if !starts_function(line) {
            continue;
        }
        let ends = |(k, other): (usize, &&str)| {
            let closes = other.trim_start().starts_with('}') || (k == 0 && other.ends_with('}'));
            depth(other) == depth(line) && !other.is_empty() && (closes || other.ends_with(';'))
        };
        let length = match lines[first..].iter().enumerate().position(ends) {
            Some(last) => last + 1,
            None => lines.len() - first,
        };
        if length > MOST_FUNCTION_LINES {
            list.push(format!("line {}: a function of {length} lines", first + 1));
        }
    }
    list
}

fn holds_any(text: &str, needles: &[String]) -> Vec<String> {
    let mut list = Vec::new();
    for (number, line) in text.lines().enumerate() {
        for needle in needles.iter().filter(|needle| line.contains(*needle)) {
            list.push(format!("line {}: {needle}", number + 1));
        }
    }
    list
}

fn top_level(paths: &[String]) -> Vec<String> {
    let found: BTreeSet<&str> = paths
        .iter()
        .filter_map(|path| path.split('/').next())
        .filter(|name| !name.starts_with('.'))
        .collect();
    let wanted = BTreeSet::from(TOP_LEVEL);
    let extra = found.difference(&wanted).map(|name| format!("{name} is new"));
    let missing = wanted.difference(&found).map(|name| format!("{name} is missing"));
    extra.chain(missing).collect()
}

/// Names of the dependencies in a crate's `Cargo.toml`, of every kind.
fn dependencies(manifest: &str) -> BTreeSet<String> {
    let mut names = BTreeSet::new();
    let mut section = "";
    for line in manifest.lines().map(str::trim) {
        if let Some(name) = line.strip_prefix('[') {
            section = name.trim_end_matches(']');
            if let Some((_, name)) = section.split_once("dependencies.") {
                names.insert(name.to_string());
            }
        } else if section.ends_with("dependencies") && !line.is_empty() && !line.starts_with('#') {
            names.extend(line.split(['.', '=', ' ']).next().map(String::from));
        }
    }
    names
}

fn wrong_dependencies(allowed: &[&str], manifest: &str) -> Vec<String> {
    MAY_DEPEND_ON
        .iter()
        .map(|(name, _)| *name)
        .filter(|name| dependencies(manifest).contains(*name) && !allowed.contains(name))
        .map(|name| format!("depends on {name}"))
        .collect()
}

/// The part of a Markdown text from a heading of the second level to the next.
fn section<'a>(markdown: &'a str, heading: &str) -> &'a str {
    let start = format!("\n## {heading}\n");
    let (_, rest) = markdown
        .split_once(&start)
        .unwrap_or_else(|| panic!("the README has no section '{heading}'"));
    rest.split_once("\n## ").map_or(rest, |(body, _)| body)
}

/// What stands between backticks and looks like a path.
fn paths_in(markdown: &str) -> Vec<&str> {
    let quoted = markdown
        .lines()
        .flat_map(|line| line.split('`').skip(1).step_by(2));
    quoted
        .filter(|word| (word.contains('/') || word.ends_with(".rs")) && !word.contains(' '))
        .collect()
}

/// Names in backticks at the start of a table's rows.
fn first_column(markdown: &str) -> BTreeSet<String> {
    let rows = markdown.lines().filter_map(|line| line.strip_prefix("| `"));
    rows.filter_map(|row| row.split('`').next())
        .map(String::from)
        .collect()
}

fn dependency_table(readme: &str, used: &BTreeSet<String>) -> Vec<String> {
    let named = first_column(section(readme, "Dependencies"));
    let left_out = used.difference(&named).map(|name| format!("{name} is left out"));
    let unused = named.difference(used).map(|name| format!("{name} is not used"));
    left_out.chain(unused).collect()
}

fn test_commands(readme: &str) -> Vec<&str> {
    readme
        .lines()
        .filter(|line| line.starts_with("cargo test"))
        .collect()
}

// The rules on this repository.

#[test]
fn rust_files_are_introduced_and_short() {
    assert_none(&complaints(".rs", file_shape));
}

#[test]
fn functions_are_short() {
    assert_none(&complaints(".rs", function_lengths));
}

#[test]
fn nothing_is_left_for_later() {
    assert_none(&complaints("", |text| holds_any(text, &unfinished())));
}

#[test]
fn no_file_names_a_folder_of_a_machine() {
    assert_none(&complaints("", |text| holds_any(text, &machine_folders())));
}

#[test]
fn the_top_level_is_as_listed() {
    assert_none(&top_level(&files()));
}

#[test]
fn shared_needs_neither_std_nor_alloc() {
    assert!(read("shared/src/lib.rs").lines().any(|line| line == "#![no_std]"));
    let alloc = ["extern crate alloc".to_string()];
    for path in files().iter().filter(|path| path.starts_with("shared/")) {
        assert_none(&holds_any(&read(path), &alloc));
    }
}

#[test]
fn crates_depend_on_one_another_as_listed() {
    for (name, allowed) in MAY_DEPEND_ON {
        assert_none(&wrong_dependencies(allowed, &read(&format!("{name}/Cargo.toml"))));
    }
}

#[test]
fn every_path_of_the_code_map_exists() {
    let readme = read("README.md");
    let paths = paths_in(section(&readme, "Code map"));
    assert!(paths.len() > 10, "the code map has paths");
    for path in paths {
        assert!(
            root().join(path).exists(),
            "the code map names {path}, which does not exist"
        );
    }
}

#[test]
fn the_readme_names_every_dependency() {
    let mut used = BTreeSet::new();
    for (name, _) in MAY_DEPEND_ON {
        used.extend(dependencies(&read(&format!("{name}/Cargo.toml"))));
    }
    used.retain(|name| MAY_DEPEND_ON.iter().all(|(ours, _)| ours != name));
    assert_none(&dependency_table(&read("README.md"), &used));
}

#[test]
fn the_checks_run_the_readmes_test_command() {
    let (readme, checks) = (read("README.md"), read(".ci/run"));
    let commands = test_commands(&readme);
    assert_eq!(commands.len(), 1, "the README has one test command: {commands:?}");
    assert!(
        checks.lines().any(|line| line == format!("step {}", commands[0])),
        ".ci/run does not run '{}'",
        commands[0]
    );
}

// Samples that break the rules.

#[test]
fn a_bad_file_is_found() {
    let long = format!("//! Fine.\n{}", "\n".repeat(MOST_FILE_LINES));
    assert!(file_shape("//! Fine.\n").is_empty());
    assert_eq!(file_shape("use std::fmt;\n").len(), 1);
    assert_eq!(file_shape(&long), [format!("{} lines", MOST_FILE_LINES + 1)]);
}

#[test]
fn a_long_function_is_found_and_a_short_one_is_not() {
    let function = |lines: usize| {
        let body = "        if a {\n        }\n".repeat((lines - 4) / 2);
        format!(
            "impl A {{\n    fn no_body();\n    pub(crate) const fn a(\n    ) {{\n{body}        end()\n    }}\n}}\n"
        )
    };
    assert!(function_lengths(&function(MOST_FUNCTION_LINES)).is_empty());
    let found = function_lengths(&function(MOST_FUNCTION_LINES + 2));
    assert_eq!(
        found,
        [format!("line 3: a function of {} lines", MOST_FUNCTION_LINES + 2)]
    );
    let one_liners = "fn a() {}\n".repeat(MOST_FUNCTION_LINES + 1);
    assert!(function_lengths(&one_liners).is_empty());
    assert!(!starts_function("// about fn names"));
}

#[test]
fn a_forbidden_word_is_found() {
    let sample = format!("fine\n{} later\n", unfinished()[2]);
    assert_eq!(holds_any(&sample, &unfinished()).len(), 1);
    let sample = format!("see {}me/x and /tmp/x", machine_folders()[0]);
    assert_eq!(holds_any(&sample, &machine_folders()).len(), 1);
    assert!(holds_any("/tmp/iceoryx2", &machine_folders()).is_empty());
}

#[test]
fn a_stray_or_missing_top_level_name_is_found() {
    let mut paths: Vec<String> = TOP_LEVEL.map(String::from).to_vec();
    paths.push(".ci/run".into());
    assert!(top_level(&paths).is_empty());
    paths[0] = "notes.txt".into();
    assert_eq!(top_level(&paths), ["notes.txt is new", "CHANGELOG.md is missing"]);
}

#[test]
fn a_wrong_dependency_is_found() {
    let manifest = "[package]\nname = \"a\"\n\n[dependencies]\nshared.workspace = true\n\n\
                    [dev-dependencies]\noffline = { path = \"../offline\" }\n\n[dependencies.libc]\nversion = \"0\"\n";
    let names = ["libc", "offline", "shared"].map(String::from);
    assert_eq!(dependencies(manifest), BTreeSet::from(names));
    assert_eq!(wrong_dependencies(&["shared"], manifest), ["depends on offline"]);
}

#[test]
fn a_gap_in_the_readme_is_found() {
    let readme = "# A\n\n## Code map\n\n| `a/b.rs`, `c.rs` | `a` word |\n\n## Dependencies\n\n| `x` | why |\n| `y` | why |\n";
    assert_eq!(paths_in(section(readme, "Code map")), ["a/b.rs", "c.rs"]);
    let used = BTreeSet::from(["x", "z"].map(String::from));
    assert_eq!(
        dependency_table(readme, &used),
        ["z is left out", "y is not used"]
    );
    assert_eq!(test_commands("cargo test -q\n"), ["cargo test -q"]);
}
