//! The images that paths, folders, patterns and lists name.

use super::settings::{Settings, is_list, is_pattern};
use crate::cli::args::Format;
use crate::cli::ui;
use lsdc_eval::data::{self, check_foreign};
use lsdc_files::error::{Error, Result};
use lsdc_files::{Workspace, WorkspaceFormat};
use std::collections::HashSet;
use std::path::{Component, Path, PathBuf};

/// An image that was named.
pub(super) struct Found {
    pub(super) image: PathBuf,
    pub(super) name: PathBuf,
    /// In a list.
    pub(super) points: Option<PathBuf>,
}
impl Found {
    fn new(image: PathBuf, name: PathBuf) -> Self {
        Self {
            image,
            name,
            points: None,
        }
    }

    /// Called by its last part alone.
    fn flat(image: PathBuf) -> Self {
        let name = PathBuf::from(image.file_name().unwrap_or_default());
        Self::new(image, name)
    }
}

/// All images that the settings name, in their order.
pub(super) fn images(settings: &Settings, output: &Path) -> Result<Vec<Found>> {
    let mut found = Vec::new();
    for path in &settings.rgb {
        let before = found.len();
        if path.is_dir() {
            let (images, results) = without_results(data::images_below(path)?, path, output);
            if results > 0 {
                ui::say(&format!(
                    "left out of `{}`: {} that `lsdc complete` wrote",
                    path.display(),
                    ui::counted(results, "image")
                ));
            }
            for image in images {
                let name = image.strip_prefix(path).unwrap_or(&image).to_owned();
                found.push(Found::new(image, name));
            }
        } else if is_list(path) {
            read_list(path, &mut found)?;
        } else if is_pattern(path) {
            let wrong = |what: String| Error::config(format!("`{}` {what}", path.display()));
            let matches = glob::glob(&path.to_string_lossy())
                .map_err(|e| wrong(format!("is no pattern: {}", e.msg)))?;
            for image in matches {
                let image = image.map_err(|e| wrong(e.to_string()))?;
                found.push(Found::flat(image));
            }
        } else {
            check_foreign(path)?;
            found.push(Found::flat(path.clone()));
        }
        if found.len() == before {
            return Err(Error::format(path, "holds no image")
                .hint("JPEG, PNG, WebP, TIFF, BMP and PNM images are looked for"));
        }
    }
    Ok(found)
}

/// The images of a folder without what an earlier run has written there, and how many those were:
/// all below the folder of results, and where that holds the images too, what is called as results
/// of another image are.
fn without_results(images: Vec<PathBuf>, folder: &Path, output: &Path) -> (Vec<PathBuf>, usize) {
    let real = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let (folder, output) = (real(folder), real(output));
    let together = folder.starts_with(&output);
    let stems: HashSet<PathBuf> = images.iter().map(|path| path.with_extension("")).collect();
    let workspaces: Vec<PathBuf> = WorkspaceFormat::ALL
        .map(|format| output.join(format.name()))
        .into_iter()
        .filter(|folder| Workspace::is_at(folder))
        .collect();
    let is_result = |path: &Path| {
        let named = |end: &str| {
            let name = path.file_name()?.to_str()?;
            let stem = name.strip_suffix(end)?.strip_suffix('_')?;
            Some(stems.contains(&path.with_file_name(stem)))
        };
        let ends = Format::ALL.into_iter().map(Format::end);
        if together {
            ends.into_iter().any(|end| named(end) == Some(true))
                || workspaces
                    .iter()
                    .any(|folder| real(path).starts_with(folder))
        } else {
            real(path).starts_with(&output)
        }
    };
    let before = images.len();
    let images: Vec<PathBuf> = images.into_iter().filter(|path| !is_result(path)).collect();
    let results = before - images.len();
    (images, results)
}

/// An image to a line, then its points, if they are not in the folder of points.
fn read_list(path: &Path, found: &mut Vec<Found>) -> Result<()> {
    let text = std::fs::read_to_string(path).map_err(|e| Error::read(path, e))?;
    let folder = path.parent().unwrap_or(Path::new(""));
    for (number, line) in text.lines().enumerate() {
        let fields = split(line, folder);
        let (image, points) = match &fields[..] {
            [] => continue,
            [image] => (image, None),
            [image, points] => (image, Some(folder.join(points))),
            _ => {
                let what = format!("line {}: {} paths", number + 1, fields.len());
                return Err(Error::format(path, what).hint(
                    "a line is an image and its points; quote what has blanks: \"a b.png\"",
                ));
            }
        };
        let plain: PathBuf = Path::new(image)
            .components()
            .filter(|part| *part != Component::CurDir)
            .collect();
        let image = folder.join(&plain);
        found.push(if plain.is_relative() {
            Found {
                points,
                ..Found::new(image, plain)
            }
        } else {
            Found {
                points,
                ..Found::flat(image)
            }
        });
    }
    Ok(())
}

/// The paths of a line, separated by commas or blanks, or quoted; what follows a `#` before a path is
/// a remark. A line that is the name of a file is that file, whatever is in the name.
fn split(line: &str, folder: &Path) -> Vec<String> {
    let line = line.trim();
    if !line.is_empty() && folder.join(line).is_file() {
        return vec![line.to_owned()];
    }
    let mut fields = Vec::new();
    let mut rest = line;
    loop {
        rest = rest.trim_start_matches([',', ' ', '\t']);
        if rest.is_empty() || rest.starts_with('#') {
            return fields;
        }
        let quoted = rest.strip_prefix('"').and_then(|text| text.split_once('"'));
        let (field, after) = quoted.unwrap_or_else(|| {
            let end = rest.find([',', ' ', '\t']).unwrap_or(rest.len());
            rest.split_at(end)
        });
        fields.push(field.to_owned());
        rest = after;
    }
}
