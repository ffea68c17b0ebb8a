//! Where one running controller keeps its files: an instance has a lock that only one process holds,
//! and every start gets a session of its own, so that nothing a killed process left half made can
//! stop the next start, and a client of the old session never touches the files of the new one.
//!
//! ```text
//! /tmp/genorm-<uid>/<instance>.lock        held by the running controller
//! /tmp/genorm-<uid>/<instance>/current     what clients must know to connect, a word and a value a line:
//!                                          session <session>, protocol <number>, iceoryx2 <version>
//! /tmp/genorm-<uid>/<instance>/<session>/  iceoryx2's management files
//! /dev/shm/genorm.<uid>.<instance>.<session>.*   iceoryx2's shared memory
//! ```

use iceoryx2::prelude::{Config, FileName, Path as IoxPath, SemanticString};
use shared::messages::PROTOCOL;
use std::fs::{self, File};
use std::io::{ErrorKind, Write};
use std::os::fd::AsRawFd;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// The instance used when none is named.
pub const DEFAULT_INSTANCE: &str = "genorm";

/// A killed process frees its lock only when the kernel has taken it down.
const LOCK_PATIENCE: Duration = Duration::from_secs(1);

/// Where Linux shows shared memory as files.
pub const SHARED_MEMORY: &str = "/dev/shm";

/// What the controller's services take (4 MB), and as much again for clients.
const SHARED_MEMORY_NEEDED: u64 = 8_000_000;

/// Release line of iceoryx2; participants of another line cannot read its files.
pub const ICEORYX2: &str = "0.10";

/// Why there is no session.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// Not a usable name.
    #[error("instance {0:?} is not a name: use 1 to 24 of the characters a-z, 0-9 and '-'")]
    Name(String),
    /// Another process holds the lock.
    #[error("a controller runs already as instance {0:?} (process {1}): stop it, or use --instance")]
    Running(String, String),
    /// No controller runs.
    #[error("no controller runs as instance {0:?}: start one with `controller --policy FILE --instance {0}`")]
    NotRunning(String),
    /// The controller and this client were built from different versions.
    #[error(
        "the controller of instance {instance:?} speaks {theirs}, this client speaks {ours}: \
         build both from one version"
    )]
    Version {
        /// The instance.
        instance: String,
        /// What the controller announced.
        theirs: String,
        /// What this client was built with.
        ours: String,
    },
    /// The operating system refused.
    #[error("{what} {path}: {reason}; check that the folder belongs to this user")]
    Io {
        /// What was tried.
        what: &'static str,
        /// On which file.
        path: PathBuf,
        /// What came back; named so that it is not said twice.
        reason: std::io::Error,
    },
    /// Whoever may write there could lead clients, and their stops, elsewhere.
    #[error("{0} is not a folder that only this user may write to: remove it, or let its owner do so")]
    NotOurs(PathBuf),
    /// Writing into memory that the kernel then cannot supply would end the process without a word.
    #[error(
        "{SHARED_MEMORY} has {free_mb} MB left and {needed_mb} are needed: remove what fills it, or enlarge it (in a container: --shm-size=64m)"
    )]
    SharedMemoryFull {
        /// What is left, MB.
        free_mb: u64,
        /// What is needed, MB.
        needed_mb: u64,
    },
    /// iceoryx2 does not take the path.
    #[error("{0} is no path for iceoryx2")]
    Path(PathBuf),
}

/// Refuses a folder that others made or may write to: everybody may make one in `/tmp`.
fn check_ours(folder: &Path) -> Result<(), SessionError> {
    let found = fs::symlink_metadata(folder).map_err(io("cannot look at", folder))?;
    // SAFETY: reads a number of this process.
    let user = unsafe { libc::geteuid() };
    if found.is_dir() && found.uid() == user && found.mode() & 0o022 == 0 {
        Ok(())
    } else {
        Err(SessionError::NotOurs(folder.to_path_buf()))
    }
}

