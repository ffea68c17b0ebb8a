//! Recordings: turns each cycle into a record, writes them from a thread of their own so that a slow
//! disk holds up nobody, and replays a file bit for bit.

use crate::clock;
use crate::cycle::Queues;
use crate::step::{Controller, Inputs, Output, Setup};
use crate::voice::{Event, Voice};
use shared::recording::{FRAME_BYTES, HEADER_BYTES, Header, Record, present};
use std::fs::File;
use std::io::{self, BufWriter, ErrorKind, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread::JoinHandle;
use std::time::Duration;

/// Pause of the writing thread; the queue holds two seconds.
const PAUSE: Duration = Duration::from_millis(5);

/// How long the end waits for a disk that does not take the rest.
const LAST_WORDS: Duration = Duration::from_secs(2);

/// The record of a cycle.
pub fn record(cycle: u64, now_ns: u64, inputs: &Inputs, output: &Output) -> Record {
    let bit = |there: bool, bit: u64| if there { bit } else { 0 };
    Record {
        cycle,
        now_ns,
        present: bit(inputs.goal.is_some(), present::GOAL)
            | bit(inputs.command.is_some(), present::COMMAND)
            | bit(inputs.robot.is_some(), present::ROBOT)
            | bit(inputs.shutdown, present::SHUTDOWN)
            | bit(output.target.is_some(), present::TARGET)
            | bit(output.status.is_some(), present::STATUS),
        missed_deadlines: inputs.missed_deadlines,
        messages_lost: inputs.messages_lost,
        goal: inputs.goal.unwrap_or_default(),
        command: inputs.command.unwrap_or_default(),
        robot: inputs.robot.unwrap_or_default(),
        target: output.target.unwrap_or_default(),
        status: output.status.unwrap_or_default(),
    }
}

fn inputs_of(record: &Record) -> Inputs {
    Inputs {
        goal: record.has(present::GOAL).then_some(record.goal),
        command: record.has(present::COMMAND).then_some(record.command),
        robot: record.has(present::ROBOT).then_some(record.robot),
        shutdown: record.has(present::SHUTDOWN),
        missed_deadlines: record.missed_deadlines,
        messages_lost: record.messages_lost,
    }
}

/// The header of a run with this setup and a policy file of this length.
pub fn header(setup: &Setup, policy_bytes: usize) -> Header {
    Header {
        cycle_ns: setup.cycle_ns,
        cycles_per_target: setup.cycles_per_target,
        degraded: setup.degraded,
        silent_cycles_max: setup.silent_cycles_max,
        gripper_lead_ns: setup.gripper_lead_ns,
        policy_bytes: policy_bytes as u64,
    }
}

/// The thread that empties the queue of records into the file.
pub struct Recorder {
    thread: JoinHandle<io::Result<()>>,
}

impl Recorder {
    /// Creates the file, writes what comes before the records, and starts the thread; when the disk takes
    /// no more, `voice` tells so at once.
    pub fn start(
        path: &Path,
        header: &Header,
        policy: &[u8],
        queues: &Arc<Queues>,
        voice: Voice,
    ) -> io::Result<Self> {
        let mut file = BufWriter::new(create(path)?);
        file.write_all(&header.to_bytes())?;
        file.write_all(policy)?;
        let queues = Arc::clone(queues);
        let thread = std::thread::Builder::new()
            .name("recorder".to_string())
            .spawn(move || {
                drain(&mut file, &queues).inspect_err(|error| {
                    voice.say(Event::Failure {
                        text: format!("the recording ends here: {error}"),
                    });
                })
            })?;
        Ok(Self { thread })
    }

    /// Waits for the last records, but not for ever; fails when the disk did not take all.
    pub fn finish(self) -> io::Result<()> {
        if !clock::ends_within(&self.thread, LAST_WORDS) {
            return Err(io::Error::other("the disk did not take the rest in time"));
        }
        self.thread
            .join()
            .unwrap_or_else(|_| Err(io::Error::other("its thread panicked")))
    }
}

/// Creates the file, never in place of another: what was recorded is not measured again. A pipe or a device
/// that exists is written into; there is nothing in it to lose.
fn create(path: &Path) -> io::Result<File> {
    match File::create_new(path) {
        Err(error) if error.kind() == ErrorKind::AlreadyExists && !path.is_file() => {
            // Without a reader a pipe would hold up the start for ever; this fails at once.
            let _reader_is_there = File::options()
                .write(true)
                .custom_flags(libc::O_NONBLOCK)
                .open(path)
                .map_err(|error| match error.raw_os_error() {
                    Some(libc::ENXIO) => io::Error::other("nobody reads this pipe: start its reader first"),
                    _ => error,
                })?;
            File::options().write(true).open(path)
        }
        outcome => outcome,
    }
}

fn drain(file: &mut impl Write, queues: &Queues) -> io::Result<()> {
    let Some(records) = &queues.records else {
        return Ok(());
    };
    loop {
        // Asked before the queue is emptied, so that the last records are not missed.
        let ended = queues.ended.load(Ordering::Acquire);
        for record in records.drain() {
            file.write_all(&record.to_frame())?;
        }
        if ended {
            return file.flush();
        }
        std::thread::sleep(PAUSE);
    }
}

/// The head of a recording.
pub struct Head {
    /// How the run was set up.
    pub header: Header,
    /// The policy file of the run.
    pub policy: Vec<u8>,
}

/// Reads what comes before the records; `None` when these are other bytes.
pub fn read_head(file: &mut impl Read) -> io::Result<Option<Head>> {
    let mut bytes = [0; HEADER_BYTES];
    if read_up_to(file, &mut bytes)? < HEADER_BYTES {
        return Ok(None);
    }
    let Some(header) = Header::from_bytes(&bytes) else {
        return Ok(None);
    };
    let mut policy = vec![0; header.policy_bytes as usize];
    file.read_exact(&mut policy)?;
    Ok(Some(Head { header, policy }))
}

/// What a replay found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Replay {
    /// Cycles replayed.
    pub cycles: u64,
    /// Targets among them.
    pub targets: u64,
    /// The first cycle whose outputs differ in any bit.
    pub first_difference: Option<u64>,
    /// The cycle after which some are missing, because the disk was too slow; the replay ends there.
    pub gap_after: Option<u64>,
    /// The file ends within a record, as after a crash; the whole records were replayed.
    pub truncated: bool,
    /// The cycle after which the file is damaged; the replay ends there.
    pub damaged_after: Option<u64>,
}

