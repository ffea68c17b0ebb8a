//! Cases that miss their tolerance, with the cause. The tolerance stays, the case stays a failure, and a
//! test keeps the list of the quick extent equal to what fails: neither a new miss nor a mended one goes
//! unseen.

use super::case::Case;

/// Start of the case's name, and why it misses.
pub const MISSES: [(&str, &str); 2] = [
    (
        "no hinge: tip sinks",
        "the springs of a clamp act through particles that share nodes; what of their gaps the nodes hardly \
         reach closes over seconds, by some micrometres",
    ),
    ("no slip: clamped rope moves", "the same relaxation"),
];

/// Quantities of the full extent whose order of convergence is too low.
pub const ORDERS: [&str; 3] = ["sag of a cantilever", "elastica", "pendulum"];
/// Why: presumably, because the give of the clamp was not measured apart from the rest.
const ORDER: &str = "with the clamp's edge in the middle of a cell the coarsest grid is already as close as \
                     the finest (within 0.7 % at the program's own alignment, 1.7 % at the worst); what \
                     remains is presumably the give of the clamp's springs, which falls slowly";

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
