//! The file `policy.blob`: everything the controller must know about ropes, task and policy, behind a
//! header that detects any damage.
//!
//! ```text
//! 0   8  magic "GENORM\r\n"
//! 8   4  format version, little endian
//! 12  4  payload length in bytes, little endian
//! 16  4  CRC-32 (IEEE) of bytes 0..16 and of the payload, little endian
//! 20  .. payload: the Blob in postcard, nothing after it
//! ```
//!
//! The carriage return and line feed in the magic show a transfer in text mode, as PNG's do. A parsed
//! blob is about 170 KB by value and parsing takes under 0.5 MB of stack: parse before the loop starts,
//! keep the result in a box or on the main thread's stack, and pass it by reference.

use crate::policy::{Policy, PolicyError};
use crate::profile::MotionLimits;
use crate::task::{Interval, SwingTask};
use serde::{Deserialize, Serialize};

/// First bytes of every blob.
pub const MAGIC: [u8; 8] = *b"GENORM\r\n";
/// Version of the format that this program reads and writes.
pub const FORMAT_VERSION: u32 = 2;
/// Bytes before the payload.
pub const HEADER_BYTES: usize = 20;
/// No blob is longer than this: a buffer of this size always suffices.
pub const MAX_BLOB_BYTES: usize = 192 * 1024;
/// Most ropes in a blob.
pub const MAX_ROPES: usize = 16;
/// Most effect parameters of one rope.
pub const MAX_EFFECTS: usize = 16;
/// Most demonstrations behind a blob.
pub const MAX_DEMOS: usize = 16;
/// Longest name, bytes.
pub const NAME_BYTES: usize = 32;

/// Part of the header that the CRC covers: all of it before the CRC itself.
const CHECKED_HEADER_BYTES: usize = 16;

/// One identified parameter of a physical effect.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EffectSummary {
    /// Name of the effect.
    pub name: heapless::String<NAME_BYTES>,
    /// Name of the parameter.
    pub parameter: heapless::String<NAME_BYTES>,
    /// Its value, SI.
    pub value: f64,
    /// Its standard error, SI; infinite where the data say nothing.
    pub se: f64,
}

/// One rope that the policy may be asked to swing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RopeEntry {
    /// Name, for people; goals name the rope by its place in the list.
    pub name: heapless::String<NAME_BYTES>,
    /// Young's modulus, Pa.
    pub young_pa: f64,
    /// Its standard error, Pa; infinite where the data say nothing.
    pub young_se_pa: f64,
    /// Poisson's ratio.
    pub poisson: f64,
    /// Its standard error; infinite where the data say nothing.
    pub poisson_se: f64,
    /// Whether the data determine Poisson's ratio; otherwise the value is the prior's.
    pub poisson_identified: bool,
    /// Length, m.
    pub length_m: f64,
    /// Diameter, m.
    pub diameter_m: f64,
    /// Mass, kg.
    pub mass_kg: f64,
    /// Mass that is known to hang at its end, kg; an effect that was found there comes on top.
    pub end_mass_kg: f64,
    /// Goals that this rope was seen to reach in rollouts, m; others are refused.
    pub reach_m: Interval,
    /// What the model holds beyond the rope itself.
    pub effects: heapless::Vec<EffectSummary, MAX_EFFECTS>,
}

/// Farthest that a task's origin may lie from the arm's base along each axis, m.
pub const ORIGIN_MAX_M: f64 = 3.0;
/// Largest turn of a task frame, rad.
pub const YAW_MAX_RAD: f64 = core::f64::consts::TAU;

/// Maps a task point (x, z) to the position of the flange in the robot's base frame:
/// origin + Rz(yaw) · (x, 0, z), with the constant tool offset folded into the origin.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TaskFrame {
    /// Flange position for the task point (0, 0), m.
    pub origin_m: [f64; 3],
    /// Turn of the task plane about the base's z axis, rad.
    pub yaw_rad: f64,
}

