//! Cases that miss their tolerance, with the cause. The tolerance stays, the case stays a failure, and a
//! test keeps this list equal to what fails: neither a new miss nor a mended one goes unseen.

use super::case::Case;

/// Start of the case's name, and why it misses.
pub const MISSES: [(&str, &str); 4] = [
    (
        "energy without damping, loss per period",
        "each step's transfer through the particles drops what of a velocity field is not affine within a \
         cell; the loss falls with the spacing",
    ),
    (
        "stretch of a hanging rope",
        "the kernel finds a clamp's edge to half a cell, so half a cell of clamped rope stretches with the \
         rest; 2.7 % at the program's own alignment, which is within the tolerance",
    ),
    (
        "no hinge: tip sinks",
        "motions of the nodes that no particle carries are dropped every step and relax over seconds, by \
         some 0.05 mm in all",
    ),
    ("no slip: clamped rope moves", "the same relaxation"),
];

/// The cause of a case's miss, if it is known.
pub fn known(case: &Case) -> Option<&'static str> {
    let found = MISSES.iter().find(|(start, _)| case.name.starts_with(start));
    found.filter(|_| !case.passed).map(|(_, cause)| *cause)
}
