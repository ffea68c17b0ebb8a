//! Parsers of command-line arguments, for the controller and for the examples: what is wrong is refused with
//! what would be right, before anything is done.

use crate::session::{Instance, SessionError};

/// A name that clients connect by.
pub fn instance(text: &str) -> Result<String, SessionError> {
    Instance::new(text).map(|instance| instance.name().to_string())
}

/// A parser of numbers from `least` to `most`.
pub fn number(least: f64, most: f64) -> impl Fn(&str) -> Result<f64, String> + Clone {
    move |text| match text.parse() {
        // Holds no NaN.
        Ok(value) if (least..=most).contains(&value) => Ok(value),
        _ => Err(format!("use a number from {least} to {most}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_numbers_of_the_range_pass() {
        let parse = number(-1.5, 10.0);
        for (text, value) in [("-1.5", -1.5), ("1e1", 10.0), ("0", 0.0)] {
            assert_eq!(parse(text), Ok(value));
        }
        for text in ["nan", "inf", "-inf", "1e30", "-1.51", "", "ten"] {
            assert_eq!(
                parse(text),
                Err("use a number from -1.5 to 10".to_string()),
                "{text}"
            );
        }
    }
}
