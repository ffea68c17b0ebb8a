//! The file of a recorded run: what went into every cycle of the controller and what came out, together
//! with the policy file that answered, so that the run can be replayed bit for bit from this file alone.
//!
//! ```text
//! 0   8   magic "GENREC2\n"
//! 8   48  the words of `Header`, 64 bits each
//! 56  ..  the policy file, byte for byte
//! ..  568 a `Record` per cycle, as it lies in memory, until the file ends
//! ```
//!
//! Everything is little endian. A file that ends within a record (a crash) is whole up to there; cycle
//! numbers that skip show where the disk was too slow.

use crate::messages::{Command, Goal, JointTarget, RobotState, Status};

/// First bytes of every recording.
pub const MAGIC: [u8; 8] = *b"GENREC2\n";

/// Bytes before the policy file.
pub const HEADER_BYTES: usize = MAGIC.len() + 6 * size_of::<u64>();

/// Bytes of one record.
pub const RECORD_BYTES: usize = size_of::<Record>();

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
        bytes
    }

    /// The header in the first bytes of a file; `None` when they are something else.
    pub fn from_bytes(bytes: &[u8; HEADER_BYTES]) -> Option<Self> {
        let words = bytes.strip_prefix(&MAGIC)?;
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

    /// The record as it lies in the file.
    pub fn bytes(&self) -> &[u8; RECORD_BYTES] {
        // SAFETY: the structure is repr(C) without padding, so every byte is initialised.
        unsafe { &*(self as *const Self).cast() }
    }

    /// The record that lies in the file as these bytes.
    pub fn from_bytes(bytes: &[u8; RECORD_BYTES]) -> Self {
        // SAFETY: every field is an integer or a float, for which any bits are a value.
        unsafe { core::ptr::read_unaligned(bytes.as_ptr().cast()) }
    }
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
        assert_eq!(bytes[..16], *b"GENREC2\n\x00\x09\x3d\x00\x00\x00\x00\x00");
        assert_eq!(Header::from_bytes(&bytes), Some(HEADER));
        for at in [0, 7, 15, 20, 30, 55] {
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
        let again = Record::from_bytes(record.bytes());
        assert_eq!(again, record);
        assert!(again.has(present::GOAL) && !again.has(present::GOAL | present::ROBOT));
        assert_eq!(record.bytes()[..8], 3u64.to_le_bytes());
        assert_eq!(record.bytes()[40..48], *b"GENGOAL1");
    }
}
