//! Reads the policy file, once, before the loop starts.

use shared::blob::{self, Blob, BlobError, MAX_BLOB_BYTES};
use std::fs::File;
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};

/// Why there is no policy.
#[derive(Debug, thiserror::Error)]
pub enum PolicyFileError {
    /// The file cannot be read.
    #[error("cannot read the policy file {0}: {1}; {remedy}", remedy = remedy(.1))]
    Read(PathBuf, std::io::Error),
    /// The file holds no usable policy.
    #[error("{0}: {1}")]
    Blob(PathBuf, BlobError),
}

fn remedy(error: &std::io::Error) -> &'static str {
    match error.kind() {
        ErrorKind::NotFound => "write one with `offline freeze`",
        ErrorKind::PermissionDenied => "let this user read it",
        _ => "give a file that `offline freeze` wrote",
    }
}

/// A policy file in memory.
pub struct PolicyFile {
    /// What it holds.
    pub blob: Box<Blob>,
    /// The file itself, byte for byte, for recordings.
    pub bytes: Vec<u8>,
}

/// Reads and checks the file at `path`.
pub fn read(path: &Path) -> Result<PolicyFile, PolicyFileError> {
    let mut bytes = Vec::with_capacity(MAX_BLOB_BYTES);
    // One byte more than any blob has, so that a wrong huge file is refused without reading it all.
    File::open(path)
        .and_then(|file| file.take(MAX_BLOB_BYTES as u64 + 1).read_to_end(&mut bytes))
        .map_err(|error| PolicyFileError::Read(path.to_path_buf(), error))?;
    checked(path, bytes)
}

/// Checks a policy file's bytes, which were read from `path`.
pub fn checked(path: &Path, bytes: Vec<u8>) -> Result<PolicyFile, PolicyFileError> {
    let blob = blob::parse(&bytes).map_err(|error| PolicyFileError::Blob(path.to_path_buf(), error))?;
    Ok(PolicyFile {
        blob: Box::new(blob),
        bytes,
    })
}

/// Writes `blob` to the file at `path`.
pub fn write(path: &Path, blob: &Blob) -> anyhow::Result<()> {
    let mut buffer = vec![0; MAX_BLOB_BYTES];
    let bytes = blob::write(blob, &mut buffer)?;
    std::fs::write(path, bytes)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample;

    #[test]
    fn what_is_written_is_read_and_damage_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("policy.blob");
        write(&path, &sample::blob()).unwrap();
        assert_eq!(read(&path).unwrap().blob, sample::blob());
        let mut bytes = std::fs::read(&path).unwrap();
        bytes[5000] ^= 1;
        std::fs::write(&path, bytes).unwrap();
        let message = read(&path).err().unwrap().to_string();
        assert!(
            message.contains("policy.blob") && message.contains("damaged"),
            "{message}"
        );
        assert!(read(folder.path()).is_err());
    }
}
