//! Which simple laws describe a force: each law's field is pushed through the slopes of what is measured, and stability
//! selection (Meinshausen and Bühlmann 2010) counts how often it is among the best on half of the data.

use super::BLOCKS;
use super::estimate::Estimated;
use super::motion::Motion;
use crate::collect::stream;
use crate::fit::KNOTS;
use crate::sim::physics::GRAVITY_M_S2;
use crate::sim::tensor::{Vec3, dot, norm, scaled, sub};
use nalgebra::{DMatrix, DVector};
use rand::seq::SliceRandom;
use serde::{Deserialize, Serialize};

/// Halves of the data.
const HALVES: usize = 100;
/// Share of the halves above which a law counts as stable.
pub const STABLE: f64 = 0.8;
/// Most laws that describe one half.
const MOST_TERMS: usize = 3;
/// Share of what is left above the noise that another law has to take away.
const WORTH: f64 = 0.1;
/// Random streams of the halves lie above those of rollouts, training and evaluation.
const FIRST_STREAM: u64 = 1 << 52;
/// Speed from which on the rope slides, m/s.
const SLIDES_M_S: f64 = 0.01;

/// A law, and how often it was among the best.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TermShare {
    /// Name.
    pub id: String,
    /// What it would be.
    pub words: String,
    /// Share of the halves of the data.
    pub share: f64,
}

struct Term {
    id: &'static str,
    words: &'static str,
    /// Fields of force, N/m per unit; as many as it has components.
    fields: fn(&Motion) -> Vec<Vec3<f64>>,
    components: usize,
}

