//! Text on one line, for messages that may hold several.

use core::fmt::{Display, Formatter, Result, Write};

/// Shows its content on one line: the end of a line becomes a space, an empty line a semicolon, indents go.
#[derive(Clone, Copy, Debug)]
pub struct OneLine<T>(pub T);

impl<T: Display> Display for OneLine<T> {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        let mut joiner = Joiner {
            out: f,
            ends: 0,
            spaces: 0,
            begun: false,
        };
        write!(joiner, "{}", self.0)
    }
}

/// Passes text on, holding back the white space until something follows it.
struct Joiner<'a, 'b> {
    out: &'a mut Formatter<'b>,
    /// Ends of lines held back.
    ends: usize,
    /// Other white space held back.
    spaces: usize,
    begun: bool,
}

impl Joiner<'_, '_> {
    fn join(&mut self) -> Result {
        let (ends, spaces) = (core::mem::take(&mut self.ends), core::mem::take(&mut self.spaces));
        match ends {
            _ if !self.begun => Ok(()),
            0 => (0..spaces).try_for_each(|_| self.out.write_char(' ')),
            1 => self.out.write_char(' '),
            _ => self.out.write_str("; "),
        }
    }
}

impl Write for Joiner<'_, '_> {
    fn write_str(&mut self, text: &str) -> Result {
        for letter in text.chars() {
            match letter {
                '\n' => self.ends += 1,
                _ if letter.is_whitespace() => self.spaces += 1,
                _ => {
                    self.join()?;
                    self.begun = true;
                    self.out.write_char(letter)?;
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::OneLine;
    use std::format;

    #[test]
    fn what_stands_on_several_lines_stands_on_one() {
        let of = |text: &str| format!("{}", OneLine(text));
        assert_eq!(of("plain  words"), "plain  words");
        assert_eq!(of("missing:\n  --demo <DIR>"), "missing: --demo <DIR>");
        assert_eq!(of("\nwrong\r\n\n\tUsage: x\n"), "wrong; Usage: x");
        assert_eq!(of(" \n"), "");
        assert_eq!(format!("{}", OneLine(format_args!("a{}c", "\nb "))), "a b c");
    }
}
