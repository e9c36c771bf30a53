//! The runs of the gallery, as they were read last.

use super::results::{Run, runs};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

/// The runs as they were listed last, by whose numbers and names files are found: no folder is read again for a picture.
#[derive(Default)]
pub(crate) struct Index(Mutex<Option<Arc<Vec<Run>>>>);

impl Index {
    /// Reads the folders.
    pub(super) fn renew(&self, folders: &[PathBuf]) -> Arc<Vec<Run>> {
        let found = Arc::new(folders.iter().flat_map(|folder| runs(folder)).collect());
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(Arc::clone(&found));
        found
    }

    /// What was read last, or is read now.
    pub(super) fn get(&self, folders: &[PathBuf]) -> Arc<Vec<Run>> {
        let known = self
            .0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone();
        known.unwrap_or_else(|| self.renew(folders))
    }
}