const TERMS: [Term; 9] = [
    Term {
        id: "steady_sideways",
        words: "a steady sideways push, as wind or a tilt gives",
        fields: |_| vec![[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        components: 2,
    },
    Term {
        id: "mass",
        words: "more or less mass all along",
        fields: |m| vec![sub([0.0, 0.0, -GRAVITY_M_S2], m.acceleration_m_s2)],
        components: 1,
    },
    Term {
        id: "end_mass",
        words: "more or less mass at the end",
        fields: |m| {
            let there = if m.knot + 1 == KNOTS { 1.0 } else { 0.0 };
            vec![scaled(sub([0.0, 0.0, -GRAVITY_M_S2], m.acceleration_m_s2), there)]
        },
        components: 1,
    },
    Term {
        id: "velocity",
        words: "a force along the velocity",
        fields: |m| vec![m.velocity_m_s],
        components: 1,
    },
    Term {
        id: "velocity_squared",
        words: "a force that grows with the square of the speed across the rope",
        fields: |m| {
            let across = sub(m.velocity_m_s, scaled(m.tangent, dot(m.velocity_m_s, m.tangent)));
            vec![scaled(across, norm(across))]
        },
        components: 1,
    },
    Term {
        id: "bend",
        words: "a force across the bend, as another stiffness or tension gives",
        fields: |m| vec![m.curvature_per_m],
        components: 1,
    },
    Term {
        id: "bending",
        words: "a force with the change of the bend, as damping in the material gives",
        fields: |m| vec![m.bending_per_m_s],
        components: 1,
    },
    Term {
        id: "sliding",
        words: "a force along the sliding on the table",
        fields: |m| {
            let flat = [m.velocity_m_s[0], m.velocity_m_s[1], 0.0];
            let slides = if m.on_table {
                1.0 / (norm(flat) + SLIDES_M_S)
            } else {
                0.0
            };
            vec![scaled(flat, slides)]
        },
        components: 1,
    },
    Term {
        id: "beside_grip",
        words: "a steady force beside the grip",
        fields: |m| {
            let there = if m.knot == 0 { 1.0 } else { 0.0 };
            vec![[there, 0.0, 0.0], [0.0, there, 0.0], [0.0, 0.0, there]]
        },
        components: 3,
    },
];

/// Least squares of one block of time of one demonstration.
struct Part {
    hessian: DMatrix<f64>,
    gradient: DVector<f64>,
    square: f64,
    rows: f64,
}

/// Laws by how often they are among the best on halves of the blocks of all demonstrations.
pub(super) fn stable_terms(found: &[Estimated], seed: u64) -> Vec<TermShare> {
    let parts: Vec<Part> = found.iter().flat_map(parts_of).collect();
    let mut counts = [0; TERMS.len()];
    for half in 0..HALVES {
        let mut order: Vec<&Part> = parts.iter().collect();
        order.shuffle(&mut stream(seed, FIRST_STREAM + half as u64));
        order.truncate(parts.len().div_ceil(2));
        for term in best_terms(&order) {
            counts[term] += 1;
        }
    }
    let share = |(term, count): (&Term, usize)| TermShare {
        id: term.id.into(),
        words: term.words.into(),
        share: count as f64 / HALVES as f64,
    };
    let mut shares: Vec<TermShare> = TERMS.iter().zip(counts).map(share).collect();
    shares.sort_by(|a, b| b.share.total_cmp(&a.share));
    shares
}

/// What the laws do to what is measured, block by block.
fn parts_of(found: &Estimated) -> Vec<Part> {
    let columns: usize = TERMS.iter().map(|term| term.components).sum();
    let mut fields = DMatrix::zeros(3 * BLOCKS * KNOTS, columns);
    for (block, motions) in found.motions.iter().enumerate() {
        for (knot, motion) in motions.iter().enumerate() {
            let all = TERMS.iter().flat_map(|term| (term.fields)(motion));
            for (column, field) in all.enumerate() {
                for (k, component) in field.into_iter().enumerate() {
                    fields[(3 * (block * KNOTS + knot) + k, column)] = component;
                }
            }
        }
    }
    let seen = &found.slopes * fields;
    (0..BLOCKS)
        .map(|block| {
            let rows: Vec<usize> = (0..seen.nrows()).filter(|&i| found.blocks[i] == block).collect();
            let (seen, residual) = (seen.select_rows(&rows), found.residual.select_rows(&rows));
            Part {
                hessian: seen.tr_mul(&seen),
                gradient: seen.tr_mul(&residual),
                square: residual.norm_squared(),
                rows: rows.len() as f64,
            }
        })
        .collect()
}

/// Greedy choice: the law that takes away most, then the next, while it is worth it.
fn best_terms(parts: &[&Part]) -> Vec<usize> {
    let size = parts.first().map_or(0, |part| part.gradient.len());
    let (mut hessian, mut gradient) = (DMatrix::zeros(size, size), DVector::zeros(size));
    let (mut square, mut rows) = (0.0, 0.0);
    for part in parts {
        hessian += &part.hessian;
        gradient += &part.gradient;
        square += part.square;
        rows += part.rows;
    }
    let left = |terms: &[usize]| square - explained(&hessian, &gradient, terms);
    let mut chosen: Vec<usize> = Vec::new();
    while chosen.len() < MOST_TERMS {
        let now = left(&chosen);
        let with = |term: usize| {
            let mut terms = chosen.clone();
            terms.push(term);
            (term, left(&terms))
        };
        let open = (0..TERMS.len()).filter(|term| !chosen.contains(term)).map(with);
        let Some((term, after)) = open.min_by(|a, b| a.1.total_cmp(&b.1)) else {
            break;
        };
        let gain = now - after;
        if gain <= WORTH * (now - rows).max(0.0) || gain <= 10.0 * TERMS[term].components as f64 {
            break;
        }
        chosen.push(term);
    }
    chosen
}

/// What laws take away of the squared residual.
fn explained(hessian: &DMatrix<f64>, gradient: &DVector<f64>, terms: &[usize]) -> f64 {
    let mut columns = Vec::new();
    let mut first = 0;
    for (index, term) in TERMS.iter().enumerate() {
        if terms.contains(&index) {
            columns.extend(first..first + term.components);
        }
        first += term.components;
    }
    let gradient = gradient.select_rows(&columns);
    let mut hessian = hessian.select_rows(&columns).select_columns(&columns);
    for k in 0..columns.len() {
        // A law that does nothing here, such as sliding far from a table, takes away nothing.
        hessian[(k, k)] = hessian[(k, k)] * (1.0 + 1e-9) + 1e-12;
    }
    let factor = hessian.cholesky();
    factor.map_or(0.0, |factor| gradient.dot(&factor.solve(&gradient)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_law_has_as_many_fields_as_it_says() {
        let motion = Motion::default();
        for term in &TERMS {
            assert_eq!((term.fields)(&motion).len(), term.components, "{}", term.id);
        }
    }
}