impl TaskFrame {
    /// Position of the flange in the base frame for a task point, m.
    pub fn flange_m(&self, point_m: [f64; 2]) -> [f64; 3] {
        let (sin, cos) = libm::sincos(self.yaw_rad);
        [
            self.origin_m[0] + cos * point_m[0],
            self.origin_m[1] + sin * point_m[0],
            self.origin_m[2] + point_m[1],
        ]
    }
}

/// What made the blob. Hashes are 64-bit FNV-1a of file contents: they tell mistakes apart, not attackers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Hash of each demonstration.
    pub demos: heapless::Vec<u64, MAX_DEMOS>,
    /// Hash of `model.toml`.
    pub model: u64,
    /// Hash of the dataset.
    pub dataset: u64,
    /// Seed of the run.
    pub seed: u64,
    /// Name and version of the program.
    pub program: heapless::String<NAME_BYTES>,
}

/// The content of `policy.blob`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Blob {
    /// The trained policy.
    pub policy: Policy,
    /// Ropes by name.
    pub ropes: heapless::Vec<RopeEntry, MAX_ROPES>,
    /// The task.
    pub task: SwingTask,
    /// Where the task stands in the robot's base frame.
    pub frame: TaskFrame,
    /// Limits of the gripper's motion.
    pub motion: MotionLimits,
    /// What made this.
    pub provenance: Provenance,
}

/// Why bytes are no blob, or a blob no bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BlobError {
    /// The file does not start like a blob.
    #[error("not a policy blob (wrong first bytes): give the policy.blob that `offline freeze` wrote")]
    Magic,
    /// Another format version.
    #[error(
        "the blob has format version {found}, this program reads {FORMAT_VERSION}: freeze it again with this version's `offline`"
    )]
    Version {
        /// Version in the file.
        found: u32,
    },
    /// Shorter than the header says.
    #[error("the blob ends early ({found} of {expected} bytes): copy or freeze it again")]
    Truncated {
        /// Bytes given.
        found: usize,
        /// Bytes announced.
        expected: usize,
    },
    /// Longer than the header says.
    #[error("the blob goes on after its end ({found} bytes, not {expected}): copy or freeze it again")]
    Trailing {
        /// Bytes given.
        found: usize,
        /// Bytes announced.
        expected: usize,
    },
    /// The checksum does not fit.
    #[error("the blob is damaged (checksum differs): copy or freeze it again")]
    Checksum,
    /// The checksum fits but the payload is no blob.
    #[error("the blob's payload cannot be decoded: freeze it again with this version's `offline`")]
    Payload,
    /// The policy in it is not usable.
    #[error("unusable policy: {0}")]
    Policy(#[from] PolicyError),
    /// A number outside what any rope, task or robot here can have.
    #[error("implausible {what} in the blob: correct it in the run's model and freeze again")]
    Implausible {
        /// What is implausible.
        what: &'static str,
    },
    /// The buffer for writing is too short.
    #[error("the buffer is too short for the blob: give MAX_BLOB_BYTES ({MAX_BLOB_BYTES}) bytes")]
    Buffer,
}

impl Blob {
    /// The rope called `name`.
    pub fn rope(&self, name: &str) -> Option<&RopeEntry> {
        self.ropes.iter().find(|rope| rope.name == name)
    }

    /// Whether every number is one that a real rope, task and robot can have.
    pub fn check(&self) -> Result<(), BlobError> {
        self.policy.check()?;
        self.check_task()?;
        require(!self.ropes.is_empty(), "number of ropes (none)")?;
        for (index, rope) in self.ropes.iter().enumerate() {
            rope.check()?;
            require(
                rope.length_m <= self.task.longest_rope_m(rope.diameter_m),
                "rope length (hanging from the task's clamp it lies on the table)",
            )?;
            let earlier = &self.ropes[..index];
            require(
                earlier.iter().all(|other| other.name != rope.name),
                "rope name (given twice)",
            )?;
            require(
                self.policy.ranges().contain_rope(rope.young_pa, rope.poisson),
                "rope (outside what the policy was trained on)",
            )?;
        }
        Ok(())
    }

