//! The topics of ROS 2 over DDS, as the transport of a node.

use lsdc_dds::{Participant, Settings, Subscription as DdsSubscription};
use lsdc_files::error::{Cause, Error, Result};
use lsdc_node::{Advertisement, Deliver, Publisher, Qos, Subscription, Transport};

/// A participant that is one node of ROS 2.
pub(super) struct Dds {
    participant: Participant,
    /// Messages arrive as long as these are kept.
    subscriptions: Vec<DdsSubscription>,
}

impl Dds {
    /// Joins the domain that the environment states, as a node of this name.
    pub(super) fn join(node: &str) -> Result<Self> {
        let (domain, settings) = Settings::from_environment().map_err(failed)?;
        let settings = Settings {
            node: node.to_owned(),
            ..settings
        };
        Ok(Self {
            participant: Participant::new(domain, settings).map_err(failed)?,
            subscriptions: Vec::new(),
        })
    }
}

impl Transport for Dds {
    fn subscribe(&mut self, subscription: &Subscription, deliver: Deliver) -> Result<()> {
        let Subscription { topic, kind, qos } = subscription;
        let subscribed = self
            .participant
            .subscribe(topic, kind, of_dds(*qos), deliver);
        self.subscriptions.push(subscribed.map_err(failed)?);
        Ok(())
    }

    fn advertise(&mut self, advertisement: &Advertisement) -> Result<Box<dyn Publisher>> {
        let Advertisement { topic, kind, qos } = advertisement;
        let publisher = self.participant.advertise(topic, kind, of_dds(*qos));
        Ok(Box::new(DdsPublisher(publisher.map_err(failed)?)))
    }
}

struct DdsPublisher(lsdc_dds::Publisher);

impl Publisher for DdsPublisher {
    fn publish(&self, message: &[u8]) -> Result<()> {
        self.0.publish(message).map_err(failed)
    }
}

fn of_dds(qos: Qos) -> lsdc_dds::Qos {
    lsdc_dds::Qos {
        reliable: qos.reliable,
        transient_local: qos.latched,
        depth: qos.keep_last,
    }
}

fn failed(error: lsdc_dds::Error) -> Error {
    let cause = match error {
        lsdc_dds::Error::Environment { .. } | lsdc_dds::Error::Name { .. } => Cause::Config,
        _ => Cause::Network,
    };
    Error::new(cause, error.to_string())
}
