//! Names of frames as names of files.

use lsdc_files::error::{Error, Result};
use std::collections::HashSet;
use std::path::{Component, Path};

/// The frames that have been written, each once.
#[derive(Default)]
pub(super) struct Names(HashSet<String>);

impl Names {
    /// Checks that a frame's name leads to a place of its own below a folder.
    ///
    /// # Errors
    /// It leads out of the folder, or another frame has it.
    pub(super) fn add(&mut self, frame: &str) -> Result<()> {
        let mut parts = Path::new(frame).components();
        if frame.is_empty() || !parts.all(|part| matches!(part, Component::Normal(_))) {
            return Err(Error::config(format!(
                "the name of frame `{frame}` leads out of the folder"
            ))
            .hint("the list of frames of the dataset is not sound"));
        }
        if self.0.insert(frame.to_owned()) {
            return Ok(());
        }
        Err(Error::config(format!("two frames are called `{frame}`"))
            .hint("give --root one of the folders that hold them"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_stay_below_the_folder_and_apart() {
        let mut names = Names::default();
        names.add("kitchen/00001").unwrap();
        names.add("kitchen/00002").unwrap();
        for bad in ["../00001", "/etc/00001", "a/../../b", "", "kitchen/00002"] {
            assert!(names.add(bad).is_err(), "{bad}");
        }
    }
}
