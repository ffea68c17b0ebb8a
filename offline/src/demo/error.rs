//! What is wrong with a demonstration, where, and what to do: always one line of text.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// A demonstration that cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}{}: {problem}; {remedy}", file.display(), at_line(*line))]
pub struct DemoError {
    /// The file or folder.
    pub file: PathBuf,
    /// Line in the file, counted from 1, where there is one.
    pub line: Option<usize>,
    /// What is wrong.
    pub problem: String,
    /// What to do about it.
    pub remedy: String,
}

impl DemoError {
    /// An error about a whole file.
    pub(super) fn new(file: &Path, problem: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self {
            file: file.to_path_buf(),
            line: None,
            problem: one_line(problem.into()),
            remedy: one_line(remedy.into()),
        }
    }

    /// The same error at a line of the file, counted from 1.
    pub(super) fn at(mut self, line: usize) -> Self {
        self.line = Some(line);
        self
    }

    /// A failure to read.
    pub(super) fn io(file: &Path, doing: &str, error: &std::io::Error) -> Self {
        let remedy = match error.kind() {
            ErrorKind::NotFound | ErrorKind::NotADirectory => "check the path, or add the file",
            ErrorKind::PermissionDenied => "check the permissions",
            ErrorKind::InvalidData => "save the file as UTF-8 text",
            _ => "check the disk and the path",
        };
        Self::new(file, format!("{doing} failed ({error})"), remedy)
    }

    /// A failure to write.
    pub(super) fn unwritten(file: &Path, doing: &str, error: &std::io::Error) -> Self {
        let remedy = match error.kind() {
            ErrorKind::PermissionDenied => "check the permissions, or choose another folder",
            ErrorKind::StorageFull => "free some space",
            _ => "choose a folder that can be written to",
        };
        Self::new(file, format!("{doing} failed ({error})"), remedy)
    }
}

fn at_line(line: Option<usize>) -> String {
    line.map_or(String::new(), |line| format!(":{line}"))
}

/// Messages of other crates may span lines; ours never do.
fn one_line(text: String) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}
