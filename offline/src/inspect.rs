//! What is in a `policy.blob`, for people and as JSON for machines.

use crate::run_files::{Fnv64, RunFolder, hex, read_whole};
use crate::words::with_error;
use anyhow::Context;
use serde::Serialize;
use shared::blob::{Blob, FORMAT_VERSION, RopeEntry, TaskFrame, parse};
use shared::policy::{HIDDEN, INPUTS, OUTPUTS, ReleaseRegion, TrainingRanges};
use shared::profile::MotionLimits;
use shared::task::SwingTask;
use std::fmt;
use std::path::Path;

/// Places in a rope's reach, as it is told, at which answers are shown: its ends and its middle.
const SHOWN: [f64; 3] = [0.0, 0.5, 1.0];

/// What is in a blob.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BlobReport {
    /// Size, bytes.
    pub bytes: usize,
    /// FNV-1a hash of the file, hexadecimal.
    pub hash: String,
    /// Format version.
    pub format_version: u32,
    /// Units of each layer, inputs first.
    pub layers: [usize; 5],
    /// What the policy was trained on.
    pub ranges: TrainingRanges,
    /// Where its answers lie.
    pub region: ReleaseRegion,
    /// Ropes.
    pub ropes: Vec<RopeReport>,
    /// The task.
    pub task: SwingTask,
    /// Where the task stands in the robot's base frame.
    pub frame: TaskFrame,
    /// Limits of the gripper's motion.
    pub motion: MotionLimits,
    /// Name and version of the program that made it.
    pub program: String,
    /// Seed of the run.
    pub seed: u64,
    /// Hash of the model, hexadecimal.
    pub model: String,
    /// Hash of the dataset, hexadecimal.
    pub dataset: String,
    /// Hash of each demonstration, hexadecimal.
    pub demos: Vec<String>,
}

/// A rope with a few of the policy's answers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RopeReport {
    /// The rope.
    #[serde(flatten)]
    pub rope: RopeEntry,
    /// Answers at the ends and in the middle of its reach.
    pub answers: Vec<Answer>,
}

/// One answer of the policy.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Answer {
    /// Goal, m.
    pub goal_x_m: f64,
    /// Release point (x, z), m.
    pub release_m: [f64; 2],
    /// The same as the position of the flange in the robot's base frame, m.
    pub flange_m: [f64; 3],
}

/// Reads the blob at `path` and says what is in it.
pub fn inspect(path: &Path) -> anyhow::Result<BlobReport> {
    let bytes = read_whole(path)?;
    let blob = Box::new(parse(&bytes).with_context(|| path.display().to_string())?);
    Ok(BlobReport::new(&blob, &bytes))
}

/// What is wrong with the blob of a run, where there is one that cannot be used, or that was frozen from another model than
/// the run now holds.
pub fn stale(run: &RunFolder) -> Option<String> {
    let model = Fnv64::of(&read_whole(&run.model()).ok()?);
    let blob = match parse(&read_whole(&run.blob()).ok()?) {
        Ok(blob) => Box::new(blob),
        Err(error) => return Some(format!("{}: {error}", run.blob().display())),
    };
    (blob.provenance.model != model).then(|| {
        format!(
            "{} was frozen from another model than {} holds now: freeze again before a robot swings by it",
            run.blob().display(),
            run.model().display()
        )
    })
}

impl BlobReport {
    fn new(blob: &Blob, bytes: &[u8]) -> Self {
        let rope = |rope: &RopeEntry| {
            let told_m = rope.reach_m.whole_millimetres();
            RopeReport {
                rope: rope.clone(),
                answers: SHOWN.map(|share| answer(blob, rope, told_m.at(share))).to_vec(),
            }
        };
        let provenance = &blob.provenance;
        Self {
            bytes: bytes.len(),
            hash: hex(Fnv64::of(bytes)),
            format_version: FORMAT_VERSION,
            layers: [INPUTS, HIDDEN[0], HIDDEN[1], HIDDEN[2], OUTPUTS],
            ranges: *blob.policy.ranges(),
            region: *blob.policy.region(),
            ropes: blob.ropes.iter().map(rope).collect(),
            task: blob.task,
            frame: blob.frame,
            motion: blob.motion,
            program: provenance.program.to_string(),
            seed: provenance.seed,
            model: hex(provenance.model),
            dataset: hex(provenance.dataset),
            demos: provenance.demos.iter().map(|hash| hex(*hash)).collect(),
        }
    }
}

fn answer(blob: &Blob, rope: &RopeEntry, goal_x_m: f64) -> Answer {
    let release_m = blob.policy.release_point_m(goal_x_m, rope.young_pa, rope.poisson);
    Answer {
        goal_x_m,
        release_m,
        flange_m: blob.frame.flange_m(release_m),
    }
}

impl fmt::Display for BlobReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let layers = self.layers.map(|units| units.to_string()).join("-");
        writeln!(
            f,
            "policy.blob, format {}: {} bytes, hash {}",
            self.format_version, self.bytes, self.hash
        )?;
        writeln!(f, "made by {}, seed {}", self.program, self.seed)?;
        writeln!(
            f,
            "hashes: model {}, dataset {}, demos {}",
            self.model,
            self.dataset,
            self.demos.join(" ")
        )?;
        writeln!(f, "network {layers}, trained on")?;
        writeln!(f, "  goals    {}", self.ranges.goal_x_m.metres())?;
        let young = &self.ranges.young_pa;
        writeln!(
            f,
            "  E        {:.3} to {:.3} MPa",
            1e-6 * young.low,
            1e-6 * young.high
        )?;
        writeln!(
            f,
            "  ν        {:.3} to {:.3}",
            self.ranges.poisson.low, self.ranges.poisson.high
        )?;
        self.fmt_task(f)?;
        for rope in &self.ropes {
            write!(f, "{rope}")?;
        }
        Ok(())
    }
}

