//! Freezing: everything the controller needs into one `policy.blob`, written whole, read back and
//! compared before anyone is told that it is done.

use crate::run_files::{Fnv64, read_whole, write_whole};
use anyhow::Context;
use serde::Serialize;
use shared::blob::{Blob, MAX_BLOB_BYTES, parse, write};
use shared::policy::Policy;
use shared::task::Interval;
use std::path::Path;

/// Points along each axis of the grid on which forward passes are compared.
const GRID: usize = 8;

/// A blob on disk that was read back.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Frozen {
    /// Size, bytes.
    pub bytes: usize,
    /// FNV-1a hash of the file.
    pub hash: u64,
    /// Ropes in it.
    pub ropes: usize,
    /// Answers that were compared bit for bit.
    pub answers_compared: usize,
}

/// Text that fits a blob's field, or an error that names it.
pub fn short<const N: usize>(what: &str, text: &str) -> anyhow::Result<heapless::String<N>> {
    heapless::String::try_from(text)
        .map_err(|_| anyhow::anyhow!("{what} `{text}` is longer than {N} bytes: choose a shorter one"))
}

/// A list that fits a blob's field, or an error that names it.
pub fn bounded<T: Clone, const N: usize>(what: &str, items: &[T]) -> anyhow::Result<heapless::Vec<T, N>> {
    heapless::Vec::from_slice(items).map_err(|_| {
        anyhow::anyhow!(
            "{} {what} are more than a blob's {N}: leave some out",
            items.len()
        )
    })
}

/// Writes `blob` to `path` whole, reads it back, and compares content and answers.
pub fn freeze(blob: &Blob, path: &Path) -> anyhow::Result<Frozen> {
    let mut buffer = vec![0; MAX_BLOB_BYTES];
    let bytes = write(blob, &mut buffer).context("the blob cannot be written")?;
    write_whole(path, bytes)?;
    verify(blob, path)
}

/// Reads `path` and makes sure that it holds `blob` and answers like it, bit for bit.
pub fn verify(blob: &Blob, path: &Path) -> anyhow::Result<Frozen> {
    let bytes = read_whole(path)?;
    let what = || {
        format!(
            "{} is not what was written: free some space and freeze again",
            path.display()
        )
    };
    let read = Box::new(parse(&bytes).with_context(what)?);
    // Comparing encodings compares bits: -0 and 0 differ, and an infinite error equals itself.
    let mut buffer = vec![0; MAX_BLOB_BYTES];
    let expected = write(blob, &mut buffer)?;
    anyhow::ensure!(expected == bytes, what());
    let answers_compared = compare_answers(&blob.policy, &read.policy).with_context(what)?;
    Ok(Frozen {
        bytes: bytes.len(),
        hash: Fnv64::of(&bytes),
        ropes: read.ropes.len(),
        answers_compared,
    })
}

/// The number of answers on a grid over the training ranges, all equal in both policies.
fn compare_answers(one: &Policy, other: &Policy) -> anyhow::Result<usize> {
    let ranges = one.ranges();
    let mut compared = 0;
    for goal in points(&ranges.goal_x_m) {
        for young in points(&ranges.young_pa) {
            for poisson in points(&ranges.poisson) {
                let bits = |policy: &Policy| policy.release_point_m(goal, young, poisson).map(f64::to_bits);
                anyhow::ensure!(
                    bits(one) == bits(other),
                    "the frozen policy answers differently for goal {goal} m, E {young} Pa, ν {poisson}"
                );
                compared += 1;
            }
        }
    }
    Ok(compared)
}

