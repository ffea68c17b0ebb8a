//! The files of a run: written whole or not at all, and a content hash to tell them apart.

use serde::de::DeserializeOwned;
use std::fs::{self, File, TryLockError};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

/// A file operation that failed, with the path and what to do.
#[derive(Debug, thiserror::Error)]
#[error("cannot {action} {}: {cause}; check the path, its permissions and the free space", path.display())]
pub struct FileError {
    action: &'static str,
    path: PathBuf,
    /// Not called `source`: that would be said a second time where all causes of an error are said.
    pub(crate) cause: std::io::Error,
}

impl FileError {
    /// Wraps the error of `action` ("read", "write", ...) on `path`.
    pub fn new(action: &'static str, path: &Path, cause: std::io::Error) -> Self {
        Self {
            action,
            path: path.to_path_buf(),
            cause,
        }
    }
}

/// Writes `bytes` to `path` so that after any crash the path holds the old content or the new, whole:
/// a temporary file in the same folder is synced, renamed over the path, and the folder is synced. What a link points to
/// is written, not the link; what is no file, such as a device, is written to as it stands.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), FileError> {
    let fail = |cause| FileError::new("write", path, cause);
    let target = linked(path);
    let path = target.as_path();
    if fs::metadata(path).is_ok_and(|found| !found.is_file() && !found.is_dir()) {
        let mut device = File::options().write(true).open(path).map_err(fail)?;
        return device.write_all(bytes).map_err(fail);
    }
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    fs::create_dir_all(folder).map_err(fail)?;
    let mut file = tempfile::NamedTempFile::new_in(folder).map_err(fail)?;
    file.write_all(bytes).map_err(fail)?;
    file.as_file().sync_all().map_err(fail)?;
    share_as_usual(file.as_file()).map_err(fail)?;
    file.persist(path).map_err(|error| fail(error.error))?;
    File::open(folder)
        .and_then(|folder| folder.sync_all())
        .map_err(fail)
}

/// Most links that are followed one after the other, as Linux does.
const MOST_LINKS: usize = 40;

/// Where a path leads, also where nothing is there yet.
fn linked(path: &Path) -> PathBuf {
    let mut path = path.to_path_buf();
    for _ in 0..MOST_LINKS {
        let Ok(target) = fs::read_link(&path) else {
            break;
        };
        path = path.parent().unwrap_or(Path::new("")).join(target);
    }
    path
}

/// Makes a folder that is not there, and refuses one that nothing can be written to: after hours of work would be a bad
/// time to say so.
///
/// # Errors
/// It cannot be made or written to, or is a file.
pub fn prepare_folder(path: &Path) -> Result<(), FileError> {
    if path.exists() && !path.is_dir() {
        let cause = std::io::Error::new(ErrorKind::NotADirectory, "it is a file, not a folder");
        return Err(FileError::new("write into", path, cause));
    }
    fs::create_dir_all(linked(path)).map_err(|cause| FileError::new("make", path, cause))?;
    match tempfile::NamedTempFile::new_in(path) {
        Ok(_) => Ok(()),
        Err(cause) => Err(FileError::new("write into", path, cause)),
    }
}

/// Temporary files are private to their user; a result is readable like any other file.
#[cfg(unix)]
fn share_as_usual(file: &File) -> std::io::Result<()> {
    use std::os::unix::fs::PermissionsExt;
    file.set_permissions(fs::Permissions::from_mode(0o644))
}

#[cfg(not(unix))]
fn share_as_usual(_file: &File) -> std::io::Result<()> {
    Ok(())
}

/// The whole content of a file.
pub fn read_whole(path: &Path) -> Result<Vec<u8>, FileError> {
    fs::read(path).map_err(|cause| FileError::new("read", path, cause))
}

/// What an earlier run kept in a JSON file; none where there is no such file or it holds something else.
pub fn kept<T: DeserializeOwned>(path: &Path) -> Option<T> {
    serde_json::from_slice(&fs::read(path).ok()?).ok()
}

/// A binary file that is not whole, or not of the expected kind.
#[derive(Debug, thiserror::Error)]
#[error("{} is damaged or of another version: delete it and run the step that makes it again", path.display())]
pub struct SealError {
    path: PathBuf,
}

/// Bytes in front of a sealed payload: kind (8), payload length (4), CRC-32 of kind and payload (4).
const SEAL_BYTES: usize = 16;

/// Puts a header in front of `payload` that shows damage and mix-ups; `kind` names format and version.
pub fn seal(kind: &[u8; 8], payload: &[u8]) -> Vec<u8> {
    let mut bytes = kind.to_vec();
    bytes.extend((payload.len() as u32).to_le_bytes());
    bytes.extend(seal_crc(kind, payload).to_le_bytes());
    bytes.extend(payload);
    bytes
}

