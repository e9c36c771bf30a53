//! The folder layout of Marigold-DC's evaluation: `rgb/*.png`, `sparse/*.npy`, `gt/*.npy`, metres,
//! 0 = missing. `lsdc export` writes it.

use super::folder::{Folder, FrameFiles};
use super::listing::files_below;
use lsdc_files::error::{Error, Result};
use std::path::Path;

/// Opens the frames of `root`, at any depth of folders; every split contains all frames.
///
/// # Errors
/// No frame.
pub(in crate::data) fn marigold(root: &Path) -> Result<Folder> {
    let colours = root.join("rgb");
    let frames: Vec<FrameFiles> = files_below(&colours, None)?
        .into_iter()
        .filter_map(|name| {
            let (stem, ending) = name.rsplit_once('.')?;
            let beside = |folder: &str| root.join(folder).join(format!("{stem}.npy"));
            ["png", "jpg", "jpeg"]
                .contains(&ending)
                .then(|| FrameFiles {
                    id: stem.to_owned(),
                    rgb: colours.join(&name),
                    depth: beside("gt"),
                    sparse: Some(beside("sparse")),
                    ..FrameFiles::default()
                })
        })
        .collect();
    if frames.is_empty() {
        return Err(
            Error::config(format!("no image in `{}`", colours.display()))
                .hint("expected rgb/NAME.png, sparse/NAME.npy and gt/NAME.npy"),
        );
    }
    Ok(Folder::of(
        "Marigold folder".into(),
        "marigold",
        1.0,
        frames,
    ))
}
