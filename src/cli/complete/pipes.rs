//! `-` for standard input and output, through temporary files.

use super::Complete;
use crate::error::{Error, Result};
use std::io::Read as _;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// Temporary files that live as long as this.
pub(super) struct Pipes {
    folder: Option<TempDir>,
    to_stdout: bool,
}

impl Pipes {
    /// Puts files in the places of `-`.
    pub(super) fn open(args: &mut Complete) -> Result<Self> {
        let is_pipe = |path: &Path| path == Path::new("-");
        let to_stdout = args.output.as_deref().is_some_and(is_pipe);
        let images = args.rgb.iter().filter(|path| is_pipe(path)).count();
        let inputs = images + usize::from(is_pipe(&args.sparse));
        if inputs > 1 {
            return Err(Error::config("only one input can be `-`"));
        }
        if inputs == 0 && !to_stdout {
            return Ok(Self {
                folder: None,
                to_stdout,
            });
        }
        let folder = tempfile::tempdir().map_err(|e| Error::write(Path::new("-"), e))?;
        if inputs == 1 {
            let path = read_stdin(folder.path())?;
            let place = args.rgb.iter_mut().chain([&mut args.sparse]);
            if let Some(place) = place.into_iter().find(|place| is_pipe(place)) {
                *place = path;
            }
        }
        if to_stdout {
            match args.formats.as_deref() {
                None => args.formats = Some(vec![super::outputs::Format::Npy]),
                Some([_]) => {}
                Some(_) => {
                    return Err(Error::config("only one file fits into standard output")
                        .hint("give one of --formats"));
                }
            }
            if args.rgb.len() > 1 || args.rgb[0].is_dir() {
                return Err(Error::config("only one image fits into standard output"));
            }
            args.output = Some(folder.path().join("results"));
        }
        Ok(Self {
            folder: Some(folder),
            to_stdout,
        })
    }

    /// Whether the result goes to standard output.
    pub(super) fn to_stdout(&self) -> bool {
        self.folder.is_some() && self.to_stdout
    }
}

/// No image or scan is larger.
const MOST: u64 = 1 << 30;

/// What comes from standard input as a file, whose ending says what it is.
fn read_stdin(folder: &Path) -> Result<PathBuf> {
    let stdin = Path::new("standard input");
    let mut bytes = Vec::new();
    std::io::stdin()
        .take(MOST + 1)
        .read_to_end(&mut bytes)
        .map_err(|e| Error::read(stdin, e))?;
    if bytes.len() as u64 > MOST {
        return Err(Error::format(stdin, "is larger than a gigabyte").hint("give a file"));
    }
    if bytes.is_empty() {
        return Err(Error::format(stdin, "is empty"));
    }
    let path = folder.join("stdin").with_extension(ending(&bytes));
    std::fs::write(&path, bytes).map_err(|e| Error::write(&path, e))?;
    Ok(path)
}

/// The ending of files that begin so; text is taken for a list of points.
fn ending(bytes: &[u8]) -> &'static str {
    let known: [(&[u8], &str); 12] = [
        (b"\x93NUMPY", "npy"),
        (b"PK\x03\x04", "npz"),
        (b"\x89PNG", "png"),
        (b"\xff\xd8\xff", "jpg"),
        (b"RIFF", "webp"),
        (b"II*\0", "tiff"),
        (b"MM\0*", "tiff"),
        (b"\x76\x2f\x31\x01", "exr"),
        (b"Pf", "pfm"),
        (b"ply", "ply"),
        (b"LASF", "las"),
        (b"# .PCD", "pcd"),
    ];
    let found = known.iter().find(|(start, _)| bytes.starts_with(start));
    found.map_or("csv", |(_, ending)| ending)
}