/// Reads a file that [`seal`] made and returns its payload.
pub fn read_sealed(kind: &[u8; 8], path: &Path) -> anyhow::Result<Vec<u8>> {
    let mut bytes = read_whole(path)?;
    let damaged = || SealError {
        path: path.to_path_buf(),
    };
    let (header, payload) = bytes.split_first_chunk::<SEAL_BYTES>().ok_or_else(damaged)?;
    let length = (payload.len() as u32).to_le_bytes();
    let crc = seal_crc(kind, payload).to_le_bytes();
    if header[..8] != *kind || header[8..12] != length || header[12..] != crc {
        return Err(damaged().into());
    }
    bytes.drain(..SEAL_BYTES);
    Ok(bytes)
}

fn seal_crc(kind: &[u8; 8], payload: &[u8]) -> u32 {
    let mut crc = crc32fast::Hasher::new();
    crc.update(kind);
    crc.update(payload);
    crc.finalize()
}

/// 64-bit FNV-1a hash (Fowler, Noll and Vo): tells contents apart by mistake, not against an attacker.
#[derive(Clone, Copy, Debug)]
pub struct Fnv64(u64);

impl Default for Fnv64 {
    fn default() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }
}

impl Fnv64 {
    /// Adds bytes.
    pub fn add(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }

    /// The hash of everything added.
    pub fn value(&self) -> u64 {
        self.0
    }

    /// The hash of `bytes`.
    pub fn of(bytes: &[u8]) -> u64 {
        let mut hash = Self::default();
        hash.add(bytes);
        hash.value()
    }
}

/// What results of this program depend on besides their inputs: its version and the revisions of simulator and diagnosis.
pub fn made_by() -> String {
    format!(
        "{} simulator {} diagnosis {}",
        crate::PROGRAM,
        crate::sim::REVISION,
        crate::diagnose::REVISION
    )
}

/// A hash as files and people have it: hexadecimal.
pub fn hex(hash: u64) -> String {
    format!("{hash:016x}")
}

/// The folder `runs/<name>/` and the names of the files in it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RunFolder {
    path: PathBuf,
}

impl RunFolder {
    /// The run at `path`, to write to; it is made if it is not there.
    ///
    /// # Errors
    /// Nothing can be written to it.
    pub fn open(path: &Path) -> Result<Self, FileError> {
        prepare_folder(path)?;
        Ok(Self::there(path))
    }

    /// The run at `path`, to read from.
    pub fn there(path: &Path) -> Self {
        Self {
            path: path.to_path_buf(),
        }
    }

    /// Keeps other programs that ask for it out of the folder for as long as the result lives; what a killed one held is
    /// free. Where folders cannot be locked nobody is kept out.
    ///
    /// # Errors
    /// Another program works in the folder.
    pub fn hold(&self) -> anyhow::Result<Option<File>> {
        let Ok(folder) = File::open(&self.path) else {
            return Ok(None);
        };
        anyhow::ensure!(
            !matches!(folder.try_lock(), Err(TryLockError::WouldBlock)),
            "another run works in {}: wait for its end, or name another folder with --out",
            self.path.display()
        );
        Ok(Some(folder))
    }

    /// The folder itself.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Fit of the declared parameters.
    pub fn fit(&self) -> PathBuf {
        self.path.join("fit.json")
    }

    /// Residual of the fit.
    pub fn residual(&self) -> PathBuf {
        self.path.join("residual.json")
    }

    /// What was missing in the model.
    pub fn diagnosis(&self) -> PathBuf {
        self.path.join("diagnosis.json")
    }

    /// Intervals of the final model by profile likelihood.
    pub fn profile(&self) -> PathBuf {
        self.path.join("profile.json")
    }

    /// The same of the base model, which nobody has diagnosed.
    pub fn base_profile(&self) -> PathBuf {
        self.path.join("base_profile.json")
    }

    /// What an unfinished diagnosis has come to; removed once it is done.
    pub fn memory(&self) -> PathBuf {
        self.path.join("diagnosis.part")
    }

    /// What the rope is.
    pub fn model(&self) -> PathBuf {
        self.path.join("model.toml")
    }

    /// Folder of rollouts: `0` is for the random design, `n` for the answers of the policy in round n; each holds a folder
    /// per plan and model.
    pub fn rollouts(&self, round: usize) -> PathBuf {
        self.path.join("rollouts").join(round.to_string())
    }

    /// Evaluation of the policy.
    pub fn evaluation(&self) -> PathBuf {
        self.path.join("evaluation.json")
    }

    /// The same answers swung on a finer grid.
    pub fn finer_evaluation(&self) -> PathBuf {
        self.path.join("evaluation-finer-grid.json")
    }

    /// Network weights, normaliser and ranges.
    pub fn weights(&self) -> PathBuf {
        self.path.join("weights.bin")
    }

    /// How training went.
    pub fn training(&self) -> PathBuf {
        self.path.join("training.json")
    }

    /// What the controller loads.
    pub fn blob(&self) -> PathBuf {
        self.path.join("policy.blob")
    }

