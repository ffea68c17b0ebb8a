//! Recordings: what went into every cycle and what came out, so that a run can be replayed bit for
//! bit. A file is a header and fixed-size records, little endian, written as they lie in memory.

use crate::step::{Controller, Inputs, Output, Setup};
use shared::messages::{Command, Goal, JointTarget, RobotState, Status};
use std::io::{self, Read, Write};

const MAGIC: [u8; 8] = *b"GENREC1\n";

const GOAL: u64 = 1;
const COMMAND: u64 = 2;
const ROBOT: u64 = 4;
const SHUTDOWN: u64 = 8;
const TARGET: u64 = 16;
const STATUS: u64 = 32;

/// One cycle. `present` says which of the messages were there.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct Record {
    now_ns: u64,
    present: u64,
    missed_deadlines: u64,
    messages_lost: u64,
    goal: Goal,
    command: Command,
    robot: RobotState,
    target: JointTarget,
    status: Status,
}

const RECORD_BYTES: usize = size_of::<Record>();
// No padding: the bytes of a record are exactly those of its fields.
const _: () = assert!(RECORD_BYTES == 32 + 40 + 32 + 144 + 160 + 144);

impl Record {
    /// The record of a cycle.
    pub fn new(now_ns: u64, inputs: &Inputs, output: &Output) -> Self {
        let bit = |there: bool, bit: u64| if there { bit } else { 0 };
        Self {
            now_ns,
            present: bit(inputs.goal.is_some(), GOAL)
                | bit(inputs.command.is_some(), COMMAND)
                | bit(inputs.robot.is_some(), ROBOT)
                | bit(inputs.shutdown, SHUTDOWN)
                | bit(output.target.is_some(), TARGET)
                | bit(output.status.is_some(), STATUS),
            missed_deadlines: inputs.missed_deadlines,
            messages_lost: inputs.messages_lost,
            goal: inputs.goal.unwrap_or_default(),
            command: inputs.command.unwrap_or_default(),
            robot: inputs.robot.unwrap_or_default(),
            target: output.target.unwrap_or_default(),
            status: output.status.unwrap_or_default(),
        }
    }

    fn inputs(&self) -> Inputs {
        let has = |bit| self.present & bit != 0;
        Inputs {
            goal: has(GOAL).then_some(self.goal),
            command: has(COMMAND).then_some(self.command),
            robot: has(ROBOT).then_some(self.robot),
            shutdown: has(SHUTDOWN),
            missed_deadlines: self.missed_deadlines,
            messages_lost: self.messages_lost,
        }
    }

    fn bytes(&self) -> &[u8; RECORD_BYTES] {
        // SAFETY: the structure is repr(C) without padding, so every byte is initialised.
        unsafe { &*(self as *const Self).cast() }
    }

    fn from_bytes(bytes: &[u8; RECORD_BYTES]) -> Self {
        // SAFETY: every field is an integer or a float, for which any bits are a value.
        unsafe { std::ptr::read_unaligned(bytes.as_ptr().cast()) }
    }

    fn same_bits(&self, other: &Self) -> bool {
        self.bytes() == other.bytes()
    }
}

/// What a replay must know besides the inputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// [`Setup::cycle_ns`].
    pub cycle_ns: u64,
    /// [`Setup::cycles_per_target`].
    pub cycles_per_target: u32,
    /// [`Setup::degraded`].
    pub degraded: u32,
    /// [`Setup::silent_cycles_max`].
    pub silent_cycles_max: u64,
    /// CRC-32 of the policy file's bytes.
    pub policy_crc: u64,
}

impl Header {
    /// The header of a run with this setup and policy file.
    pub fn new(setup: &Setup, policy_crc: u32) -> Self {
        Self {
            cycle_ns: setup.cycle_ns,
            cycles_per_target: setup.cycles_per_target,
            degraded: setup.degraded,
            silent_cycles_max: setup.silent_cycles_max,
            policy_crc: u64::from(policy_crc),
        }
    }

    fn words(&self) -> [u64; 5] {
        [
            self.cycle_ns,
            u64::from(self.cycles_per_target),
            u64::from(self.degraded),
            self.silent_cycles_max,
            self.policy_crc,
        ]
    }

    /// Writes the head of a recording.
    pub fn write(&self, file: &mut impl Write) -> io::Result<()> {
        file.write_all(&MAGIC)?;
        self.words()
            .iter()
            .try_for_each(|word| file.write_all(&word.to_le_bytes()))
    }

    /// Reads the head of a recording; `None` when these are other bytes.
    pub fn read(file: &mut impl Read) -> io::Result<Option<Self>> {
        let mut magic = [0; MAGIC.len()];
        file.read_exact(&mut magic)?;
        if magic != MAGIC {
            return Ok(None);
        }
        let mut words = [0u64; 5];
        for word in &mut words {
            let mut bytes = [0; 8];
            file.read_exact(&mut bytes)?;
            *word = u64::from_le_bytes(bytes);
        }
        Ok(Some(Self {
            cycle_ns: words[0],
            cycles_per_target: words[1] as u32,
            degraded: words[2] as u32,
            silent_cycles_max: words[3],
            policy_crc: words[4],
        }))
    }
}

/// Appends a record to a recording.
pub fn append(file: &mut impl Write, record: &Record) -> io::Result<()> {
    file.write_all(record.bytes())
}

/// What a replay found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Replay {
    /// Cycles replayed.
    pub cycles: u64,
    /// Targets among them.
    pub targets: u64,
    /// The first cycle (from 0) whose outputs differ in any bit.
    pub first_difference: Option<u64>,
    /// The file ends within a record, as after a crash; the whole records were replayed.
    pub truncated: bool,
}

/// Feeds the recorded inputs to a fresh controller and compares its outputs bit for bit.
pub fn replay(file: &mut impl Read, mut controller: Controller) -> io::Result<Replay> {
    let mut found = Replay::default();
    loop {
        let mut bytes = [0; RECORD_BYTES];
        let filled = read_up_to(file, &mut bytes)?;
        if filled < RECORD_BYTES {
            found.truncated = filled > 0;
            return Ok(found);
        }
        let recorded = Record::from_bytes(&bytes);
        let inputs = recorded.inputs();
        let output = controller.step(&inputs, recorded.now_ns);
        let again = Record::new(recorded.now_ns, &inputs, &output);
        if !again.same_bits(&recorded) && found.first_difference.is_none() {
            found.first_difference = Some(found.cycles);
        }
        found.cycles += 1;
        found.targets += u64::from(output.target.is_some());
    }
}

fn read_up_to(file: &mut impl Read, bytes: &mut [u8]) -> io::Result<usize> {
    let mut filled = 0;
    while filled < bytes.len() {
        match file.read(&mut bytes[filled..])? {
            0 => break,
            more => filled += more,
        }
    }
    Ok(filled)
}
