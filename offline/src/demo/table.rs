//! Comma-separated tables with named columns and line numbers, as the demo folder holds them.

use super::DemoError;
use std::path::{Path, PathBuf};

/// A table in which row `i` stands at line `i + 2` of its file (line 1 is the header).
pub(super) struct Table {
    file: PathBuf,
    columns: Vec<String>,
    rows: Vec<Vec<String>>,
}

/// Line of row `row` (counted from 0) in a table file.
pub(super) fn line_of_row(row: usize) -> usize {
    row + 2
}

impl Table {
    /// Reads `file`, whose columns must be all of `required` and any of `optional`, in any order.
    pub(super) fn read(file: &Path, required: &[&str], optional: &[&str]) -> Result<Self, DemoError> {
        let text = std::fs::read_to_string(file).map_err(|e| DemoError::io(file, "reading", &e))?;
        if text.trim().is_empty() {
            let columns = format!("begin with a line that names the columns {}", required.join(","));
            return Err(DemoError::new(file, "it is empty", columns));
        }
        if text.contains('\r') && !text.contains('\n') {
            let remedy = "save it with lines that end in LF or CR LF";
            return Err(DemoError::new(file, "its lines end in CR alone", remedy));
        }
        if !text.ends_with('\n') {
            let line = text.lines().count();
            return Err(DemoError::new(
                file,
                "the last line does not end, so the file may be cut short",
                "copy the file again, or add the missing newline if it is whole",
            )
            .at(line));
        }
        let mut lines = text.lines();
        let header = lines.next().unwrap_or_default().trim_start_matches('\u{feff}');
        let columns = split(header);
        check_columns(file, &columns, required, optional)?;
        let mut rows = Vec::new();
        for (row, line) in lines.enumerate() {
            let cells = split(line);
            if cells.len() != columns.len() {
                return Err(DemoError::new(
                    file,
                    format!("{} values in {} columns", cells.len(), columns.len()),
                    "complete or delete the row",
                )
                .at(line_of_row(row)));
            }
            rows.push(cells);
        }
        if rows.is_empty() {
            return Err(DemoError::new(
                file,
                "there are no rows",
                "record at least one row",
            ));
        }
        Ok(Self {
            file: file.to_path_buf(),
            columns,
            rows,
        })
    }

    /// Number of rows.
    pub(super) fn len(&self) -> usize {
        self.rows.len()
    }

    /// Whether the file has a column of this name.
    pub(super) fn has(&self, column: &str) -> bool {
        self.columns.iter().any(|c| c == column)
    }

    /// The text in a cell; the column is known to exist.
    pub(super) fn text(&self, row: usize, column: &str) -> &str {
        let index = self.columns.iter().position(|c| c == column);
        index.map_or("", |index| &self.rows[row][index])
    }

    /// The finite number in a cell.
    pub(super) fn number(&self, row: usize, column: &str) -> Result<f64, DemoError> {
        let text = self.text(row, column);
        match text.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            Ok(_) => Err(self.error(
                row,
                format!("{column} is {text}"),
                "delete the row or measure again",
            )),
            Err(_) => Err(self.error(
                row,
                format!("{column} is '{text}', not a number"),
                "write a decimal number with a point",
            )),
        }
    }

    /// The truth value in a cell.
    pub(super) fn flag(&self, row: usize, column: &str) -> Result<bool, DemoError> {
        match self.text(row, column) {
            "1" | "true" => Ok(true),
            "0" | "false" => Ok(false),
            text => Err(self.error(
                row,
                format!("{column} is '{text}'"),
                "write 1 (holds) or 0 (open)",
            )),
        }
    }

    /// An error at a row.
    pub(super) fn error(&self, row: usize, problem: impl Into<String>, remedy: &str) -> DemoError {
        DemoError::new(&self.file, problem, remedy).at(line_of_row(row))
    }
}

fn split(line: &str) -> Vec<String> {
    line.split(',').map(|cell| cell.trim().to_owned()).collect()
}

fn check_columns(
    file: &Path,
    columns: &[String],
    required: &[&str],
    optional: &[&str],
) -> Result<(), DemoError> {
    let expected = || {
        let all: Vec<&str> = required.iter().chain(optional).copied().collect();
        format!("the first line names the columns {}", all.join(","))
    };
    for (index, column) in columns.iter().enumerate() {
        let known = required.contains(&column.as_str()) || optional.contains(&column.as_str());
        if !known {
            return Err(DemoError::new(file, format!("unknown column '{column}'"), expected()).at(1));
        }
        if columns[..index].contains(column) {
            return Err(DemoError::new(file, format!("column '{column}' stands twice"), expected()).at(1));
        }
    }
    for name in required {
        if !columns.iter().any(|c| c == name) {
            return Err(DemoError::new(file, format!("column '{name}' is missing"), expected()).at(1));
        }
    }
    let given = optional
        .iter()
        .filter(|name| columns.iter().any(|c| c == *name))
        .count();
    if given != 0 && given != optional.len() {
        let problem = format!("{given} of the columns {}", optional.join(","));
        return Err(DemoError::new(file, problem, "give all of them or none").at(1));
    }
    Ok(())
}