/// Feeds the recorded inputs to a fresh controller and compares its outputs bit for bit.
pub fn replay(file: &mut impl Read, mut controller: Controller) -> io::Result<Replay> {
    let mut found = Replay::default();
    loop {
        let mut bytes = [0; FRAME_BYTES];
        let filled = read_up_to(file, &mut bytes)?;
        if filled < FRAME_BYTES {
            found.truncated = filled > 0;
            return Ok(found);
        }
        let Some(recorded) = Record::from_frame(&bytes) else {
            found.damaged_after = Some(found.cycles);
            return Ok(found);
        };
        if recorded.cycle != found.cycles + 1 {
            found.gap_after = Some(found.cycles);
            return Ok(found);
        }
        let inputs = inputs_of(&recorded);
        let output = controller.step(&inputs, recorded.now_ns);
        let again = record(controller.cycles(), recorded.now_ns, &inputs, &output);
        if again.bytes() != recorded.bytes() && found.first_difference.is_none() {
            found.first_difference = Some(recorded.cycle);
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::ffi::OsStrExt;

    /// The start once waited for a reader for ever.
    #[test]
    fn a_pipe_that_nobody_reads_is_refused_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        let name = std::ffi::CString::new(pipe.as_os_str().as_bytes()).unwrap();
        // SAFETY: the name is a string that ends with a zero.
        assert_eq!(unsafe { libc::mkfifo(name.as_ptr(), 0o600) }, 0);
        let refused = create(&pipe).unwrap_err().to_string();
        assert!(refused.contains("nobody reads this pipe"), "{refused}");
        let reader = File::options()
            .read(true)
            .custom_flags(libc::O_NONBLOCK)
            .open(&pipe)
            .unwrap();
        assert!(create(&pipe).is_ok());
        drop(reader);
    }
}