fn points(range: &Interval) -> impl Iterator<Item = f64> {
    let range = *range;
    (0..GRID).map(move |k| range.at(k as f64 / (GRID - 1) as f64))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use shared::blob::{EffectSummary, Provenance, RopeEntry, TaskFrame};
    use shared::policy::{
        HIDDEN, INPUTS, Layer, Network, Normaliser, OUTPUTS, ReleaseRegion, Scale, TrainingRanges,
    };
    use shared::profile::MotionLimits;
    use shared::task::SwingTask;

    fn layer<const I: usize, const O: usize>() -> Layer<I, O> {
        let weights: Vec<f32> = (0..I * O).map(|k| 0.2 * (k as f32).sin()).collect();
        Layer::from_rows(&weights, &[0.05; O]).unwrap()
    }

    /// A policy whose goals are spread by so much, m.
    pub(crate) fn policy(goal_spread_m: f64) -> Policy {
        let network = Network {
            first: layer::<INPUTS, { HIDDEN[0] }>(),
            second: layer::<{ HIDDEN[0] }, { HIDDEN[1] }>(),
            third: layer::<{ HIDDEN[1] }, { HIDDEN[2] }>(),
            last: layer::<{ HIDDEN[2] }, OUTPUTS>(),
        };
        let scale = |mean, scale| Scale { mean, scale };
        let normaliser = Normaliser {
            goal_x: scale(0.33, goal_spread_m),
            log_young: scale(14.0, 0.8),
            poisson: scale(0.3, 0.05),
            release_x: scale(0.1, 0.03),
            release_z: scale(0.16, 0.07),
        };
        let interval = |low, high| Interval { low, high };
        let ranges = TrainingRanges {
            goal_x_m: interval(0.27, 0.45),
            young_pa: interval(2e5, 4.3e6),
            poisson: interval(0.2, 0.4),
        };
        let region = ReleaseRegion::new(&SwingTask::PAPER, 0.245);
        Policy::from_parts(network, normaliser, ranges, region).unwrap()
    }

    /// A blob with one rope and one effect.
    pub(crate) fn blob() -> Box<Blob> {
        let drag = EffectSummary {
            name: short("effect", "air drag").unwrap(),
            parameter: short("parameter", "normal").unwrap(),
            value: 1.1,
            se: 0.2,
        };
        let red = RopeEntry {
            name: short("rope", "red").unwrap(),
            young_pa: 7.3e5,
            young_se_pa: 4e3,
            poisson: 0.35,
            poisson_se: f64::INFINITY,
            poisson_identified: false,
            length_m: 0.25,
            diameter_m: 0.014,
            mass_kg: 0.0385,
            end_mass_kg: 0.004,
            reach_m: Interval {
                low: 0.28,
                high: 0.42,
            },
            effects: bounded("effects", &[drag]).unwrap(),
        };
        Box::new(Blob {
            policy: policy(0.04),
            ropes: bounded("ropes", &[red]).unwrap(),
            task: SwingTask::PAPER,
            frame: TaskFrame {
                origin_m: [0.2, -0.3, 0.172],
                yaw_rad: 0.5,
            },
            motion: MotionLimits::PAPER,
            provenance: Provenance {
                demos: bounded("demos", &[1]).unwrap(),
                model: 2,
                dataset: 3,
                seed: 4,
                program: short("program", "offline 0.1.0").unwrap(),
            },
        })
    }

    #[test]
    fn a_frozen_blob_is_read_back_and_compared() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("policy.blob");
        let frozen = freeze(&blob(), &path).unwrap();
        assert_eq!(frozen.bytes as u64, std::fs::metadata(&path).unwrap().len());
        assert_eq!((frozen.ropes, frozen.answers_compared), (1, GRID * GRID * GRID));
        assert_eq!(freeze(&blob(), &path).unwrap(), frozen);
    }

    #[test]
    fn a_damaged_or_another_blob_is_noticed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("policy.blob");
        freeze(&blob(), &path).unwrap();
        let mut other = blob();
        other.ropes[0].young_pa = 7.4e5;
        let message = format!("{:#}", verify(&other, &path).unwrap_err());
        assert!(message.contains("not what was written"), "{message}");
        let mut bytes = std::fs::read(&path).unwrap();
        bytes[9000] ^= 4;
        std::fs::write(&path, &bytes).unwrap();
        let message = format!("{:#}", verify(&blob(), &path).unwrap_err());
        assert!(message.contains("checksum"), "{message}");
        std::fs::write(&path, &bytes[..9000]).unwrap();
        assert!(verify(&blob(), &path).is_err());
    }

    #[test]
    fn an_implausible_blob_never_reaches_the_disk() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("policy.blob");
        let mut bad = blob();
        bad.motion.speed_m_s = 3.0;
        let message = format!("{:#}", freeze(&bad, &path).unwrap_err());
        assert!(message.contains("speed limit") && !path.exists(), "{message}");
        let message = short::<32>("rope", "a name that is far too long for a rope").unwrap_err();
        assert!(message.to_string().contains("longer than 32 bytes"));
        assert!(bounded::<u64, 2>("demos", &[1, 2, 3]).is_err());
    }
}
