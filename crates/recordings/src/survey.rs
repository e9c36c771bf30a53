//! Counts of the messages of a recording.

use crate::{Defects, Recording, Topic};
use lsdc_files::error::Result;
use std::collections::BTreeMap;
use std::sync::Arc;

/// The contents of a recording.
#[derive(Clone, Debug)]
pub struct Survey {
    /// Topics, by name.
    pub topics: Vec<TopicSummary>,
    /// Defects of the recording.
    pub defects: Defects,
}

/// The messages of a topic.
#[derive(Clone, Debug, PartialEq)]
pub struct TopicSummary {
    /// The topic.
    pub topic: Arc<Topic>,
    /// Number of messages.
    pub count: u64,
    /// Size of the messages before compression, in bytes.
    pub bytes: u64,
    /// When the first and the last message were recorded, in nanoseconds.
    pub times: Option<(u64, u64)>,
}

impl Survey {
    /// Reads a recording from start to end.
    ///
    /// # Errors
    /// The recording cannot be read at all.
    pub fn of(recording: &mut Recording) -> Result<Self> {
        let empty = |topic: &Arc<Topic>| TopicSummary {
            topic: topic.clone(),
            count: 0,
            bytes: 0,
            times: None,
        };
        let mut found: BTreeMap<String, TopicSummary> = recording
            .topics()
            .iter()
            .map(|topic| (topic.name.clone(), empty(topic)))
            .collect();
        let defects = recording.visit(&|_| true, &mut |topic, message| {
            if !found.contains_key(&topic.name) {
                found.insert(topic.name.clone(), empty(topic));
            }
            if let Some(summary) = found.get_mut(&topic.name) {
                let time = message.times.log;
                summary.count += 1;
                summary.bytes += message.data.len() as u64;
                let (first, last) = summary.times.unwrap_or((time, time));
                summary.times = Some((first.min(time), last.max(time)));
            }
            Ok(())
        })?;
        Ok(Self {
            topics: found.into_values().collect(),
            defects,
        })
    }

    /// Returns when the first and the last message were recorded, in nanoseconds.
    pub fn times(&self) -> Option<(u64, u64)> {
        let times = self.topics.iter().filter_map(|summary| summary.times);
        times.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
    }
}

impl TopicSummary {
    /// Messages per second; `None` unless two messages were recorded at different times.
    pub fn rate(&self) -> Option<f64> {
        let (first, last) = self.times?;
        let seconds = (last - first) as f64 * 1e-9;
        (self.count > 1 && seconds > 0.0).then(|| (self.count - 1) as f64 / seconds)
    }
}
