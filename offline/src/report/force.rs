//! What nothing explains, as a force along the rope over time.

use super::page::{hex, sentence};
use crate::diagnose::{DemoForce, ResidualForce, STABLE, TermShare};
use crate::fit::KNOTS;
use crate::plot::ramp;
use crate::sim::tensor::norm;
use maud::{Markup, html};

/// Shares of the colour scale: darker colours would hide the numbers.
const SCALE: [f64; 2] = [0.45, 1.0];

pub(super) fn section(force: Option<&ResidualForce>) -> Markup {
    html! {
        @if let Some(force) = force {
            h2 { "What is left, as a force" }
            p { b { (sentence(&force.in_words)) } }
            p.quiet {
                "The smoothest force along the rope that takes away what any force takes away, or all but noise; found "
                "to first order, and the share that it takes away by simulating the rope under it. A camera that moves or a "
                "clock that runs late can pass for a force."
            }
            @if force.explains() {
                @for demo in &force.demos { (forces(demo)) }
                (terms(&force.terms))
            }
        }
    }
}

/// Sizes by arc length and time; the end of the rope is on top.
fn forces(demo: &DemoForce) -> Markup {
    let sizes = demo.force_n_m.iter().flatten().map(|&force| norm(force));
    let largest = sizes.fold(0.0, f64::max);
    let colour = |n_m: f64| {
        let share = if largest > 0.0 { n_m / largest } else { 0.0 };
        hex(ramp(SCALE[0] + share * (SCALE[1] - SCALE[0])))
    };
    html! {
        h3 { (demo.demo) ": N/m by arc length and time" }
        table {
            @for knot in (0..KNOTS).rev() {
                tr {
                    th { (format!("{:.2} m", demo.knots_m[knot])) }
                    @for block in &demo.force_n_m {
                        td.n style=(format!("background:{}", colour(norm(block[knot])))) {
                            (format!("{:.2}", norm(block[knot])))
                        }
                    }
                }
            }
            tr {
                th { "around" }
                @for block in 0..demo.force_n_m.len() {
                    th.n { (format!("{:.1} s", demo.middle_s(block))) }
                }
            }
        }
    }
}

fn terms(terms: &[TermShare]) -> Markup {
    html! {
        table {
            tr { th { "law that may describe it" } th.n { "among the best in halves of the data" } }
            @for term in terms.iter().filter(|term| term.share > 0.0) {
                tr.best[term.share > STABLE] {
                    td { (term.words) }
                    td.n { (format!("{:.0} %", 100.0 * term.share)) }
                }
            }
        }
    }
}