fn io(what: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> SessionError {
    let path = path.to_path_buf();
    move |reason| SessionError::Io { what, path, reason }
}

/// A checked instance name and its places.
#[derive(Clone, Debug)]
pub struct Instance {
    name: String,
    uid: u32,
}

impl Instance {
    /// The instance called `name`, of this user.
    pub fn new(name: &str) -> Result<Self, SessionError> {
        let fits = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
        if name.is_empty() || name.len() > 24 || !name.chars().all(fits) {
            return Err(SessionError::Name(name.to_string()));
        }
        Ok(Self {
            name: name.to_string(),
            // SAFETY: the call has no preconditions and cannot fail.
            uid: unsafe { libc::getuid() },
        })
    }

    /// Its name.
    pub fn name(&self) -> &str {
        &self.name
    }

    fn base(&self) -> PathBuf {
        PathBuf::from(format!("/tmp/genorm-{}", self.uid))
    }

    fn folder(&self) -> PathBuf {
        self.base().join(&self.name)
    }

    fn lock_file(&self) -> PathBuf {
        self.base().join(format!("{}.lock", self.name))
    }

    fn current_file(&self) -> PathBuf {
        self.folder().join("current")
    }

    /// How the names of its shared memory begin. No two instances' prefixes start alike: names hold no '.'.
    pub fn prefix(&self) -> String {
        format!("genorm.{}.{}.", self.uid, self.name)
    }

    fn config(&self, session: &str) -> Result<Config, SessionError> {
        let root = self.folder().join(session);
        let bad = || SessionError::Path(root.clone());
        let text = root.to_str().ok_or_else(bad)?;
        let mut config = Config::default();
        config
            .global
            .set_root_path(&IoxPath::new(text.as_bytes()).map_err(|_| bad())?);
        let prefix = format!("{}{session}.", self.prefix());
        config.global.prefix = FileName::new(prefix.as_bytes()).map_err(|_| bad())?;
        // Whoever connects next clears away what the dead left: nothing that ends has to wait for that.
        config.global.node.cleanup_dead_nodes_on_destruction = false;
        Ok(config)
    }

    /// The configuration of the session that a running controller announced.
    pub fn running_config(&self) -> Result<Config, SessionError> {
        let not_running = || SessionError::NotRunning(self.name.clone());
        let lock = File::open(self.lock_file()).map_err(|_| not_running())?;
        check_ours(&self.base())?;
        if !lock_is_held(&lock) {
            return Err(not_running());
        }
        let text = fs::read_to_string(self.current_file()).map_err(|_| not_running())?;
        let announced = Announcement::parse(&text);
        let ours = Announcement::new(&announced.session);
        if announced.versions() != ours.versions() {
            return Err(SessionError::Version {
                instance: self.name.clone(),
                theirs: announced.versions(),
                ours: ours.versions(),
            });
        }
        self.config(&announced.session)
    }

    /// Takes the lock, removes what earlier sessions left and names a new session.
    pub fn start(&self) -> Result<Session, SessionError> {
        let base = self.base();
        fs::DirBuilder::new()
            .recursive(true)
            .mode(0o700)
            .create(&base)
            .map_err(io("cannot create", &base))?;
        check_ours(&base)?;
        let lock = self.take_lock()?;
        self.wipe()?;
        check_shared_memory(SHARED_MEMORY_NEEDED)?;
        let since_epoch = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let name = format!("{:x}-{:x}", since_epoch.as_nanos(), std::process::id());
        let folder = self.folder().join(&name);
        fs::create_dir_all(&folder).map_err(io("cannot create", &folder))?;
        Ok(Session {
            config: self.config(&name)?,
            instance: self.clone(),
            name,
            _lock: lock,
        })
    }

    fn take_lock(&self) -> Result<File, SessionError> {
        let path = self.lock_file();
        let mut file = fs::OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .mode(0o600)
            .open(&path)
            .map_err(io("cannot open", &path))?;
        let start = Instant::now();
        while !lock_now(&file) {
            if start.elapsed() > LOCK_PATIENCE {
                let holder = fs::read_to_string(&path).unwrap_or_default();
                return Err(SessionError::Running(
                    self.name.clone(),
                    holder.trim().to_string(),
                ));
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        file.set_len(0)
            .and_then(|()| writeln!(file, "{}", std::process::id()))
            .map_err(io("cannot write", &path))?;
        Ok(file)
    }

    /// Only under the lock: no controller of this instance runs, so all of this is left over. What a
    /// client of an old session makes meanwhile stays for the next start; no new session meets it.
    fn wipe(&self) -> Result<(), SessionError> {
        let current = self.current_file();
        match fs::remove_file(&current) {
            Err(error) if error.kind() != ErrorKind::NotFound => {
                return Err(io("cannot remove", &current)(error));
            }
            _ => {}
        }
        let _ = fs::remove_dir_all(self.folder());
        self.shared_memory().for_each(|path| {
            let _ = fs::remove_file(path);
        });
        Ok(())
    }

    /// The files of shared memory of every session of this instance.
    pub fn shared_memory(&self) -> impl Iterator<Item = PathBuf> {
        let prefix = self.prefix();
        let entries = fs::read_dir(SHARED_MEMORY).into_iter().flatten().flatten();
        entries
            .filter(move |entry| entry.file_name().to_string_lossy().starts_with(&prefix))
            .map(|entry| entry.path())
    }

    /// Removes everything that this instance left, its lock file included; refused while it runs.
    pub fn purge(&self) -> Result<(), SessionError> {
        let lock = self.lock_file();
        if !lock.exists() {
            return Ok(());
        }
        let _held = self.take_lock()?;
        self.wipe()?;
        fs::remove_file(&lock).map_err(io("cannot remove", &lock))
    }
}

/// What a running controller tells those who want to connect.
struct Announcement {
    session: String,
    protocol: String,
    iceoryx2: String,
}

impl Announcement {
    fn new(session: &str) -> Self {
        Self {
            session: session.to_string(),
            protocol: PROTOCOL.to_string(),
            iceoryx2: ICEORYX2.to_string(),
        }
    }

    fn text(&self) -> String {
        format!(
            "session {}\nprotocol {}\niceoryx2 {}\n",
            self.session, self.protocol, self.iceoryx2
        )
    }

    /// Words that are not there are empty; words of later versions are passed over.
    fn parse(text: &str) -> Self {
        let value = |word: &str| {
            let mut lines = text.lines().filter_map(|line| line.split_once(' '));
            let found = lines.find(|(key, _)| *key == word);
            found.map_or(String::new(), |(_, value)| value.trim().to_string())
        };
        Self {
            session: value("session"),
            protocol: value("protocol"),
            iceoryx2: value("iceoryx2"),
        }
    }

    fn versions(&self) -> String {
        if self.protocol.is_empty() {
            return "a protocol without a number".to_string();
        }
        format!("protocol {} over iceoryx2 {}", self.protocol, self.iceoryx2)
    }
}

/// A started session; the lock is held until this is dropped.
pub struct Session {
    instance: Instance,
    name: String,
    config: Config,
    _lock: File,
}

impl Session {
    /// iceoryx2's configuration: own root, own prefix, nothing from the working folder.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Tells clients to connect here; call it when every service exists.
    pub fn announce(&self) -> Result<(), SessionError> {
        let path = self.instance.current_file();
        let draft = path.with_extension("new");
        fs::write(&draft, Announcement::new(&self.name).text()).map_err(io("cannot write", &draft))?;
        fs::rename(&draft, &path).map_err(io("cannot write", &path))
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        // Clients stop looking here; the files of the session go with the services or the next start.
        let _ = fs::remove_file(self.instance.current_file());
    }
}

/// Whether shared memory has that many bytes left; where it cannot be asked, iceoryx2 will say what is wrong.
fn check_shared_memory(needed: u64) -> Result<(), SessionError> {
    let path = std::ffi::CString::new(SHARED_MEMORY).expect("no zero within");
    // SAFETY: the structure is plain numbers that the kernel fills, and the path outlives the call.
    let free = unsafe {
        let mut room: libc::statvfs = std::mem::zeroed();
        let answered = libc::statvfs(path.as_ptr(), &mut room) == 0;
        answered.then_some(room.f_bavail as u64 * room.f_frsize as u64)
    };
    match free {
        Some(free) if free < needed => Err(SessionError::SharedMemoryFull {
            free_mb: free / 1_000_000,
            needed_mb: needed / 1_000_000,
        }),
        _ => Ok(()),
    }
}

fn whole_file_lock() -> libc::flock {
    // SAFETY: the structure is plain numbers, zero is a value of each.
    let mut lock: libc::flock = unsafe { std::mem::zeroed() };
    lock.l_type = libc::F_WRLCK as libc::c_short;
    lock.l_whence = libc::SEEK_SET as libc::c_short;
    lock
}

/// A lock of the open file, which the kernel frees when the process ends, however it ends.
fn lock_now(file: &File) -> bool {
    let lock = whole_file_lock();
    // SAFETY: the descriptor is open and the structure outlives the call.
    unsafe { libc::fcntl(file.as_raw_fd(), libc::F_OFD_SETLK, &lock) == 0 }
}

/// Asks without taking it, so that a client never stands in the way of a start.
fn lock_is_held(file: &File) -> bool {
    let mut lock = whole_file_lock();
    // SAFETY: as above; the kernel writes who holds it into the structure.
    let answered = unsafe { libc::fcntl(file.as_raw_fd(), libc::F_OFD_GETLK, &mut lock) == 0 };
    answered && lock.l_type != libc::F_UNLCK as libc::c_short
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn names_are_checked() {
        for bad in [
            "",
            "a_b",
            "a.b",
            "../x",
            "UPPER",
            "a-name-that-is-too-long-to-take",
        ] {
            assert!(Instance::new(bad).is_err(), "{bad}");
        }
        assert!(Instance::new("arm-2").is_ok());
    }

    #[test]
    fn a_folder_that_others_may_write_to_is_not_used() {
        let folder = std::env::temp_dir().join(format!("genorm-test-{}", std::process::id()));
        for (mode, ours) in [(0o700, true), (0o755, true), (0o777, false), (0o720, false)] {
            fs::create_dir(&folder).unwrap();
            fs::set_permissions(&folder, fs::Permissions::from_mode(mode)).unwrap();
            assert_eq!(check_ours(&folder).is_ok(), ours, "{mode:o}");
            fs::remove_dir(&folder).unwrap();
        }
        std::os::unix::fs::symlink(std::env::temp_dir(), &folder).unwrap();
        let refused = check_ours(&folder).unwrap_err().to_string();
        fs::remove_file(&folder).unwrap();
        assert!(refused.contains("only this user may write"), "{refused}");
    }

    /// Somebody else may make a folder of the name of this user's before any controller runs, and hold its lock.
    #[test]
    fn a_client_does_not_follow_a_folder_that_others_may_write_to() {
        let instance = Instance {
            uid: 3_000_000_000 + std::process::id(),
            ..Instance::new("client").unwrap()
        };
        let base = instance.base();
        fs::create_dir(&base).unwrap();
        let lock = instance.take_lock().unwrap();
        let with_mode = |mode: u32| {
            fs::set_permissions(&base, fs::Permissions::from_mode(mode)).unwrap();
            instance.running_config().map(|_| ())
        };
        let (open, own) = (with_mode(0o777), with_mode(0o700));
        drop(lock);
        fs::remove_dir_all(&base).unwrap();
        assert!(matches!(open, Err(SessionError::NotOurs(_))), "{open:?}");
        assert!(matches!(own, Err(SessionError::NotRunning(_))), "{own:?}");
    }

    #[test]
    fn full_shared_memory_is_told_before_anything_is_written_there() {
        assert!(check_shared_memory(0).is_ok());
        let message = check_shared_memory(u64::MAX).unwrap_err().to_string();
        assert!(message.contains("--shm-size"), "{message}");
    }

    #[test]
    fn the_release_line_is_that_of_the_dependency() {
        let manifest = include_str!("../../Cargo.toml");
        assert!(manifest.contains(&format!("iceoryx2 = \"{ICEORYX2}\"")));
    }

    #[test]
    fn a_client_of_another_version_is_told_so() {
        let instance = Instance::new(&format!("version-{}", std::process::id())).unwrap();
        let session = instance.start().unwrap();
        session.announce().unwrap();
        for (text, theirs) in [
            (
                "session a-b\nprotocol 3\niceoryx2 0.10\n",
                "protocol 3 over iceoryx2 0.10",
            ),
            (
                "session a-b\nprotocol 2\niceoryx2 0.11\n",
                "protocol 2 over iceoryx2 0.11",
            ),
            ("187a-2f", "a protocol without a number"),
        ] {
            fs::write(instance.current_file(), text).unwrap();
            let message = instance.running_config().unwrap_err().to_string();
            assert!(
                message.contains(theirs) && message.contains("this client speaks protocol 2"),
                "{message}"
            );
        }
        drop(session);
        instance.purge().unwrap();
    }

    #[test]
    fn one_session_at_a_time_and_clients_see_only_announced_ones() {
        let instance = Instance::new(&format!("test-{}", std::process::id())).unwrap();
        assert!(matches!(
            instance.running_config(),
            Err(SessionError::NotRunning(_))
        ));
        let session = instance.start().unwrap();
        assert!(instance.running_config().is_err(), "not announced yet");
        session.announce().unwrap();
        let config = instance.running_config().unwrap();
        assert_eq!(config.global.prefix, session.config().global.prefix);
        assert!(matches!(instance.start(), Err(SessionError::Running(..))));
        drop(session);
        assert!(instance.running_config().is_err());
        drop(instance.start().unwrap());
        instance.purge().unwrap();
        assert!(!instance.folder().exists() && !instance.lock_file().exists());
    }
}