    fn check_task(&self) -> Result<(), BlobError> {
        let task = &self.task;
        let region = self.policy.region();
        let same = region.x_m == task.release_x_m
            && region.z_m == task.release_z_m
            && region.centre_m == task.touching_m();
        require(same, "release region (task and policy differ)")?;
        let near = |range: &Interval| ordered(range, -2.0, 2.0);
        require(near(&task.goal_x_m), "goal range")?;
        require(
            near(&task.release_x_m) && near(&task.release_z_m),
            "release region",
        )?;
        require(
            task.top_m.iter().all(|value| value.abs() <= 2.0),
            "clamp position",
        )?;
        require((0.0..=0.5).contains(&task.grip_m), "grip length")?;
        require((0.0..=60.0).contains(&task.dwell_s), "dwell time")?;
        require(
            self.frame
                .origin_m
                .iter()
                .all(|value| value.abs() <= ORIGIN_MAX_M),
            "task frame origin",
        )?;
        require(self.frame.yaw_rad.abs() <= YAW_MAX_RAD, "task frame yaw")?;
        let motion = &self.motion;
        // Below these a motion of the task would take an hour.
        require(
            (0.001..=1.0).contains(&motion.speed_m_s),
            "speed limit (0.001 to 1 m/s)",
        )?;
        require(
            (0.001..=50.0).contains(&motion.acceleration_m_s2),
            "acceleration limit (0.001 to 50 m/s²)",
        )?;
        require(
            (0.001..=1000.0).contains(&motion.jerk_m_s3),
            "jerk limit (0.001 to 1000 m/s³)",
        )
    }
}

impl RopeEntry {
    fn check(&self) -> Result<(), BlobError> {
        require(!self.name.is_empty(), "rope name (empty)")?;
        require((1e2..=1e12).contains(&self.young_pa), "Young's modulus")?;
        require(self.young_se_pa >= 0.0, "standard error of Young's modulus")?;
        require((0.0..0.5).contains(&self.poisson), "Poisson's ratio")?;
        require(self.poisson_se >= 0.0, "standard error of Poisson's ratio")?;
        require((0.01..=10.0).contains(&self.length_m), "rope length")?;
        require(
            self.diameter_m >= 1e-4 && self.diameter_m < self.length_m,
            "rope diameter",
        )?;
        require((1e-6..=100.0).contains(&self.mass_kg), "rope mass")?;
        require(
            (0.0..=100.0).contains(&self.end_mass_kg),
            "mass at the rope's end",
        )?;
        require(ordered(&self.reach_m, -10.0, 10.0), "rope's reachable goals")?;
        for effect in &self.effects {
            require(
                !effect.name.is_empty() && !effect.parameter.is_empty(),
                "effect name (empty)",
            )?;
            require(effect.value.is_finite(), "effect value")?;
            require(effect.se >= 0.0, "standard error of an effect")?;
        }
        Ok(())
    }
}

fn require(holds: bool, what: &'static str) -> Result<(), BlobError> {
    if holds {
        Ok(())
    } else {
        Err(BlobError::Implausible { what })
    }
}

fn ordered(range: &Interval, low: f64, high: f64) -> bool {
    range.low >= low && range.low <= range.high && range.high <= high
}

/// What follows the policy in a payload, in the order of [`Blob`]'s fields.
type AfterPolicy = (
    heapless::Vec<RopeEntry, MAX_ROPES>,
    SwingTask,
    TaskFrame,
    MotionLimits,
    Provenance,
);