    /// Tables for reading.
    pub fn tables(&self) -> PathBuf {
        self.path.join("tables.md")
    }

    /// Figures for looking.
    pub fn report(&self) -> PathBuf {
        self.path.join("report.html")
    }

    /// Command, seed, versions, wall time and hashes.
    pub fn record(&self) -> PathBuf {
        self.path.join("run.json")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_used_by_one_run_at_a_time() {
        let folder = tempfile::tempdir().unwrap();
        let run = RunFolder::open(folder.path()).unwrap();
        let held = run.hold().unwrap();
        let refused = run.hold().unwrap_err().to_string();
        assert!(refused.contains("another run works in"), "{refused}");
        drop(held);
        run.hold().unwrap();
    }

    #[test]
    fn a_written_file_replaces_the_old_one_and_leaves_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deep").join("file.bin");
        write_whole(&path, b"old").unwrap();
        write_whole(&path, b"new and longer").unwrap();
        assert_eq!(read_whole(&path).unwrap(), b"new and longer");
        assert_eq!(fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
    }

    /// Seen: `--out /dev/full` of an administrator made the device a plain file.
    #[cfg(unix)]
    #[test]
    fn links_and_what_is_no_file_stay_what_they_are() {
        use std::io::Read;
        use std::os::unix::fs::FileTypeExt;
        let folder = tempfile::tempdir().unwrap();
        let (target, link) = (folder.path().join("target"), folder.path().join("link"));
        fs::write(&target, b"old").unwrap();
        std::os::unix::fs::symlink(&target, &link).unwrap();
        write_whole(&link, b"new").unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read(&target).unwrap(), b"new");
        fs::remove_file(&target).unwrap();
        write_whole(&link, b"first").unwrap();
        assert_eq!(fs::read(&target).unwrap(), b"first");
        let (place, there) = (folder.path().join("place"), folder.path().join("there"));
        std::os::unix::fs::symlink("there", &place).unwrap();
        prepare_folder(&place).unwrap();
        assert!(there.is_dir());

        let pipe = folder.path().join("pipe");
        let made = std::process::Command::new("mkfifo").arg(&pipe).status().unwrap();
        assert!(made.success());
        let reader = std::thread::spawn({
            let pipe = pipe.clone();
            move || {
                let mut read = Vec::new();
                File::open(pipe).unwrap().read_to_end(&mut read).unwrap();
                read
            }
        });
        write_whole(&pipe, b"through").unwrap();
        // Before the reader is waited for, which would wait for ever where a file took the pipe's place.
        assert!(fs::metadata(&pipe).unwrap().file_type().is_fifo());
        assert_eq!(reader.join().unwrap(), b"through");
    }

    #[test]
    fn a_folder_that_is_a_file_is_refused_before_any_work() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        fs::write(&file, b"kept").unwrap();
        let refused = prepare_folder(&file).unwrap_err().to_string();
        assert!(refused.contains("it is a file, not a folder"), "{refused}");
        assert_eq!(fs::read(&file).unwrap(), b"kept");
        prepare_folder(&folder.path().join("new")).unwrap();
    }

    #[test]
    fn a_failed_write_leaves_the_old_content() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("taken");
        fs::create_dir(&path).unwrap();
        fs::write(path.join("inside"), b"kept").unwrap();
        let message = write_whole(&path, b"new").unwrap_err().to_string();
        assert!(
            message.contains("taken") && message.contains("check the path"),
            "{message}"
        );
        let with_causes = format!(
            "{:#}",
            anyhow::Error::from(write_whole(&path, b"new").unwrap_err())
        );
        assert_eq!(with_causes, message, "a cause is said twice");
        assert_eq!(fs::read(path.join("inside")).unwrap(), b"kept");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_sealed_file_opens_only_whole_and_as_its_kind() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sealed.bin");
        let bytes = seal(b"kind/001", b"payload");
        write_whole(&path, &bytes).unwrap();
        assert_eq!(read_sealed(b"kind/001", &path).unwrap(), b"payload");
        assert!(read_sealed(b"kind/002", &path).is_err());
        for at in 0..bytes.len() {
            let mut damaged = bytes.clone();
            damaged[at] ^= 0x10;
            write_whole(&path, &damaged).unwrap();
            assert!(read_sealed(b"kind/001", &path).is_err(), "byte {at}");
            write_whole(&path, &bytes[..at]).unwrap();
            assert!(read_sealed(b"kind/001", &path).is_err(), "cut at {at}");
        }
    }

    #[test]
    fn the_hash_is_fnv_1a() {
        // Test vectors of the authors' reference implementation.
        assert_eq!(Fnv64::of(b""), 0xcbf2_9ce4_8422_2325);
        assert_eq!(Fnv64::of(b"a"), 0xaf63_dc4c_8601_ec8c);
        assert_eq!(Fnv64::of(b"foobar"), 0x8594_4171_f739_67e8);
    }
}
