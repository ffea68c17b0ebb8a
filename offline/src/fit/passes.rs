//! Which simulations differentiate θ: tangents in groups as large as a pass carries, secants where a parameter has no
//! useful tangent ([`Slope`]), none for what only changes what the cameras report; and how passes share idle threads.

use super::kinds::changes_material;
use crate::effects::{self, Slope};
use crate::model::Structure;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Most tangents of one pass.
pub(super) const MAX_TANGENTS: usize = 12;

/// Simulations that give some columns of the Jacobian.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Pass {
    /// Tangents with respect to these entries of θ.
    Tangents(Vec<usize>),
    /// The change from `from` to `to` of one entry of θ.
    Secant {
        /// The entry.
        column: usize,
        /// Its value before.
        from: f64,
        /// Its value after.
        to: f64,
    },
}

impl Pass {
    /// The entries of θ that it differentiates.
    pub(super) fn columns(&self) -> &[usize] {
        match self {
            Self::Tangents(columns) => columns,
            Self::Secant { column, .. } => std::slice::from_ref(column),
        }
    }
}

/// How all entries of θ are differentiated.
pub(super) struct Plan {
    /// What is simulated.
    pub(super) passes: Vec<Pass>,
    /// Entries that only change what is seen.
    pub(super) seen: Vec<usize>,
}

/// Entries of θ that only change what is seen, and are not held.
pub(super) fn only_seen(structure: &Structure, theta: &[f64], held: &[bool]) -> Vec<usize> {
    plan(structure, theta, held).seen
}

/// The passes that θ needs; entries that are `held` need none.
pub(super) fn plan(structure: &Structure, theta: &[f64], held: &[bool]) -> Plan {
    let specs = structure.effects.iter().flat_map(|&e| {
        let parameters = effects::ALL[e].parameters.iter();
        parameters.map(move |p| (p, e))
    });
    let mut tangents: Vec<usize> = (0..theta.len() - specs.clone().count()).collect();
    let (mut slow, mut secants, mut seen) = (Vec::new(), Vec::new(), Vec::new());
    for ((spec, effect), column) in specs.zip(tangents.len()..) {
        if held[column] {
            continue;
        }
        if effects::ALL[effect].only_seen {
            seen.push(column);
            continue;
        }
        let value = theta[column];
        let step = spec.smallest_of_interest;
        let secant = match spec.slope {
            Slope::Tangent => false,
            Slope::SecantNearZero => (value - spec.vanishes_at).abs() < step,
            Slope::Secant => true,
        };
        if secant {
            secants.push(Pass::Secant {
                column,
                from: (value - step).max(spec.low),
                to: (value + step).min(spec.high),
            });
        } else if changes_material(effect) && vanishes(structure, theta, effect) {
            slow.push(column);
        } else {
            tangents.push(column);
        }
    }
    tangents.retain(|&column| !held[column]);
    // The prediction itself comes with the first of these.
    let mut passes = vec![Pass::Tangents(Vec::new())];
    if !tangents.is_empty() {
        passes = balanced(&tangents).collect();
    }
    passes.extend(balanced(&slow));
    passes.extend(secants);
    Plan { passes, seen }
}

/// Whether an effect of a structure does nothing at θ.
pub(super) fn vanishes(structure: &Structure, theta: &[f64], effect: usize) -> bool {
    let own = effects::ALL[effect].parameters.iter();
    own.zip(&theta[structure.entries(effect)])
        .all(|(p, &value)| value == p.vanishes_at)
}

/// Passes of nearly the same size.
fn balanced(columns: &[usize]) -> impl Iterator<Item = Pass> {
    let groups = columns.len().div_ceil(MAX_TANGENTS).max(1);
    let size = columns.len().div_ceil(groups).max(1);
    columns.chunks(size).map(|c| Pass::Tangents(c.to_vec()))
}

/// Passes that are planned and not done, of all fits at once.
static BUSY: AtomicUsize = AtomicUsize::new(0);

/// So many passes more, until it is dropped.
pub(super) struct Busy(usize);

impl Busy {
    pub(super) fn with(passes: usize) -> Self {
        BUSY.fetch_add(passes, Ordering::Relaxed);
        Self(passes)
    }

    /// How many threads there are for each such pass; other work, such as predictions, is not counted.
    pub(super) fn threads_each(&self) -> usize {
        rayon::current_num_threads() / BUSY.load(Ordering::Relaxed).max(1)
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        BUSY.fetch_sub(self.0, Ordering::Relaxed);
    }
}

/// The same passes with each one's tangents spread over so many threads. A tangent has the same bits whichever others
/// its pass carries; the prediction itself is made in each, which costs what one tangent does.
pub(super) fn spread(passes: &[Pass], threads: usize) -> Vec<Pass> {
    let parts = |pass: &Pass| match pass {
        Pass::Tangents(columns) if columns.len() > 1 && threads > 1 => {
            let size = columns.len().div_ceil(threads);
            columns.chunks(size).map(|c| Pass::Tangents(c.to_vec())).collect()
        }
        whole => vec![whole.clone()],
    };
    passes.iter().flat_map(parts).collect()
}