/// The blob in `bytes`, which must be exactly one whole file; any damage is an error.
pub fn parse(bytes: &[u8]) -> Result<Blob, BlobError> {
    let payload = checked_payload(bytes)?;
    let mut blob = Blob {
        policy: Policy::ZERO,
        ropes: heapless::Vec::new(),
        task: SwingTask::PAPER,
        frame: TaskFrame {
            origin_m: [0.0; 3],
            yaw_rad: 0.0,
        },
        motion: MotionLimits::PAPER,
        provenance: Provenance {
            demos: heapless::Vec::new(),
            model: 0,
            dataset: 0,
            seed: 0,
            program: heapless::String::new(),
        },
    };
    fill(&mut blob, payload)?;
    blob.check()?;
    Ok(blob)
}

/// Decodes `payload` in place.
fn fill(blob: &mut Blob, payload: &[u8]) -> Result<(), BlobError> {
    let rest = blob.policy.fill(payload).ok_or(BlobError::Payload)?;
    let (after, rest) = postcard::take_from_bytes::<AfterPolicy>(rest).map_err(|_| BlobError::Payload)?;
    if !rest.is_empty() {
        return Err(BlobError::Payload);
    }
    (blob.ropes, blob.task, blob.frame, blob.motion, blob.provenance) = after;
    Ok(())
}

/// The payload behind an intact header.
fn checked_payload(bytes: &[u8]) -> Result<&[u8], BlobError> {
    let seen = bytes.len().min(MAGIC.len());
    if bytes[..seen] != MAGIC[..seen] {
        return Err(BlobError::Magic);
    }
    let Some((header, payload)) = bytes.split_first_chunk::<HEADER_BYTES>() else {
        return Err(BlobError::Truncated {
            found: bytes.len(),
            expected: HEADER_BYTES,
        });
    };
    let [
        _,
        _,
        _,
        _,
        _,
        _,
        _,
        _,
        v0,
        v1,
        v2,
        v3,
        n0,
        n1,
        n2,
        n3,
        c0,
        c1,
        c2,
        c3,
    ] = *header;
    let version = u32::from_le_bytes([v0, v1, v2, v3]);
    if version != FORMAT_VERSION {
        return Err(BlobError::Version { found: version });
    }
    let expected = HEADER_BYTES.saturating_add(u32::from_le_bytes([n0, n1, n2, n3]) as usize);
    let found = bytes.len();
    if found < expected {
        return Err(BlobError::Truncated { found, expected });
    }
    if found > expected {
        return Err(BlobError::Trailing { found, expected });
    }
    if checksum(&header[..CHECKED_HEADER_BYTES], payload) != u32::from_le_bytes([c0, c1, c2, c3]) {
        return Err(BlobError::Checksum);
    }
    Ok(payload)
}

/// Writes a checked blob to the front of `buffer` and returns the bytes of the file.
pub fn write<'a>(blob: &Blob, buffer: &'a mut [u8]) -> Result<&'a [u8], BlobError> {
    blob.check()?;
    let (header, body) = buffer
        .split_first_chunk_mut::<HEADER_BYTES>()
        .ok_or(BlobError::Buffer)?;
    let payload = postcard::to_slice(blob, body).map_err(|_| BlobError::Buffer)?;
    let length = payload.len();
    header[..8].copy_from_slice(&MAGIC);
    header[8..12].copy_from_slice(&FORMAT_VERSION.to_le_bytes());
    header[12..16].copy_from_slice(&(length as u32).to_le_bytes());
    let crc = checksum(&header[..CHECKED_HEADER_BYTES], payload);
    header[16..].copy_from_slice(&crc.to_le_bytes());
    Ok(&buffer[..HEADER_BYTES + length])
}

fn checksum(header: &[u8], payload: &[u8]) -> u32 {
    let mut crc = crc32fast::Hasher::new();
    crc.update(header);
    crc.update(payload);
    crc.finalize()
}

#[cfg(test)]
#[path = "blob_tests.rs"]
mod tests;
