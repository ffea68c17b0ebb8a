//! Which effects would explain the residual together, to first order: the best pairs and triples.

use super::{Block, Normal, View};
use crate::effects;
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ops::Range;

/// Effects that would explain the residual together with physical values, none of which could be left out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Subset {
    /// Names of the effects.
    pub ids: Vec<String>,
    /// Predicted drop of the whitened sum of squares.
    pub statistic: f64,
    /// What it has to exceed: the sum of its members' own thresholds.
    pub threshold: f64,
    /// One-step estimates of their parameters, effect after effect.
    pub estimate: Vec<f64>,
    /// By how much the parameters that the model has already change with them.
    #[serde(default)]
    pub own_change: Vec<f64>,
}

/// Most effects of a subset.
pub(in super::super) const MOST_MEMBERS: usize = 3;
/// How many subsets of each size are told, with the cameras' place among them and without: where that is free to be fitted
/// it takes away a part of anything.
const TOLD: usize = 3;

/// The best subsets of every size from two up to [`MOST_MEMBERS`], by what they take away beyond their thresholds; each
/// member takes away more than its own threshold of what the others leave.
pub(super) fn subsets(blocks: &[Block], views: &[View; 2], thresholds: &[f64]) -> Vec<Subset> {
    let search = Search::new(blocks, views, thresholds);
    let of_kind = |members: usize, view: usize| {
        let all = combinations(blocks.len(), members).into_iter();
        let needed = all.filter(|subset| search.view(subset) == view && search.needs_all(subset));
        let mut subsets: Vec<Subset> = needed.map(|subset| search.subset(&subset)).collect();
        best_first(&mut subsets);
        subsets.truncate(TOLD);
        subsets
    };
    let kinds = (2..=MOST_MEMBERS).flat_map(|members| [(members, 0), (members, 1)]);
    let mut subsets: Vec<Subset> = kinds.flat_map(|(members, view)| of_kind(members, view)).collect();
    best_first(&mut subsets);
    subsets
}

fn best_first(subsets: &mut [Subset]) {
    let beyond = |s: &Subset| s.statistic - s.threshold;
    subsets.sort_by(|a, b| beyond(b).total_cmp(&beyond(a)));
}

/// Normal equations of all candidates, in both views, and where each of them has its parameters in it.
struct Search<'a> {
    blocks: &'a [Block],
    views: &'a [View; 2],
    thresholds: &'a [f64],
    normals: [Normal; 2],
    entries: Vec<Range<usize>>,
    /// What every subset of fewer than [`MOST_MEMBERS`] takes away, by view.
    known: BTreeMap<(usize, Vec<usize>), f64>,
}

impl<'a> Search<'a> {
    fn new(blocks: &'a [Block], views: &'a [View; 2], thresholds: &'a [f64]) -> Self {
        let mut entries = Vec::new();
        let mut first = 0;
        for block in blocks {
            entries.push(first..first + block.ranges.len());
            first += block.ranges.len();
        }
        let normals = views.each_ref().map(|view| {
            let columns: Vec<_> = view.traces.iter().flat_map(|t| t.column_iter()).collect();
            let traces = match columns.as_slice() {
                [] => DMatrix::zeros(view.residual.len(), 0),
                columns => DMatrix::from_columns(columns),
            };
            let precision = blocks.iter().flat_map(|block| block.precision.clone());
            let ranges = blocks.iter().flat_map(|block| block.ranges.clone());
            Normal::of((&traces, &view.residual), precision.collect(), ranges.collect())
        });
        let mut search = Self {
            blocks,
            views,
            thresholds,
            normals,
            entries,
            known: BTreeMap::new(),
        };
        for view in 0..2 {
            for members in 1..MOST_MEMBERS {
                for subset in combinations(blocks.len(), members) {
                    let statistic = search.solve(view, &subset).0;
                    search.known.insert((view, subset), statistic);
                }
            }
        }
        search
    }

    /// What a subset takes away, and the estimate of its parameters.
    fn solve(&self, view: usize, subset: &[usize]) -> (f64, Vec<f64>) {
        let chosen: Vec<usize> = subset.iter().flat_map(|&b| self.entries[b].clone()).collect();
        self.normals[view].select(&chosen).solve()
    }

    /// Whether each member takes away more than chance of what the others leave.
    fn needs_all(&self, subset: &[usize]) -> bool {
        let view = self.view(subset);
        let statistic = match self.known.get(&(view, subset.to_vec())) {
            Some(known) => *known,
            None => self.solve(view, subset).0,
        };
        subset.iter().all(|&member| {
            let others: Vec<usize> = subset.iter().copied().filter(|&b| b != member).collect();
            statistic - self.known[&(view, others)] > self.thresholds[member]
        })
    }

    /// Cameras are no free columns beside an effect that does what they do.
    fn view(&self, subset: &[usize]) -> usize {
        let views = subset.iter().map(|&b| self.blocks[b].view());
        views.max().unwrap_or(0)
    }

