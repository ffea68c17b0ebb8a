//! Numbers as people read them.

/// Value ± standard error, both rounded to two significant digits of the error.
pub fn with_error(value: f64, error: f64) -> String {
    if !error.is_finite() || error <= 0.0 {
        return format!("{} ± unknown", significant(value));
    }
    let last = error.log10().floor() - 1.0;
    let digits = (-last).clamp(0.0, 9.0) as usize;
    // Digits before the point that the error does not allow are zeros.
    let place = 10f64.powf(last);
    let [value, error] = [value, error].map(|x| {
        if last > 0.0 {
            (x / place).round() * place
        } else {
            x
        }
    });
    let value = format!("{value:.digits$}");
    // Nothing has no sign.
    let nothing = value.chars().all(|c| "-0.".contains(c));
    let value = if nothing {
        value.trim_start_matches('-')
    } else {
        &value
    };
    format!("{value} ± {error:.digits$}")
}

/// From here on a number has a power of ten: nobody counts its zeros.
const COUNTED: f64 = 1e9;

/// A number with three significant digits.
pub fn significant(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    if value.abs() >= COUNTED {
        return format!("{value:.2e}");
    }
    let digits = (2.0 - value.abs().log10().floor()).clamp(0.0, 9.0) as usize;
    format!("{value:.digits$}")
}

/// A unit for people: nothing for a pure number.
pub fn unit(unit: &str) -> &str {
    if unit == "1" { "" } else { unit }
}

/// The same, behind a number.
pub fn with_unit(number: &str, unit: &str) -> String {
    format!("{number} {}", self::unit(unit)).trim_end().to_owned()
}

/// A duration, rounded: "40 s", "12 min", "2.5 h".
pub fn duration(seconds: f64) -> String {
    let minutes = seconds / 60.0;
    if seconds < 99.5 {
        format!("{seconds:.0} s")
    } else if minutes < 99.5 {
        format!("{minutes:.0} min")
    } else {
        format!("{:.1} h", minutes / 60.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_show_what_is_worth_knowing() {
        let all = [0.2, 99.0, 100.0, 5900.0, 9000.0].map(duration);
        assert_eq!(all, ["0 s", "99 s", "2 min", "98 min", "2.5 h"]);
    }

    #[test]
    fn numbers_show_the_digits_that_their_error_allows() {
        assert_eq!(with_error(0.73146, 0.0042), "0.7315 ± 0.0042");
        assert_eq!(with_error(731.46, 42.0), "731 ± 42");
        assert_eq!(with_error(889_213.0, 17_240.0), "889000 ± 17000");
        assert_eq!(with_error(0.73146, f64::INFINITY), "0.731 ± unknown");
        assert_eq!(with_error(-0.00001, 0.0021), "0.0000 ± 0.0021");
        assert_eq!(with_error(-0.0062, 0.0021), "-0.0062 ± 0.0021");
    }

    #[test]
    fn a_pure_number_has_no_unit() {
        assert_eq!(with_unit("0.30 ± 0.10", "1"), "0.30 ± 0.10");
        assert_eq!(with_unit("8.8 ± 0.1", "g"), "8.8 ± 0.1 g");
    }
}
