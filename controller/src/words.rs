//! The codes of messages as people and machines read them.

use shared::messages::{Phase, Reason};

/// A code that travelled, with what it means.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Words {
    /// The code.
    pub code: u32,
    /// Its name, as `controller/clients/README.md` lists it.
    pub name: String,
    /// What it means.
    pub text: &'static str,
    /// What to do about it; empty where nothing is.
    #[serde(skip_serializing_if = "str::is_empty")]
    pub remedy: &'static str,
}

impl Words {
    /// Of the code of a [`Reason`].
    pub fn of_reason(code: u32) -> Self {
        match Reason::from_code(code) {
            Some(reason) => Self {
                code,
                name: format!("{reason:?}"),
                text: reason.text(),
                remedy: reason.remedy(),
            },
            None => Self::unknown(code),
        }
    }

    /// Of the code of a [`Phase`].
    pub fn of_state(code: u32) -> Self {
        match Phase::from_code(code) {
            Some(phase) => Self {
                code,
                name: format!("{phase:?}"),
                text: phase.text(),
                remedy: "",
            },
            None => Self::unknown(code),
        }
    }

    fn unknown(code: u32) -> Self {
        Self {
            code,
            name: "Unknown".to_string(),
            text: "a code that this version does not know",
            remedy: "build controller and client from one version",
        }
    }

    /// A whole sentence about a reason: meaning, code and remedy.
    pub fn advice(&self) -> String {
        let reason = format!("{} (reason {})", self.text, self.code);
        if self.remedy.is_empty() {
            reason
        } else {
            format!("{reason}; {}", self.remedy)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn advice_ends_with_the_remedy_where_there_is_one() {
        let advice = |code| Words::of_reason(code).advice();
        assert_eq!(
            advice(Reason::Busy.code()),
            "another goal is being served (reason 20); wait for `finished_goal_id`, or cancel"
        );
        assert_eq!(
            advice(Reason::Cancelled.code()),
            "cancelled by a client (reason 45)"
        );
        assert!(advice(99).contains("one version"));
        assert_eq!(Words::of_state(Phase::Idle.code()).name, "Idle");
    }
}
