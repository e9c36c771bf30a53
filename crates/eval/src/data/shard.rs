//! Shards of the frames of a dataset, for evaluation on many machines.

use lsdc_files::error::{Error, Result};
use lsdc_rng::Rng;
use serde::{Deserialize, Serialize};
use std::fmt::{Display, Formatter};
use std::str::FromStr;

/// Shard `index` of `count`. Frames are assigned by their names, independent of their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Shard {
    index: u32,
    count: u32,
}

impl Shard {
    /// All frames.
    pub const WHOLE: Self = Self { index: 0, count: 1 };

    /// Returns the shards that are missing to complete these.
    ///
    /// # Errors
    /// The shards have different counts, or one occurs twice.
    pub fn missing(parts: &[Self]) -> Result<Vec<Self>> {
        let count = parts.first().map_or(1, |part| part.count);
        if let Some(other) = parts.iter().find(|part| part.count != count) {
            return Err(Error::config(format!(
                "{other} is no part of a whole of {count} parts"
            )));
        }
        let mut missing = Vec::new();
        for index in 0..count {
            let part = Self { index, count };
            match parts.iter().filter(|other| **other == part).count() {
                0 => missing.push(part),
                1 => {}
                _ => return Err(Error::config(format!("part {part} is there twice"))),
            }
        }
        Ok(missing)
    }

    /// Returns whether a frame belongs to this shard.
    pub fn holds(self, frame: &str) -> bool {
        Rng::stream(0, &["shard", frame]).below(self.count) == self.index
    }
}

impl Display for Shard {
    /// Writes a name for a folder, for example `0-of-4`.
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}-of-{}", self.index, self.count)
    }
}

impl FromStr for Shard {
    type Err = Error;

    /// Parses `I/N` with I from 0 to N - 1.
    fn from_str(text: &str) -> Result<Self> {
        text.split_once('/')
            .and_then(|(index, count)| {
                Some(Self {
                    index: index.parse().ok()?,
                    count: count.parse().ok()?,
                })
            })
            .filter(|shard| shard.index < shard.count)
            .ok_or_else(|| {
                Error::config(format!("`{text}` is no shard")).hint("I/N with I from 0, as in 0/4")
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_parts_are_found() {
        let parts = |names: &[&str]| -> Vec<Shard> {
            names.iter().map(|name| name.parse().unwrap()).collect()
        };
        let missing = |names: &[&str]| Shard::missing(&parts(names));
        assert_eq!(missing(&["3/4", "0/4"]).unwrap(), parts(&["1/4", "2/4"]));
        assert_eq!(missing(&["1/2", "0/2"]).unwrap(), []);
        assert_eq!(missing(&["0/1"]).unwrap(), []);
        assert!(missing(&["0/2", "0/2"]).is_err() && missing(&["0/2", "1/3"]).is_err());
    }

    #[test]
    fn every_frame_is_in_one_shard() {
        let shards: Vec<Shard> = (0..4).map(|i| format!("{i}/4").parse().unwrap()).collect();
        let mut sizes = [0; 4];
        for i in 0..1000 {
            let frame = format!("kitchen/{i:05}");
            let holders: Vec<usize> = (0..4).filter(|&s| shards[s].holds(&frame)).collect();
            assert_eq!(holders.len(), 1);
            sizes[holders[0]] += 1;
            assert!(Shard::WHOLE.holds(&frame));
        }
        assert!(
            sizes.iter().all(|size| (200..300).contains(size)),
            "{sizes:?}"
        );
        assert!("4/4".parse::<Shard>().is_err() && "1".parse::<Shard>().is_err());
    }
}
