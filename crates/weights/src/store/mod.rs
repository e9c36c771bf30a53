//! The user's data folder, where encoders are kept in half precision.

use super::known::{IdentityHash, KnownEncoder, is_fixed, recognise, recognise_head};
use super::stored::FloatType;
use super::{Precision, names, read_bounded, read_tensors, stored_bytes};
use etcetera::BaseStrategy as _;
use lsdc_core::weights::Tensor;
use lsdc_files::error::{Cause, Error, Result};
use lsdc_files::{remove_leftovers, write_atomically};
use rayon::prelude::*;
use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, TensorView};
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

/// Environment variable that names another folder.
pub const FOLDER: &str = "LSDC_WEIGHTS";

/// A folder of encoders.
#[derive(Clone, Debug)]
pub struct Store {
    folder: PathBuf,
}

/// Result of adding an encoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Installation {
    /// The encoder was installed, and its depth head if the file has it.
    New,
    /// The depth head was added to an installed encoder.
    Head,
    /// Everything was installed already.
    Unchanged,
}

impl Store {
    /// Opens the user's store: [`FOLDER`], or `lsdc/weights` in the data folder of the platform, which is `XDG_DATA_HOME`
    /// or `~/.local/share` except on Windows. It need not exist.
    ///
    /// # Errors
    /// The platform has no data folder of the user.
    pub fn open() -> Result<Self> {
        if let Some(folder) = std::env::var_os(FOLDER).filter(|folder| !folder.is_empty()) {
            return Ok(Self::at(PathBuf::from(folder)));
        }
        let base = etcetera::choose_base_strategy().map_err(|e| {
            Error::config("the user has no data folder")
                .because(e)
                .hint(format!("set {FOLDER} to a folder for weights"))
        })?;
        Ok(Self::at(base.data_dir().join("lsdc").join("weights")))
    }

    /// Opens the store in a folder, which need not exist.
    pub fn at(folder: PathBuf) -> Self {
        Self { folder }
    }

    /// Returns the folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Returns the path of an installed encoder.
    pub fn path(&self, known: &KnownEncoder) -> PathBuf {
        self.folder
            .join(format!("{}-encoder.safetensors", known.weights))
    }

    /// Returns the path of the installed depth head of an encoder. It has a file of its own, so that versions of this
    /// library without heads can read the encoder.
    pub fn head_path(&self, known: &KnownEncoder) -> PathBuf {
        self.folder
            .join(format!("{}-head.safetensors", known.weights))
    }

    /// Whether the depth head of an encoder is installed; true if it has none.
    pub fn has_head(&self, known: &KnownEncoder) -> bool {
        known.head.is_none() || self.head_path(known).exists()
    }

    /// Adds the encoder in a file that [`read_encoder`](super::read_encoder) reads, if it is one of `known`, and its depth
    /// head if the file has it. A file with only a depth head is added to the installed encoder. Existing files are
    /// replaced if `replace` is set.
    ///
    /// # Errors
    /// The file cannot be read or contains another encoder or head, an existing file is damaged, a head has no installed
    /// encoder, or the folder cannot be written.
    pub fn add<'a>(
        &self,
        file: &Path,
        known: &'a [KnownEncoder],
        replace: bool,
    ) -> Result<(&'a KnownEncoder, Installation)> {
        let (head, tensors) = names::depth_head(read_tensors(file)?);
        if !head.is_empty() && !names::has_encoder(&tensors) {
            let known = recognise_head(file, &head, known)?;
            if !self.path(known).exists() {
                let what = format!(
                    "holds the depth head of {} without the encoder, which is not installed",
                    known.name
                );
                return Err(Error::format(file, what)
                    .hint("add the encoder first, or the published file, which has both"));
            }
            let added = self.add_head(known, head, replace)?;
            return Ok((known, added));
        }
        let tensors = names::dinov2(file, tensors)?;
        let known = recognise(file, &tensors, known)?;
        let has_head = known.head.is_some() && !head.is_empty();
        if has_head {
            recognise_head(file, &head, std::slice::from_ref(known))?;
        }
        let path = self.path(known);
        let is_new = !path.exists() || replace;
        if is_new {
            self.write(&path, &tensors, known)?;
        } else {
            self.load(known)
                .map_err(|e| e.hint("give --force to replace it"))?;
        }
        let mut added = Installation::Unchanged;
        if has_head {
            added = self.add_head(known, head, replace)?;
        }
        if is_new {
            added = Installation::New;
        }
        Ok((known, added))
    }

    /// Adds a depth head. Unless `replace` is set, an existing head keeps its tensors and only missing ones are added.
    fn add_head(
        &self,
        known: &KnownEncoder,
        head: BTreeMap<String, Tensor>,
        replace: bool,
    ) -> Result<Installation> {
        let path = self.head_path(known);
        let mut all = BTreeMap::new();
        if path.exists() && !replace {
            all = self
                .load_head(known)
                .map_err(|e| e.hint("give --force to replace it"))?;
            if head.keys().all(|name| all.contains_key(name)) {
                return Ok(Installation::Unchanged);
            }
        }
        for (name, tensor) in head {
            all.entry(name).or_insert(tensor);
        }
        self.write(&path, &all, known)?;
        Ok(Installation::Head)
    }

    fn write(
        &self,
        path: &Path,
        tensors: &BTreeMap<String, Tensor>,
        known: &KnownEncoder,
    ) -> Result<()> {
        let bytes = file_bytes(tensors, known)?;
        let folder = &self.folder;
        std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
        remove_leftovers(folder);
        write_atomically(path, |out| out.write_all(&bytes))
    }

    /// Loads the tensors of an encoder, under `DINOv2`'s names, identical to the published values rounded to half
    /// precision.
    ///
    /// # Errors
    /// The encoder is not installed, or its file was damaged since.
    pub fn load(&self, known: &KnownEncoder) -> Result<BTreeMap<String, Tensor>> {
        let path = self.path(known);
        if !path.exists() {
            let needs = format!("the weights `{}` need the encoder of", known.weights);
            return Err(self.missing(known, &needs));
        }
        verified(&path, known, known.identity)
    }

    /// Loads the tensors of the depth head of an encoder, under their published names, rounded to half precision. All but
    /// `depth_head.resize_layers.3.weight` have the published values.
    ///
    /// # Errors
    /// The head is not installed, or its file was damaged since.
    pub fn load_head(&self, known: &KnownEncoder) -> Result<BTreeMap<String, Tensor>> {
        let path = self.head_path(known);
        let Some(head) = known.head else {
            let what = format!("{} has no depth head", known.name);
            return Err(Error::config(what));
        };
        if path.exists() {
            return verified(&path, known, head.identity);
        }
        let folder = self.folder.display();
        let what = format!(
            "`{folder}` has the encoder of {} without its depth head",
            known.name
        );
        Err(Error::new(Cause::Read, what).hint(format!(
            "it was installed by an earlier version, or from a file without the head; `lsdc weights get {}` or \
             `lsdc weights add FILE` adds the head of the published file",
            known.weights
        )))
    }

    /// Error of an encoder that is not installed; `needs` precedes its name.
    pub(super) fn missing(&self, known: &KnownEncoder, needs: &str) -> Error {
        let (name, folder) = (known.name, self.folder.display());
        let message = format!("{needs} {name}, which is not in `{folder}`");
        Error::new(Cause::Read, message).hint(how_to_install(known))
    }
}

