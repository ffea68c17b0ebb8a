//! What the parts of the method are worth: the same data asked again without one of them.

use super::run::Answer;
use super::tally::{Figure, Line, is_right, is_strange, names_strange};
use crate::diagnose::Part;
use crate::statistics::Rate;

/// The parts and their names.
const PARTS: [(Part, &str); 3] = [
    (Part::Whitening, "whitening"),
    (Part::Nuisances, "nuisance columns"),
    (Part::Refinement, "a finer grid"),
];

/// For every part how often a wrong effect is named without it, whether more wrong effects get a significant score, because
/// what the gates behind the scores then refuse nobody sees in the names, and how often the answer is not the right one.
pub(super) fn ablations(mine: &[&Answer]) -> Vec<Line> {
    PARTS
        .iter()
        .flat_map(|&(part, words)| {
            let asked_again = mine.iter().filter(|a| a.cell.without == Some(part));
            let pairs: Vec<[&Answer; 2]> = asked_again
                .filter_map(|without| Some([whole(mine, without)?, without]))
                .collect();
            [
                more_often("a wrong effect named", names_strange, &pairs, words),
                wrongly_scored(&pairs, words),
                more_often("not the right answer", |answer| !is_right(answer), &pairs, words),
            ]
        })
        .collect()
}

/// The answer of the whole method to the same data.
fn whole<'a>(mine: &[&'a Answer], without: &Answer) -> Option<&'a Answer> {
    let data = |a: &Answer| (a.cell.truth(), a.cell.noise_seed());
    let same = |a: &&&Answer| a.cell.without.is_none() && !a.cell.hidden && data(a) == data(without);
    mine.iter().find(same).copied()
}

/// How often something is so without a part, beside how often it is with it.
fn more_often(what: &str, is_so: fn(&Answer) -> bool, pairs: &[[&Answer; 2]], words: &str) -> Line {
    let [with, without] = [0, 1].map(|k| Rate::of(pairs.iter().map(|pair| is_so(pair[k]))));
    let apart = (with.wilson().zip(without.wilson())).map(|(a, b)| [b[0] > a[1], b[1] < a[0]]);
    Line {
        what: format!("{what} without {words}"),
        target: Some(format!("visibly more than with it, {} of {}", with.hits, with.of)),
        figure: Figure::Rate(without),
        met: apart.map(|[more, _]| more),
        sure: apart.is_some_and(|[more, fewer]| more || fewer),
    }
}

/// How many diagnoses have more wrong effects of significant score without a part than with it, of those that scored any.
fn wrongly_scored(pairs: &[[&Answer; 2]], words: &str) -> Line {
    let count = |answer: &Answer| {
        let significant = answer.significant.as_ref()?;
        Some(significant.iter().filter(|id| is_strange(answer, id)).count())
    };
    let counts = pairs
        .iter()
        .map(|[with, without]| Some([count(with)?, count(without)?]));
    let counts: Vec<[usize; 2]> = counts.flatten().collect();
    let mean = |k: usize| counts.iter().map(|c| c[k]).sum::<usize>() as f64 / counts.len().max(1) as f64;
    let more = Rate::of(counts.iter().map(|[with, without]| without > with));
    Line {
        what: format!("more wrong effects of significant score without {words}"),
        target: Some(format!(
            "in most; on average {:.1} instead of {:.1}",
            mean(1),
            mean(0)
        )),
        figure: Figure::Rate(more),
        met: more.wilson().map(|[low, _]| low > 0.5),
        sure: more.wilson().is_some_and(|[low, high]| low > 0.5 || high < 0.5),
    }
}

#[cfg(test)]
mod tests {
    use super::super::run::Said;
    use super::super::tally::tally;
    use super::super::tally::tests::answer;
    use super::*;

    #[test]
    fn an_ablation_is_compared_with_the_whole_method_on_the_same_data() {
        let mut answers = Vec::new();
        for seed in 0..40 {
            let mut plain = answer(&[], 0.0, &[], &[]);
            (plain.cell.seed, plain.said) = (seed, Said::Nothing);
            let mut alarmed = answer(&[], 0.0, &["air_drag"], &[]);
            alarmed.cell.seed = seed;
            alarmed.cell.without = Some(Part::Whitening);
            answers.extend([plain, alarmed]);
        }
        let tally = tally("g2", &answers, &[], 0.1);
        let whitening = &tally.ablations[0];
        assert_eq!(whitening.figure, Figure::Rate(Rate { hits: 40, of: 40 }));
        assert_eq!(whitening.met, Some(true));
        let target = whitening.target.as_deref().unwrap();
        assert!(target.ends_with("0 of 40"), "{target}");
        let wrong = &tally.ablations[2];
        assert_eq!((wrong.figure, wrong.met), (whitening.figure, Some(true)));
        assert!(tally.ablations[3..].iter().all(|line| line.met.is_none()));
    }

    #[test]
    fn scores_are_compared_one_diagnosis_with_the_other() {
        let mut answers = Vec::new();
        for seed in 0..12 {
            for without in [None, Some(Part::Nuisances)] {
                let mut one = answer(&["camera_offset"], 2.0, &["camera_offset"], &[]);
                (one.cell.seed, one.cell.without) = (seed, without);
                let significant = ["camera_offset", "tilted_gravity", "steady_wind"];
                let count = if without.is_some() {
                    3
                } else {
                    1 + usize::from(seed == 0)
                };
                one.significant = Some(significant[..count].iter().map(ToString::to_string).collect());
                answers.push(one);
            }
        }
        // Nothing was left to score here.
        let mut empty = answer(&[], 0.0, &[], &[]);
        answers.push(empty.clone());
        empty.cell.without = Some(Part::Nuisances);
        answers.push(empty);
        let tally = tally("g2", &answers, &[], 0.1);
        let scored = &tally.ablations[4];
        assert_eq!(scored.figure, Figure::Rate(Rate { hits: 12, of: 12 }));
        let target = scored.target.as_deref().unwrap();
        assert!(target.ends_with("2.0 instead of 0.1"), "{target}");
        assert_eq!(scored.met, Some(true));
        assert_eq!(tally.ablations[3].figure, Figure::Rate(Rate { hits: 0, of: 13 }));
    }
}
