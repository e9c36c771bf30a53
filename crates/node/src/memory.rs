//! A transport within the process, for tests and for programs that already have the messages.

use crate::transport::{Advertisement, Deliver, Publisher, Subscription, Transport};
use lsdc_files::error::Result;
use std::sync::mpsc::{Receiver, Sender, channel};

/// Carries messages within the process.
#[derive(Default)]
pub struct MemoryTransport {
    subscribers: Vec<(Subscription, Deliver)>,
    advertised: Vec<Advertisement>,
    published: Option<Sender<Published>>,
}

/// A published message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Published {
    /// Its topic.
    pub topic: String,
    /// The message in CDR.
    pub message: Vec<u8>,
}

impl MemoryTransport {
    /// Receives messages published on topics advertised from now on.
    pub fn outputs(&mut self) -> Receiver<Published> {
        let (sender, receiver) = channel();
        self.published = Some(sender);
        receiver
    }

    /// Delivers a message to the subscribers of a topic. Returns whether there are any.
    pub fn send(&mut self, topic: &str, message: &[u8]) -> bool {
        let mut any = false;
        for (subscription, deliver) in &mut self.subscribers {
            if subscription.topic == topic {
                deliver(message.to_vec());
                any = true;
            }
        }
        any
    }

    /// Subscribed topics.
    pub fn subscriptions(&self) -> impl Iterator<Item = &Subscription> {
        self.subscribers
            .iter()
            .map(|(subscription, _)| subscription)
    }

    /// Advertised topics.
    pub fn advertised(&self) -> &[Advertisement] {
        &self.advertised
    }
}

impl Transport for MemoryTransport {
    fn subscribe(&mut self, subscription: &Subscription, deliver: Deliver) -> Result<()> {
        self.subscribers.push((subscription.clone(), deliver));
        Ok(())
    }

    fn advertise(&mut self, advertisement: &Advertisement) -> Result<Box<dyn Publisher>> {
        self.advertised.push(advertisement.clone());
        Ok(Box::new(MemoryPublisher {
            topic: advertisement.topic.clone(),
            published: self.published.clone(),
        }))
    }
}

struct MemoryPublisher {
    topic: String,
    published: Option<Sender<Published>>,
}

impl Publisher for MemoryPublisher {
    fn publish(&self, message: &[u8]) -> Result<()> {
        if let Some(published) = &self.published {
            // It is no error if nobody listens.
            let _ = published.send(Published {
                topic: self.topic.clone(),
                message: message.to_vec(),
            });
        }
        Ok(())
    }
}
