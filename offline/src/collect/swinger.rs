//! Something that can swing a rope, and why it may refuse.

use serde::{Deserialize, Serialize};

/// Something that can swing a rope: the simulator with its effects, or a stand-in in tests.
pub trait Swinger: Sync {
    /// The largest x in m that the tip reaches when a rope of modulus `young_pa` (Pa) and Poisson's
    /// ratio `poisson` is released at `release_m`, (x, z) in m. Equal arguments give equal bits.
    fn reach_m(&self, young_pa: f64, poisson: f64, release_m: [f64; 2]) -> Result<f64, SwingRefusal>;
}

/// Why a swing has no score.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, thiserror::Error)]
pub enum SwingRefusal {
    /// The rope does not reach the release point.
    #[error(
        "the release point is {distance_m:.3} m from the clamp, the rope reaches {length_m:.3} m; choose a nearer one"
    )]
    Unreachable {
        /// Distance from the clamp, m.
        distance_m: f64,
        /// What the rope reaches, m.
        length_m: f64,
    },
    /// The simulation stopped with an error.
    #[error("the simulation failed: {0}")]
    Failed(String),
    /// The rope is no rope for the task.
    #[error(
        "a rope of {length_m:.3} m hanging from the task's clamp lies on the table, and the swing is one of a tip that hangs \
         free: take one of at most {longest_m:.3} m"
    )]
    TooLong {
        /// Its length, m.
        length_m: f64,
        /// The longest of its thickness, m.
        longest_m: f64,
    },
}

impl SwingRefusal {
    /// The kind of refusal, for counting.
    pub fn reason(&self) -> &'static str {
        match self {
            Self::Unreachable { .. } => "unreachable release point",
            Self::Failed(_) => "simulation failed",
            Self::TooLong { .. } => "rope too long for the task",
        }
    }
}
