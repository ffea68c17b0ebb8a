//! The verdict on a residual, with the reasons for caution.

use crate::effects;
use crate::model::Estimate;
use crate::words::{with_error, with_unit};
use serde::{Deserialize, Serialize};
use std::fmt;

/// What the loop concludes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "verdict", rename_all = "snake_case")]
pub enum Verdict {
    /// The base model leaves nothing but noise.
    NothingMissing,
    /// These effects were missing; with their parameters.
    Explained {
        /// Names of the effects in the order in which they were found.
        effects: Vec<String>,
        /// Their parameters.
        parameters: Vec<Estimate>,
    },
    /// These data cannot tell the listed effects apart.
    Confounded {
        /// Names of effects that all models have between which the data cannot choose.
        #[serde(default)]
        found: Vec<String>,
        /// Names of the effects that are alike.
        effects: Vec<String>,
        /// The demonstration that would separate them.
        separating_demonstration: String,
    },
    /// Something is missing that is not in the library, or that the gates do not let pass.
    Unexplained {
        /// Where and when the residual is largest, as a hint.
        hint: String,
    },
}

/// A reason for caution.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
pub enum ReasonCode {
    /// A part of the excess over the noise is left.
    Partial,
    /// The best effect may stand in for another.
    ProxySuspected,
    /// More is left where held out than noise, the simulation's own error and the parameters' errors amount to.
    HeldOutLeft,
    /// What is left is of the size of the discretisation error.
    Numerical,
    /// The noise was declared, not measured.
    NoPureError,
    /// One demonstration: repeatability is untested.
    OneDemonstration,
    /// No other demonstration was held out; blocks of frames of the same were, or every third of its poses at rest.
    HeldOutInTime,
    /// A further round could not be simulated.
    RoundStopped,
    /// A part of what was missing is the camera's or the clock's.
    Sensor,
    /// Effects that could move the swing may be there, and these data would probably not have shown them.
    Underpowered,
}

impl fmt::Display for ReasonCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Partial => "PARTIAL: a part of the excess over the noise is left",
            Self::ProxySuspected => "PROXY SUSPECTED: the best effect may stand in for another",
            Self::HeldOutLeft => {
                "HELD OUT LEFT: where held out more is left than noise and what is known to be uncertain"
            }
            Self::Numerical => {
                "NUMERICAL: what is left is of the size of the discretisation error, for which the standard errors allow"
            }
            Self::NoPureError => "NO PURE ERROR: neither frames at rest nor a repeated recording measured the noise: it is as declared, or as points jitter",
            Self::OneDemonstration => "ONE DEMONSTRATION: fitted on one motion, repeatability is untested",
            Self::HeldOutInTime => {
                "HELD OUT IN TIME: checked on frames of the same demonstration that were not fitted"
            }
            Self::RoundStopped => {
                "ROUND STOPPED: a further round could not be simulated, what it would have found is not known"
            }
            Self::Sensor => {
                "SENSOR: a part of what was missing is the camera's or the clock's, not the rope's"
            }
            Self::Underpowered => {
                "UNDERPOWERED: effects that matter for the swing may be there, these data would probably not have shown them"
            }
        })
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NothingMissing => {
                f.write_str("nothing missing: what is left is noise or the simulation's own error")
            }
            Self::Explained { effects, parameters } => {
                write!(f, "explained: {}", effects.join(" and "))?;
                for p in parameters {
                    write!(
                        f,
                        "; {} = {}",
                        p.name,
                        with_unit(&with_error(p.value, p.standard_error), &p.unit)
                    )?;
                    if !p.identified {
                        f.write_str(" (not identified)")?;
                    }
                }
                for words in effects.iter().filter_map(|id| size_in_words(id, parameters)) {
                    write!(f, "; that is {words}")?;
                }
                Ok(())
            }
            Self::Confounded {
                found,
                effects,
                separating_demonstration,
            } => {
                let besides = if found.is_empty() {
                    String::new()
                } else {
                    format!("{} found; besides, ", found.join(" and "))
                };
                write!(
                    f,
                    "confounded: {besides}{} fit equally well; {separating_demonstration}",
                    effects.join(" or ")
                )
            }
            Self::Unexplained { hint } => write!(f, "unexplained: {hint}"),
        }
    }
}

/// The size of an effect of the registry, where people call it something else than its parameters.
pub fn size_in_words(id: &str, parameters: &[Estimate]) -> Option<String> {
    let spec = &effects::ALL[effects::find(id)?];
    let value = |name: &str| {
        let mut of_effect = parameters
            .iter()
            .filter(|p| p.name.split_once('.') == Some((id, name)));
        of_effect.next().map(|p| p.value)
    };
    let values: Option<Vec<f64>> = spec.parameters.iter().map(|p| value(p.name)).collect();
    spec.in_words(&values?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_that_the_data_do_not_tell_is_said_to_be_none() {
        let parameter = |name: &str, identified| Estimate {
            name: name.into(),
            unit: "kg".into(),
            value: 0.5,
            standard_error: 0.35,
            identified,
        };
        let verdict = Verdict::Explained {
            effects: vec!["tip_mass".into()],
            parameters: vec![parameter("told", true), parameter("open", false)],
        };
        assert_eq!(
            verdict.to_string(),
            "explained: tip_mass; told = 0.50 ± 0.35 kg; open = 0.50 ± 0.35 kg (not identified)"
        );
    }

    #[test]
    fn wind_and_yield_are_said_in_what_people_call_them() {
        let parameter = |name: &str, value: f64| Estimate {
            name: name.into(),
            unit: "1".into(),
            value,
            standard_error: 1.0,
            identified: true,
        };
        let verdict = Verdict::Explained {
            effects: vec!["steady_wind".into(), "yield".into()],
            parameters: vec![
                parameter("steady_wind.toward_x_m2_s2", 12.0),
                parameter("steady_wind.toward_y_m2_s2", -16.0),
                parameter("yield.one_over_strain", 50.0),
            ],
        };
        let words = verdict.to_string();
        let expected = "; that is a wind of (2.68, -3.58) m/s; that is a yield strain of 0.0200";
        assert!(words.ends_with(expected), "{words}");
    }
}
