//! The file of a recorded run: what went into every cycle of the controller and what came out, together
//! with the policy file that answered, so that the run can be replayed bit for bit from this file alone.
//!
//! ```text
//! 0   8   magic "GENREC3\n"
//! 8   48  the words of `Header`, 64 bits each
//! 56  8   CRC-32 of the 56 bytes before
//! 64  ..  the policy file, byte for byte
//! ..  576 per cycle, until the file ends: a `Record` of 568 bytes as it lies in memory, and its CRC-32
//! ```
//!
//! Everything is little endian; a CRC-32 is a word of 64 bits whose upper half is zero. A file that ends within a record
//! (a crash) is whole up to there; cycle numbers that skip show where the disk was too slow.

use crate::messages::{Command, Goal, JointTarget, RobotState, Status};

/// First bytes of every recording.
pub const MAGIC: [u8; 8] = *b"GENREC3\n";

/// Bytes of the header that its checksum is of.
const CHECKED_HEADER_BYTES: usize = MAGIC.len() + 6 * CRC_BYTES;

/// Bytes before the policy file.
pub const HEADER_BYTES: usize = CHECKED_HEADER_BYTES + CRC_BYTES;

/// Bytes of one record.
const RECORD_BYTES: usize = size_of::<Record>();

/// Bytes of one record in the file, its checksum included.
pub const FRAME_BYTES: usize = RECORD_BYTES + CRC_BYTES;

/// Bytes of a checksum, and of every other word.
const CRC_BYTES: usize = size_of::<u64>();

// No padding: the bytes of a record are exactly those of its fields.
const _: () = assert!(RECORD_BYTES == 40 + 40 + 32 + 152 + 160 + 144);

/// What a replay must know besides the inputs and the policy file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// Time of one cycle, ns.
    pub cycle_ns: u64,
    /// Cycles to one target.
    pub cycles_per_target: u32,
    /// Bits of [`crate::messages::degraded`].
    pub degraded: u32,
    /// Cycles without a state of the arm after which it counted as silent.
    pub silent_cycles_max: u64,
    /// How long before the release the gripper was told to open, ns.
    pub gripper_lead_ns: u64,
    /// Length of the policy file that follows, bytes.
    pub policy_bytes: u64,
}

impl Header {
    /// The head of the file.
    pub fn to_bytes(&self) -> [u8; HEADER_BYTES] {
        let words = [
            self.cycle_ns,
            u64::from(self.cycles_per_target),
            u64::from(self.degraded),
            self.silent_cycles_max,
            self.gripper_lead_ns,
            self.policy_bytes,
        ];
        let mut bytes = [0; HEADER_BYTES];
        bytes[..MAGIC.len()].copy_from_slice(&MAGIC);
        for (place, word) in bytes[MAGIC.len()..].chunks_exact_mut(8).zip(words) {
            place.copy_from_slice(&word.to_le_bytes());
        }
        let (checked, crc) = bytes.split_at_mut(CHECKED_HEADER_BYTES);
        crc.copy_from_slice(&checksum(checked));
        bytes
    }

    /// The header in the first bytes of a file; `None` when they are something else, or damaged.
    pub fn from_bytes(bytes: &[u8; HEADER_BYTES]) -> Option<Self> {
        let (checked, crc) = bytes.split_at(CHECKED_HEADER_BYTES);
        if crc != checksum(checked) {
            return None;
        }
        let words = checked.strip_prefix(&MAGIC)?;
        let word = |k: usize| {
            let mut word = [0; 8];
            word.copy_from_slice(&words[8 * k..8 * k + 8]);
            u64::from_le_bytes(word)
        };
        let header = Self {
            cycle_ns: word(0),
            cycles_per_target: u32::try_from(word(1)).ok()?,
            degraded: u32::try_from(word(2)).ok()?,
            silent_cycles_max: word(3),
            gripper_lead_ns: word(4),
            policy_bytes: word(5),
        };
        let plausible = (1..=1_000_000_000).contains(&header.cycle_ns)
            && (1..=1000).contains(&header.cycles_per_target)
            // Ten times what any command line asks for, and no product with a cycle overflows.
            && header.silent_cycles_max <= 20_000
            && header.policy_bytes <= crate::blob::MAX_BLOB_BYTES as u64;
        plausible.then_some(header)
    }
}