/// Loads the tensors of an installed file after checking the identity of those with known values.
fn verified(path: &Path, known: &KnownEncoder, identity: &str) -> Result<BTreeMap<String, Tensor>> {
    let bytes = read_bounded(path)?;
    let damaged = || {
        Error::format(path, format!("is not {} any more", known.name)).hint(format!(
            "{}, with --force to replace the file",
            how_to_install(known)
        ))
    };
    let file = SafeTensors::deserialize(&bytes).map_err(|e| damaged().because(e))?;
    let views: BTreeMap<String, TensorView<'_>> = file.tensors().into_iter().collect();
    let mut sum = IdentityHash::default();
    let (found, tensors) = rayon::join(
        || {
            for (name, view) in views.iter().filter(|(name, _)| is_fixed(name)) {
                sum.add(name, view.shape(), view.data());
            }
            sum.text()
        },
        || {
            let tensors = views.par_iter();
            let tensors = tensors.map(|(name, view)| Some((name.clone(), tensor(view)?)));
            tensors.collect::<Option<BTreeMap<_, _>>>()
        },
    );
    tensors.filter(|_| found == identity).ok_or_else(damaged)
}

/// Returns the commands that install an encoder, with its size and licence.
pub fn how_to_install(known: &KnownEncoder) -> String {
    let KnownEncoder {
        weights, licence, ..
    } = known;
    let megabytes = |bytes: u64| (bytes + 500_000) / 1_000_000;
    let head = known.head.map_or(0, |head| head.bytes);
    let download = megabytes(known.download_bytes);
    let kept = megabytes(known.bytes() + head);
    format!(
        "`lsdc weights get {weights}` downloads it ({download} MB, of which {kept} MB are kept; licence {licence}); \
         without a network, `lsdc weights add FILE` takes its published file"
    )
}

/// Returns the bytes of a safetensors file, with a single metadata entry to make them reproducible.
fn file_bytes(tensors: &BTreeMap<String, Tensor>, known: &KnownEncoder) -> Result<Vec<u8>> {
    let about = format!("{}, licence {}", known.name, known.licence);
    let metadata = HashMap::from([("about".to_owned(), about)]);
    let tensors = tensors.iter();
    let tensors = tensors.map(|(name, tensor)| (name.clone(), tensor, Precision::Half));
    stored_bytes(tensors, metadata)
}

/// Reads a half-precision tensor; `None` for other precisions.
fn tensor(view: &TensorView<'_>) -> Option<Tensor> {
    let is_half = view.dtype() == Dtype::F16;
    let values = is_half.then(|| FloatType::F16.values(view.data()))?;
    Tensor::new(view.shape().to_vec(), values)
}

#[cfg(test)]
mod tests;
