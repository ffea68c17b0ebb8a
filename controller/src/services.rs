//! The names and qualities of the services: the one place that controller and clients take them from.

use crate::session::SessionError;
use iceoryx2::node::Node;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::reader::EntryHandle;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::writer::EntryHandleMut;
use iceoryx2::prelude::*;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use shared::messages::{Command, Goal, JointTarget, RobotState, Status};
use std::fmt::Debug;

/// Why a service or port is not there.
#[derive(Debug, thiserror::Error)]
pub enum ServiceError {
    /// There is no session to connect to.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// iceoryx2 refused.
    #[error("iceoryx2 cannot {what} {name}: {reason}")]
    Transport {
        /// What was tried.
        what: &'static str,
        /// With which service.
        name: String,
        /// iceoryx2's word for it.
        reason: String,
    },
}

impl ServiceError {
    /// Whether waiting can help: for a controller that starts, but not for one of another version.
    pub fn may_pass(&self) -> bool {
        !matches!(
            self,
            Self::Session(SessionError::Version { .. } | SessionError::Name(_))
        )
    }
}

fn refused<E: Debug>(what: &'static str, name: &str) -> impl FnOnce(E) -> ServiceError {
    let name = name.to_string();
    move |error| ServiceError::Transport {
        what,
        name,
        reason: format!("{error:?}"),
    }
}

/// Participants of one service: the controller, the arm's driver and a handful of clients.
const NODES_MAX: usize = 32;

/// One publish-subscribe service.
pub struct Topic {
    name: &'static str,
    publishers_max: usize,
    buffer: usize,
    history: usize,
}

/// Goals from any client.
pub const GOALS: Topic = Topic {
    name: "goals",
    publishers_max: 24,
    buffer: 64,
    history: 0,
};
/// Commands from any client.
pub const COMMANDS: Topic = Topic {
    name: "commands",
    publishers_max: 24,
    buffer: 64,
    history: 0,
};
/// States from the arm's driver; more than one publisher only while a driver restarts.
pub const ROBOT: Topic = Topic {
    name: "robot",
    publishers_max: 4,
    buffer: 64,
    history: 0,
};
/// Every target; the buffer holds two seconds for a slow watcher, which never blocks the sender.
pub const TARGETS: Topic = Topic {
    name: "targets",
    publishers_max: 1,
    buffer: 512,
    history: 0,
};
/// Every status; a newcomer gets the newest at once.
pub const STATUS: Topic = Topic {
    name: "status",
    publishers_max: 1,
    buffer: 64,
    history: 1,
};

/// Name of the blackboard and the key of its only value: the newest target.
const NEWEST: &str = "newest-target";
const NEWEST_KEY: u32 = 0;

/// Payloads that travel.
pub trait Payload: ZeroCopySend + Debug + Copy + 'static {}
impl Payload for Goal {}
impl Payload for Command {}
impl Payload for RobotState {}
impl Payload for JointTarget {}
impl Payload for Status {}

/// A participant of the session that `config` describes.
pub fn node(config: &Config) -> Result<Node<ipc::Service>, ServiceError> {
    set_log_level(LogLevel::Error);
    NodeBuilder::new()
        .config(config)
        .signal_handling_mode(SignalHandlingMode::Disabled)
        .create::<ipc::Service>()
        .map_err(refused("create a node for", config.global.prefix.as_str()))
}

impl Topic {
    /// Most messages that can wait at a subscriber.
    pub fn waiting_max(&self) -> usize {
        self.publishers_max * self.buffer
    }

    /// Creates the service (controller) or opens it (client). The overwriting buffer means that a slow
    /// reader loses the oldest samples and never holds up the sender.
    fn service<T: Payload>(
        &self,
        node: &Node<ipc::Service>,
        create: bool,
    ) -> Result<PortFactory<ipc::Service, T, ()>, ServiceError> {
        let name = ServiceName::new(self.name).map_err(refused("name", self.name))?;
        let builder = node
            .service_builder(&name)
            .publish_subscribe::<T>()
            .enable_safe_overflow(true)
            .max_publishers(self.publishers_max)
            .max_subscribers(NODES_MAX)
            .max_nodes(NODES_MAX)
            .subscriber_max_buffer_size(self.buffer)
            .history_size(self.history);
        if create {
            builder.create().map_err(refused("create", self.name))
        } else {
            builder.open().map_err(refused("open", self.name))
        }
    }

    /// A port that sends on this topic.
    pub fn publisher<T: Payload>(
        &self,
        node: &Node<ipc::Service>,
        create: bool,
    ) -> Result<Publisher<ipc::Service, T, ()>, ServiceError> {
        let service = self.service(node, create)?;
        service
            .publisher_builder()
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .map_err(refused("publish on", self.name))
    }

    /// A port that receives from this topic.
    pub fn subscriber<T: Payload>(
        &self,
        node: &Node<ipc::Service>,
        create: bool,
    ) -> Result<Subscriber<ipc::Service, T, ()>, ServiceError> {
        let service = self.service(node, create)?;
        service
            .subscriber_builder()
            .create()
            .map_err(refused("subscribe to", self.name))
    }
}

/// The loop's port: writes the newest target, never allocates and knows nothing of its readers.
pub type NewestWriter = EntryHandleMut<ipc::Service, u32, JointTarget>;

/// A reader's port: the newest target whenever it looks.
pub type NewestReader = EntryHandle<ipc::Service, u32, JointTarget>;

/// Creates the blackboard.
pub fn newest_writer(node: &Node<ipc::Service>) -> Result<NewestWriter, ServiceError> {
    let name = ServiceName::new(NEWEST).map_err(refused("name", NEWEST))?;
    let service = node
        .service_builder(&name)
        .blackboard_creator::<u32>()
        .add::<JointTarget>(NEWEST_KEY, JointTarget::default())
        .max_readers(NODES_MAX)
        .max_nodes(NODES_MAX)
        .create()
        .map_err(refused("create", NEWEST))?;
    let writer = service
        .writer_builder()
        .create()
        .map_err(refused("write to", NEWEST))?;
    writer.entry(&NEWEST_KEY).map_err(refused("write to", NEWEST))
}

/// Opens the blackboard.
pub fn newest_reader(node: &Node<ipc::Service>) -> Result<NewestReader, ServiceError> {
    let name = ServiceName::new(NEWEST).map_err(refused("name", NEWEST))?;
    let service = node
        .service_builder(&name)
        .blackboard_opener::<u32>()
        .open()
        .map_err(refused("open", NEWEST))?;
    let reader = service
        .reader_builder()
        .create()
        .map_err(refused("read from", NEWEST))?;
    reader.entry(&NEWEST_KEY).map_err(refused("read from", NEWEST))
}
