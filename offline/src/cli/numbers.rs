//! Numbers of the command line: what is out of range is wrong use, and clap says so with the range.

use clap::builder::RangedU64ValueParser;
use std::ops::RangeBounds;

/// A number that is neither infinite nor NaN.
pub fn finite(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if number.is_finite() => Ok(number),
        _ => Err("give a finite number".into()),
    }
}

/// A number above zero.
pub fn above_zero(text: &str) -> Result<f64, String> {
    match finite(text) {
        Ok(number) if number > 0.0 => Ok(number),
        _ => Err("give a number above 0".into()),
    }
}

/// A number from `low` to `high`.
pub fn within([low, high]: [f64; 2]) -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync + 'static {
    move |text: &str| match text.parse::<f64>() {
        Ok(number) if (low..=high).contains(&number) => Ok(number),
        _ => Err(format!("give a number from {low} to {high}")),
    }
}

/// A count in a range.
pub fn count(range: impl RangeBounds<u64>) -> RangedU64ValueParser<usize> {
    RangedU64ValueParser::new().range(range)
}

/// Threads: more than any machine has are a typing error.
pub fn threads() -> RangedU64ValueParser<usize> {
    count(1..=1024)
}