impl BlobReport {
    fn fmt_task(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let (task, motion, frame) = (&self.task, &self.motion, &self.frame);
        writeln!(f, "task: clamp at ({:.3}, {:.3}) m", task.top_m[0], task.top_m[1])?;
        writeln!(f, "  goals    {}", task.goal_x_m.metres())?;
        let radius = self.region.radius_m;
        let (x, z) = (self.region.x_m.metres(), self.region.z_m.metres());
        writeln!(
            f,
            "  release  x {x}, z {z}, at most {radius:.3} m of rope to span"
        )?;
        let origin = frame.origin_m;
        let yaw = frame.yaw_rad;
        writeln!(
            f,
            "  frame    origin ({:.3}, {:.3}, {:.3}) m, yaw {yaw:.4} rad",
            origin[0], origin[1], origin[2]
        )?;
        writeln!(
            f,
            "  motion   {} m/s, {} m/s², {} m/s³",
            motion.speed_m_s, motion.acceleration_m_s2, motion.jerk_m_s3
        )
    }
}

impl fmt::Display for RopeReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let rope = &self.rope;
        let (length, diameter) = (1e3 * rope.length_m, 1e3 * rope.diameter_m);
        write!(
            f,
            "rope `{}`: {length:.0} mm, Ø {diameter:.1} mm, {:.1} g",
            rope.name,
            1e3 * rope.mass_kg
        )?;
        if rope.end_mass_kg > 0.0 {
            write!(f, " and {:.1} g at its end", 1e3 * rope.end_mass_kg)?;
        }
        writeln!(f)?;
        let young = with_error(1e-6 * rope.young_pa, 1e-6 * rope.young_se_pa);
        writeln!(f, "  E        {young} MPa")?;
        let poisson = with_error(rope.poisson, rope.poisson_se);
        let identified = if rope.poisson_identified {
            ""
        } else {
            " (not identified)"
        };
        writeln!(f, "  ν        {poisson}{identified}")?;
        for effect in &rope.effects {
            let size = with_error(effect.value, effect.se);
            writeln!(f, "  effect   {}: {} = {size}", effect.name, effect.parameter)?;
        }
        writeln!(f, "  reaches  {}", rope.reach_m.metres())?;
        for answer in &self.answers {
            let [x, z] = answer.release_m;
            writeln!(
                f,
                "  goal {:.4} m → release at ({x:.4}, {z:.4}) m",
                answer.goal_x_m
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::freeze::{freeze, tests::blob};

    #[test]
    fn a_blob_is_told_to_people_and_machines() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("policy.blob");
        freeze(&blob(), &path).unwrap();
        let report = inspect(&path).unwrap();
        let text = report.to_string();
        for part in [
            "rope `red`",
            "not identified",
            "air drag: normal = 1.10 ± 0.20",
            "3-256-128-32-2",
            "0.280 to 0.420 m",
        ] {
            assert!(text.contains(part), "`{part}` is missing in\n{text}");
        }
        assert_eq!(text.matches("release at").count(), 3);
        // Whoever sends a goal as it is printed is not refused: an end was rounded to outside of the reach.
        let mut blob = blob();
        blob.ropes[0].reach_m.high = 0.41998;
        let told = BlobReport::new(&blob, &[]).to_string();
        assert!(
            told.contains("0.280 to 0.419 m") && told.contains("goal 0.4190 m"),
            "{told}"
        );
        let json = serde_json::to_value(&report).unwrap();
        assert_eq!(json["ropes"][0]["name"], "red");
        assert_eq!(json["dataset"], "0000000000000003");
        assert_eq!(json["ropes"][0]["poisson_se"], serde_json::Value::Null);
    }

    #[test]
    fn a_blob_of_another_model_than_the_runs_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let run = RunFolder::open(folder.path()).unwrap();
        assert_eq!(stale(&run), None, "there is no blob");
        let model = b"name = \"red\"";
        std::fs::write(run.model(), model).unwrap();
        let mut blob = blob();
        blob.provenance.model = Fnv64::of(model);
        freeze(&blob, &run.blob()).unwrap();
        assert_eq!(stale(&run), None);
        std::fs::write(run.model(), b"name = \"blue\"").unwrap();
        let warning = stale(&run).unwrap();
        assert!(warning.contains("freeze again"), "{warning}");
        std::fs::write(run.blob(), b"GENORM\r\n of an older program").unwrap();
        let warning = stale(&run).unwrap();
        assert!(warning.contains("freeze it again"), "{warning}");
    }

    #[test]
    fn a_file_that_is_no_blob_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("other.bin");
        std::fs::write(&path, b"something else entirely").unwrap();
        let message = format!("{:#}", inspect(&path).unwrap_err());
        assert!(
            message.contains("other.bin") && message.contains("not a policy blob"),
            "{message}"
        );
    }
}
