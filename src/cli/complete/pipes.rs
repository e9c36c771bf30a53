//! `-` for standard input and output, through temporary files.

use super::settings::is_one;
use crate::cli::args::{Complete, Format};
use lsdc_files::error::{Error, Result};
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
        if to_stdout {
            check_one_file(args)?;
        }
        if images > 0 && args.output.is_none() {
            return Err(
                Error::config("an image from standard input is in no folder")
                    .hint("say where the result goes: -o DIR, -o FILE, or -o -"),
            );
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
            args.formats.get_or_insert_with(|| vec![Format::Npy]);
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

/// Checks that a command with `-o -` asks for one file of one image.
fn check_one_file(args: &Complete) -> Result<()> {
    let refused = |what: &str, hint: &str| {
        let message = format!("only one file fits into standard output: {what}");
        Err(Error::config(message).hint(hint))
    };
    if !is_one(&args.rgb) {
        return refused("these are several images", "give one image, or -o DIR");
    }
    let formats = args.formats.as_deref().unwrap_or(&[Format::Npy]);
    let [format] = formats else {
        return refused(
            "these are several formats",
            "give one of --formats, or -o DIR",
        );
    };
    if args.uncertainty && !matches!(format, Format::Npz | Format::Exr) {
        let hint = "give --formats npz or exr, which hold both, or -o DIR";
        return refused("`--uncertainty` writes another", hint);
    }
    if args.outliers {
        return refused("`--outliers` writes another", "give -o DIR");
    }
    if args.json {
        return refused(
            "`--json` prints there too",
            "give --formats json, or -o DIR",
        );
    }
    Ok(())
}

/// Stores standard input in a file with the extension of its format.
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