/// Bits of [`Record::present`]: which of a record's messages were there.
pub mod present {
    /// [`super::Record::goal`].
    pub const GOAL: u64 = 1;
    /// [`super::Record::command`].
    pub const COMMAND: u64 = 2;
    /// [`super::Record::robot`].
    pub const ROBOT: u64 = 4;
    /// The controller was told to end.
    pub const SHUTDOWN: u64 = 8;
    /// [`super::Record::target`].
    pub const TARGET: u64 = 16;
    /// [`super::Record::status`].
    pub const STATUS: u64 = 32;
}

/// One cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct Record {
    /// Number of the cycle, from 1.
    pub cycle: u64,
    /// The instant on the loop's grid, ns.
    pub now_ns: u64,
    /// Bits of [`present`]; a message that was not there is all zeros.
    pub present: u64,
    /// Cycles missed since start.
    pub missed_deadlines: u64,
    /// Messages lost since start.
    pub messages_lost: u64,
    /// In: the goal judged.
    pub goal: Goal,
    /// In: the command obeyed.
    pub command: Command,
    /// In: the newest state of the arm.
    pub robot: RobotState,
    /// Out: the target.
    pub target: JointTarget,
    /// Out: the status.
    pub status: Status,
}

impl Record {
    /// Whether all bits of `what` (see [`present`]) are there.
    pub fn has(&self, what: u64) -> bool {
        self.present & what == what
    }

    /// The record as it lies in the file, with its checksum.
    pub fn to_frame(&self) -> [u8; FRAME_BYTES] {
        let mut frame = [0; FRAME_BYTES];
        let (record, crc) = frame.split_at_mut(RECORD_BYTES);
        record.copy_from_slice(self.bytes());
        crc.copy_from_slice(&checksum(record));
        frame
    }

    /// The record that lies in the file as these bytes; `None` when they are damaged.
    pub fn from_frame(frame: &[u8; FRAME_BYTES]) -> Option<Self> {
        let (record, crc) = frame.split_first_chunk::<RECORD_BYTES>()?;
        (crc == checksum(record)).then(|| Self::from_bytes(record))
    }

    /// The record as it lies in memory.
    pub fn bytes(&self) -> &[u8; RECORD_BYTES] {
        // SAFETY: the structure is repr(C) without padding, so every byte is initialised.
        unsafe { &*(self as *const Self).cast() }
    }

    fn from_bytes(bytes: &[u8; RECORD_BYTES]) -> Self {
        // SAFETY: every field is an integer or a float, for which any bits are a value.
        unsafe { core::ptr::read_unaligned(bytes.as_ptr().cast()) }
    }
}

fn checksum(bytes: &[u8]) -> [u8; CRC_BYTES] {
    u64::from(crc32fast::hash(bytes)).to_le_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::GOAL_MAGIC;

    const HEADER: Header = Header {
        cycle_ns: 4_000_000,
        cycles_per_target: 1,
        degraded: 16,
        silent_cycles_max: 50,
        gripper_lead_ns: 120_000_000,
        policy_bytes: 150_000,
    };

    #[test]
    fn a_header_is_what_was_written_and_other_bytes_are_none() {
        let bytes = HEADER.to_bytes();
        assert_eq!(bytes[..16], *b"GENREC3\n\x00\x09\x3d\x00\x00\x00\x00\x00");
        assert_eq!(Header::from_bytes(&bytes), Some(HEADER));
        for at in 0..HEADER_BYTES {
            let mut wrong = bytes;
            wrong[at] ^= 0x80;
            assert_eq!(Header::from_bytes(&wrong), None, "byte {at}");
        }
        let none = Header {
            cycle_ns: 0,
            ..HEADER
        };
        assert_eq!(Header::from_bytes(&none.to_bytes()), None);
    }

    #[test]
    fn a_record_is_what_was_written() {
        let record = Record {
            cycle: 3,
            present: present::GOAL | present::TARGET,
            goal: Goal {
                magic: GOAL_MAGIC,
                x_m: 0.33,
                ..Goal::default()
            },
            ..Record::default()
        };
        let frame = record.to_frame();
        let again = Record::from_frame(&frame).unwrap();
        assert_eq!(again, record);
        for at in 0..FRAME_BYTES {
            let mut wrong = frame;
            wrong[at] ^= 0x04;
            assert_eq!(Record::from_frame(&wrong), None, "byte {at}");
        }
        assert!(again.has(present::GOAL) && !again.has(present::GOAL | present::ROBOT));
        assert_eq!(frame[..8], 3u64.to_le_bytes());
        assert_eq!(frame[40..48], *b"GENGOAL1");
    }
}
