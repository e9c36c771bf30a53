//! Multipart forms, whose files go to a folder of their own, where the readers of files find them.

use crate::body::Incoming;
use crate::fault::{Fault, FaultKind};
use crate::spool::Spool;
use multer::{Field, Multipart};
use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// The parts of a form, in files.
pub(crate) struct Upload {
    folder: Spool,
    parts: BTreeMap<&'static str, Part>,
}

/// A part.
struct Part {
    path: PathBuf,
    /// The client's name of the file, or the name of the part.
    name: String,
}

/// Bytes of a part that is no image and no points.
const SMALL: u64 = 1 << 20;

/// Endings that a name may pass on to the reader of its file, which goes by them.
const LONGEST_ENDING: usize = 5;
/// Letters of a name that are kept.
const LONGEST_NAME: usize = 64;

impl Upload {
    /// Reads a form with these parts, each of which may be missing. Files are written as they come, which blocks.
    ///
    /// # Errors
    /// No sound form, parts that are unknown or come twice, and those of the body.
    pub(crate) async fn read(
        content_type: &str,
        body: &mut Incoming,
        known: &[&'static str],
    ) -> Result<Self, Fault> {
        let boundary = multer::parse_boundary(content_type).map_err(|_| {
            let what = "the request is no multipart/form-data";
            Fault::new(FaultKind::Unsupported, what)
                .hint("send a form, as `curl -F image=@rgb.png` does")
        })?;
        let mut upload = Self {
            folder: Spool::new().map_err(|_| Fault::failed())?,
            parts: BTreeMap::new(),
        };
        let mut form = Multipart::new(body.stream(), boundary);
        while let Some(field) = form.next_field().await.map_err(broken)? {
            let name = known.iter().find(|name| field.name() == Some(**name));
            let Some(name) = name else {
                let name = shown(field.name().unwrap_or_default());
                return Err(Fault::malformed(format!("the part `{name}` is unknown"))
                    .hint(format!("parts are called {}", known.join(", "))));
            };
            if upload.parts.contains_key(name) {
                return Err(Fault::malformed(format!("the part `{name}` comes twice")));
            }
            let part = upload.keep(name, field).await?;
            upload.parts.insert(name, part);
        }
        Ok(upload)
    }

    async fn keep(&self, name: &str, mut field: Field<'_>) -> Result<Part, Fault> {
        let failed = |_| Fault::failed();
        let folder = self.folder.path().join(name);
        std::fs::create_dir(&folder).map_err(failed)?;
        // Readers go by endings, and doubt by names.
        let mut own = field.file_name().map(stem).unwrap_or_default();
        if own.is_empty() {
            name.clone_into(&mut own);
        }
        if let Some(ending) = ending(&field) {
            own = format!("{own}.{ending}");
        }
        let path = folder.join(own);
        let mut file = std::fs::File::create(&path).map_err(failed)?;
        let most = match name {
            "image" | "points" => u64::MAX,
            _ => SMALL,
        };
        let mut length = 0;
        while let Some(chunk) = field.chunk().await.map_err(broken)? {
            length += chunk.len() as u64;
            if length > most {
                let what = format!("the part `{name}` has at most {most} bytes");
                return Err(Fault::too_large(what));
            }
            file.write_all(&chunk).map_err(failed)?;
        }
        let sent = field.file_name().map(|name| printable(last(name)));
        let sent = sent.filter(|name| !name.is_empty());
        Ok(Part {
            path,
            name: sent.unwrap_or_else(|| name.to_owned()),
        })
    }

    /// The file of a part.
    pub(crate) fn get(&self, name: &str) -> Option<&Path> {
        self.parts.get(name).map(|part| part.path.as_path())
    }

    /// The file of a part that must be there.
    ///
    /// # Errors
    /// It is missing.
    pub(crate) fn need(&self, name: &str) -> Result<&Path, Fault> {
        self.get(name).ok_or_else(|| {
            Fault::malformed(format!("the part `{name}` is missing"))
                .hint(format!("send it, as `curl -F {name}=@FILE` does"))
        })
    }

    /// Runs `work`. A fault of it has the client's names of the files.
    pub(crate) fn with_client_names<T>(
        &self,
        work: impl FnOnce() -> Result<T, Fault>,
    ) -> Result<T, Fault> {
        work().map_err(|fault| Fault {
            message: self.rename_files(&fault.message),
            hint: fault.hint.as_deref().map(|hint| self.rename_files(hint)),
            ..fault
        })
    }

    /// A text with the client's names of the files.
    pub(crate) fn rename_files(&self, text: &str) -> String {
        let mut text = text.to_owned();
        for part in self.parts.values() {
            text = text.replace(&part.path.display().to_string(), &part.name);
        }
        let mut here = self.folder.path().display().to_string();
        here.push(std::path::MAIN_SEPARATOR);
        text.replace(&here, "")
    }
}

/// The last part of a path, of whatever system.
fn last(path: &str) -> &str {
    path.rsplit(['/', '\\']).next().unwrap_or_default()
}

/// The ending that tells what a part is: that of its file's name, or else of its type.
fn ending(field: &Field<'_>) -> Option<String> {
    if let Some(name) = field.file_name() {
        let ending = Path::new(name).extension()?.to_str()?;
        let sound = ending.len() <= LONGEST_ENDING
            && ending.bytes().all(|byte| byte.is_ascii_alphanumeric());
        return sound.then(|| ending.to_ascii_lowercase());
    }
    let kind = field.content_type()?;
    let ending = match kind.essence_str() {
        "application/json" => "json",
        "text/csv" => "csv",
        "image/png" => "png",
        "image/x-exr" => "exr",
        "image/tiff" => "tiff",
        "application/x-npz" => "npz",
        "application/x-npy" => "npy",
        "application/x-ply" => "ply",
        "application/toml" => "toml",
        _ => return None,
    };
    Some(ending.to_owned())
}

/// The name of a file without its ending, as far as it is safe in a path.
fn stem(name: &str) -> String {
    let stem = Path::new(last(name)).file_stem().unwrap_or_default();
    let safe = |c: &char| c.is_ascii_alphanumeric() || "-_".contains(*c);
    let stem = stem.to_string_lossy();
    stem.chars().filter(safe).take(LONGEST_NAME).collect()
}

/// The name of a file, as far as it can be shown.
fn printable(name: &str) -> String {
    let plain = |c: &char| !c.is_control() && *c != '`';
    name.chars().filter(plain).take(LONGEST_NAME).collect()
}

/// The name of a part, as far as it can be shown.
fn shown(name: &str) -> String {
    let plain = |c: &char| c.is_ascii_graphic() && *c != '`';
    name.chars().filter(plain).take(32).collect()
}

/// Returns the fault of a form: that of its body, or its own.
fn broken(error: multer::Error) -> Fault {
    match error {
        multer::Error::StreamReadFailed(cause) => match cause.downcast::<Fault>() {
            Ok(fault) => *fault,
            Err(_) => Fault::malformed("the form cannot be read"),
        },
        _ => Fault::malformed("the form is not sound, or ended early"),
    }
}
