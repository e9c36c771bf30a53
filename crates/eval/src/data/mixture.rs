//! A mixture of datasets for training.

use super::{Dataset, Frame, FrameId};
use lsdc_files::error::Result;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

/// Concatenated datasets. Networks are evaluated and calibrated on the first dataset, whose frames keep their names; the names
/// of other frames are prefixed with the number of their dataset.
#[derive(Clone)]
pub struct Mixture {
    parts: Vec<(Arc<dyn Dataset>, Option<f64>)>,
}

impl From<Arc<dyn Dataset>> for Mixture {
    fn from(frames: Arc<dyn Dataset>) -> Self {
        Self::new(frames, Vec::new())
    }
}

impl Mixture {
    /// Mixes a dataset with others, each with its share of all training frames. Without a share, each frame of a dataset is
    /// drawn as often as a frame of the first one.
    pub fn new(first: Arc<dyn Dataset>, others: Vec<(Arc<dyn Dataset>, Option<f64>)>) -> Self {
        let parts = std::iter::once((first, None)).chain(others);
        Self {
            parts: parts.collect(),
        }
    }

    /// Returns the first dataset, whose frames have the same indices in the mixture.
    pub fn first(&self) -> &Arc<dyn Dataset> {
        &self.parts[0].0
    }

    /// Returns the index range and the share of each dataset.
    pub fn parts(&self) -> impl Iterator<Item = (Range<usize>, Option<f64>)> {
        self.parts.iter().scan(0, |start, (frames, share)| {
            let range = *start..*start + frames.len();
            *start = range.end;
            Some((range, *share))
        })
    }

    /// Returns the dataset of a frame: its number, the dataset, and the index of the frame in it.
    fn part(&self, index: usize) -> (usize, &dyn Dataset, usize) {
        let mut ranges = self.parts().map(|(range, _)| range).enumerate();
        let found = ranges.find(|(_, range)| range.contains(&index));
        let (number, range) = found.unwrap_or_default();
        (number, self.parts[number].0.as_ref(), index - range.start)
    }
}

impl Dataset for Mixture {
    fn description(&self) -> String {
        let parts = self.parts.iter().map(|(frames, share)| match share {
            None => frames.description(),
            Some(share) => {
                let percent = (share * 1e4).round() / 100.0;
                format!("{} ({percent} %)", frames.description())
            }
        });
        parts.collect::<Vec<_>>().join("; ")
    }

    fn protocol(&self) -> &'static str {
        self.first().protocol()
    }

    fn has_depth(&self) -> bool {
        self.parts.iter().all(|(frames, _)| frames.has_depth())
    }

    fn len(&self) -> usize {
        self.parts.iter().map(|(frames, _)| frames.len()).sum()
    }

    fn id(&self, index: usize) -> FrameId {
        match self.part(index) {
            (0, frames, index) => frames.id(index),
            (number, frames, index) => format!("{number}/{}", frames.id(index)),
        }
    }

    fn files(&self, index: usize) -> Vec<PathBuf> {
        let (_, frames, index) = self.part(index);
        frames.files(index)
    }

    fn load(&self, index: usize) -> Result<Frame> {
        let (_, frames, at) = self.part(index);
        let id = self.id(index);
        Ok(Frame {
            id,
            ..frames.load(at)?
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::{Rooms, RoomsConfig, Split};

    #[test]
    fn frames_of_all_datasets_follow_each_other_under_names_of_their_own() {
        let rooms = |train: usize, seed: u64| -> Arc<dyn Dataset> {
            let config = RoomsConfig {
                train,
                seed,
                width: 16,
                height: 16,
                ..RoomsConfig::default()
            };
            Arc::new(Rooms::new(Split::Train, &config).unwrap())
        };
        let parts = [rooms(3, 0), rooms(2, 1), rooms(4, 2)];
        let others = vec![(parts[1].clone(), Some(0.3)), (parts[2].clone(), None)];
        let all = Mixture::new(parts[0].clone(), others);
        assert_eq!(all.len(), 9);
        let ranges: Vec<_> = all.parts().collect();
        assert_eq!(ranges, [(0..3, None), (3..5, Some(0.3)), (5..9, None)]);
        for (index, part, at) in [
            (0, 0, 0),
            (2, 0, 2),
            (3, 1, 0),
            (4, 1, 1),
            (5, 2, 0),
            (8, 2, 3),
        ] {
            let (found, own) = (all.load(index).unwrap(), parts[part].load(at).unwrap());
            assert_eq!((found.rgb, found.depth), (own.rgb, own.depth));
            assert_eq!(found.id, all.id(index));
        }
        assert_eq!(all.id(1), parts[0].id(1));
        assert_eq!(all.id(4), format!("1/{}", parts[1].id(1)));
        let names: std::collections::BTreeSet<_> = (0..9).map(|i| all.id(i)).collect();
        assert_eq!(names.len(), 9);
        assert!(
            all.description().contains("(30 %)"),
            "{}",
            all.description()
        );
    }
}
