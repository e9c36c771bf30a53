//! The interface to DDS or any other middleware.

use lsdc_files::error::Result;

/// Carries messages between the node and other programs. Messages are in CDR, including the four bytes of the
/// encapsulation.
pub trait Transport {
    /// Subscribes to a topic. Calls `deliver` with each message, on any thread; `deliver` must not block.
    ///
    /// # Errors
    /// The topic cannot be subscribed to.
    fn subscribe(&mut self, subscription: &Subscription, deliver: Deliver) -> Result<()>;

    /// Advertises a topic, and returns its publisher.
    ///
    /// # Errors
    /// The topic cannot be advertised.
    fn advertise(&mut self, advertisement: &Advertisement) -> Result<Box<dyn Publisher>>;
}

/// Takes the messages of a topic.
pub type Deliver = Box<dyn FnMut(Vec<u8>) + Send>;

/// Publishes the messages of a topic.
pub trait Publisher: Send {
    /// Publishes a message.
    ///
    /// # Errors
    /// The message was not sent.
    fn publish(&self, message: &[u8]) -> Result<()>;
}

/// A topic that is subscribed to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Subscription {
    /// The name in ROS, as in `/camera/image_raw`.
    pub topic: String,
    /// The type in ROS, as in `sensor_msgs/msg/Image`.
    pub kind: String,
    /// The quality of service that is requested.
    pub qos: Qos,
}

/// A topic that is published.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Advertisement {
    /// The name in ROS, as in `/lsdc/depth/image`.
    pub topic: String,
    /// The type in ROS, as in `sensor_msgs/msg/Image`.
    pub kind: String,
    /// The quality of service that is offered.
    pub qos: Qos,
}

/// The quality of service of a topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Qos {
    /// Whether messages that are lost are sent again.
    pub reliable: bool,
    /// Whether who joins late receives the last messages (`transient local` in DDS).
    pub latched: bool,
    /// How many messages are kept.
    pub keep_last: usize,
}

impl Qos {
    /// Of sensors, as `rmw_qos_profile_sensor_data`: a lost message is not worth waiting for. It accepts reliable publishers,
    /// too.
    pub const SENSOR_DATA: Self = Self {
        reliable: false,
        latched: false,
        keep_last: 5,
    };
    /// Of results: subscribers of either kind accept it.
    pub const RESULTS: Self = Self {
        reliable: true,
        latched: false,
        keep_last: 5,
    };
    /// Of `/tf`, as tf2 has it.
    pub const TF: Self = Self {
        reliable: true,
        latched: false,
        keep_last: 100,
    };
    /// Of `/tf_static`, as tf2 has it.
    pub const TF_STATIC: Self = Self {
        latched: true,
        ..Self::TF
    };
}
