//! The convergence studies as plots: error against thickness in cells.

use super::study::{ALIGNMENTS, Study};
use crate::plot::{FAINT, Mark, Panel, Scales, Series, interval, ramp};

/// One panel per study.
pub fn panels(studies: &[Study]) -> Vec<Panel> {
    studies
        .iter()
        .filter(|study| study.points.len() > 1)
        .map(panel)
        .collect()
}

fn panel(study: &Study) -> Panel {
    let cells = || study.points.iter().map(|p| p.cells);
    let mut series: Vec<Series> = (0..ALIGNMENTS.len())
        .map(|alignment| {
            let here = study.points.iter().filter(|p| p.alignment == alignment);
            Series {
                label: format!("grid moved by {:?}", ALIGNMENTS[alignment]),
                colour: ramp(0.25 * alignment as f64),
                mark: Mark::Line(2),
                points: here.map(|p| [p.cells, 100.0 * p.error]).collect(),
            }
        })
        .collect();
    let x = interval(cells(), 0.05, 0.5);
    series.push(Series {
        label: String::new(),
        colour: FAINT,
        mark: Mark::Line(1),
        points: vec![[x.start, 0.0], [x.end, 0.0]],
    });
    let errors = study.points.iter().map(|p| 100.0 * p.error).chain([0.0]);
    Panel {
        title: study.name.clone(),
        x_label: "cells across the rope".into(),
        y_label: "error [%]".into(),
        x,
        y: interval(errors, 0.2, 1.0),
        scales: Scales::Free,
        size_px: (760, 300),
        series,
    }
}
