//! Where something stands in a TOML text: errors name the line.

use toml::de::{DeTable, DeValue};

/// Line, counted from 1, of the byte `offset`.
pub fn line_at(text: &str, offset: usize) -> usize {
    1 + text.bytes().take(offset).filter(|byte| *byte == b'\n').count()
}

/// Line, counted from 1, of the value at `path`, such as `rope.length_m` or `clamps.0.end`; where the text
/// leaves it out, of the innermost table around it that is there.
pub fn line_of(text: &str, path: &str) -> Option<usize> {
    let root = DeTable::parse(text).ok()?;
    let root = DeValue::Table(root.into_inner());
    let mut line = None;
    let mut here = &root;
    for part in path.split('.') {
        let next = match part.parse::<usize>() {
            Ok(index) => here.get(index),
            Err(_) => here.get(part),
        };
        let Some(next) = next else { break };
        line = Some(line_at(text, next.span().start));
        here = next.get_ref();
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "noise_m = 0.1\nrope = { length_m = 1.0 }\n[table]\nheight_m = 0.0\n\n\
                        [[clamps]]\nend = \"start\"\n[[clamps]]\nend = \"end\"\n";

    #[test]
    fn values_are_found_at_their_lines() {
        for (path, line) in [
            ("noise_m", 1),
            ("rope.length_m", 2),
            ("table.height_m", 4),
            ("clamps.0.end", 7),
            ("clamps.1.end", 9),
        ] {
            assert_eq!(line_of(TEXT, path), Some(line), "{path}");
        }
    }

    #[test]
    fn what_is_left_out_is_missed_at_the_table_around_it() {
        for (path, line) in [
            ("rope.mass_kg", Some(2)),
            ("table.friction", Some(3)),
            ("clamps.1.direction", Some(8)),
            ("start", None),
        ] {
            assert_eq!(line_of(TEXT, path), line, "{path}");
        }
        assert_eq!(line_of("", "noise_m"), None);
    }
}