    fn subset(&self, subset: &[usize]) -> Subset {
        let view = self.view(subset);
        let (statistic, estimate) = self.solve(view, subset);
        let mut rest = &estimate[..];
        let values = subset.iter().map(|&b| {
            let (own, after) = rest.split_at(self.entries[b].len());
            rest = after;
            (b, own)
        });
        let own_change = self.views[view].own_change(values);
        let id = |&b: &usize| effects::ALL[self.blocks[b].effect].id.into();
        Subset {
            ids: subset.iter().map(id).collect(),
            statistic,
            threshold: subset.iter().map(|&b| self.thresholds[b]).sum(),
            estimate,
            own_change,
        }
    }
}

impl Normal {
    /// Those of some parameters, the others being nothing.
    fn select(&self, chosen: &[usize]) -> Self {
        Self {
            hessian: self.hessian.select_rows(chosen).select_columns(chosen),
            right: self.right.select_rows(chosen),
            precision: chosen.iter().map(|&k| self.precision[k]).collect(),
            ranges: chosen.iter().map(|&k| self.ranges[k]).collect(),
        }
    }
}

/// All ways to choose `members` of the first `count` numbers, each in ascending order.
fn combinations(count: usize, members: usize) -> Vec<Vec<usize>> {
    if members == 0 {
        return vec![Vec::new()];
    }
    let with_last = |last: usize| {
        let mut chosen = combinations(last, members - 1);
        chosen.iter_mut().for_each(|c| c.push(last));
        chosen
    };
    (0..count).flat_map(with_last).collect()
}

#[cfg(test)]
mod tests {
    use super::super::Projector;
    use super::*;
    use nalgebra::DVector;

    /// Effects with these traces over four rows, each of one parameter with this range.
    fn problem(traces: &[([f64; 4], [f64; 2])], residual: [f64; 4]) -> (Vec<Block>, [View; 2]) {
        let column = |trace: &[f64; 4]| DMatrix::from_column_slice(4, 1, trace);
        let blocks = traces.iter().enumerate().map(|(effect, (trace, range))| Block {
            effect,
            without_cameras: false,
            columns: column(trace),
            ranges: vec![*range],
            precision: vec![1e-9],
        });
        let view = || View {
            solver: Projector::new(DMatrix::zeros(4, 0), &[]),
            traces: traces.iter().map(|(trace, _)| column(trace)).collect(),
            residual: DVector::from_column_slice(&residual),
            own: traces.iter().map(|_| DMatrix::zeros(0, 1)).collect(),
            residual_own: DMatrix::zeros(0, 1),
        };
        (blocks.collect(), [view(), view()])
    }

    /// Two causes that nearly undo each other: each alone takes away next to nothing, and a third effect more than either.
    #[test]
    fn causes_that_hide_each_other_are_found_together() {
        let wide = [-100.0, 100.0];
        let traces = [
            ([1.0, 0.0, 0.1, 0.0], wide),
            ([1.0, 0.0, -0.1, 0.0], wide),
            ([0.0, 0.0, 0.1, 0.3], wide),
        ];
        let (blocks, views) = problem(&traces, [0.0, 0.0, 6.0, 0.0]);
        let alone: Vec<f64> = (0..3)
            .map(|b| {
                blocks[b]
                    .normal(&views[0].traces[b], &views[0].residual)
                    .solve()
                    .0
            })
            .collect();
        assert!(alone[2] > alone[0].max(alone[1]), "{alone:?}");
        let subsets = subsets(&blocks, &views, &[4.0; 3]);
        assert_eq!(subsets[0].ids, [0, 1].map(|b: usize| effects::ALL[b].id));
        assert!((subsets[0].statistic - 36.0).abs() < 1e-3);
        assert!((subsets[0].estimate[0] - 30.0).abs() < 1e-3 && (subsets[0].estimate[1] + 30.0).abs() < 1e-3);
        assert!(
            subsets.iter().all(|s| s.ids.len() == 2),
            "a third takes away nothing that the two leave"
        );
    }

    /// What would take away all with an impossible value takes away with a possible one what that can.
    #[test]
    fn values_of_a_subset_stay_physical() {
        let traces = [
            ([1.0, 0.0, 0.0, 0.0], [0.0, 2.0]),
            ([0.0, 1.0, 0.0, 0.0], [-100.0, 100.0]),
        ];
        let (blocks, views) = problem(&traces, [10.0, -5.0, 0.0, 0.0]);
        let subsets = subsets(&blocks, &views, &[4.0; 2]);
        assert_eq!(subsets.len(), 1);
        assert!((subsets[0].estimate[0] - 2.0).abs() < 1e-6 && (subsets[0].estimate[1] + 5.0).abs() < 1e-6);
        assert!(
            (subsets[0].statistic - (36.0 + 25.0)).abs() < 1e-6,
            "{}",
            subsets[0].statistic
        );
    }

    #[test]
    fn combinations_are_all_there_once() {
        assert_eq!(combinations(3, 2), [[0, 1], [0, 2], [1, 2]]);
        assert_eq!(combinations(20, 3).len(), 1140);
    }
}
