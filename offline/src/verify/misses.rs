//! Cases that miss their tolerance, with the cause. The tolerance stays, the case stays a failure, and a
//! test keeps the list of the quick extent equal to what fails: neither a new miss nor a mended one goes
//! unseen.

use super::case::Case;

/// Start of the case's name, and why it misses.
pub const MISSES: [(&str, &str); 1] = [(
    "no slip: clamped rope moves",
    "what of the nodes' motion the particles do not see comes to its rest as slowly as it is weakly held, over \
     seconds",
)];

/// Quantities of the full extent whose order of convergence is too low.
pub const ORDERS: [&str; 4] = [
    "sag of a cantilever",
    "elastica",
    "bending stiffness, mode 1",
    "pendulum period of a soft rope",
];
/// Why.
const ORDER: &str = "the coarsest grid is already within 1.3 %, so that alignments and the particles' sampling \
                     decide what is left on the finest: for the cantilever, the elastica and the pendulum \
                     the give of the clamp, for the bending stiffness half a percent";

/// The cause of a case's miss, if it is known.
pub fn known(case: &Case) -> Option<&'static str> {
    if case.passed {
        return None;
    }
    let starts = |start: &&str| case.name.starts_with(*start);
    if case.name.ends_with("order of convergence") && ORDERS.iter().any(&starts) {
        return Some(ORDER);
    }
    let found = MISSES.iter().find(|(start, _)| starts(start));
    found.map(|(_, cause)| *cause)
}
