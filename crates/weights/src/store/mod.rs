//! The user's data folder, where encoders are kept in half precision.

use super::known::{Known, Sum, halves, recognise};
use super::{bytes_of, read_encoder};
use etcetera::BaseStrategy as _;
use half::f16;
use half::slice::{HalfBitsSliceExt as _, HalfFloatSliceExt as _};
use lsdc_core::weights::Tensor;
use lsdc_files::error::{Cause, Error, Result};
use lsdc_files::{remove_leftovers, write_atomically};
use rayon::prelude::*;
use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, TensorView};
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

/// The environment variable that names another folder.
pub const FOLDER: &str = "LSDC_WEIGHTS";

/// A folder of encoders.
#[derive(Clone, Debug)]
pub struct Store {
    folder: PathBuf,
}

/// What came of adding an encoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Added {
    /// It is there now.
    New,
    /// It was there before, and nothing has changed.
    Before,
}

impl Store {
    /// The user's: [`FOLDER`], or `lsdc/weights` in the data folder of the platform, which is `XDG_DATA_HOME` or
    /// `~/.local/share` but on Windows. It need not exist.
    ///
    /// # Errors
    /// Nothing says where the user's files are.
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

    /// That of a folder, which need not exist.
    pub fn at(folder: PathBuf) -> Self {
        Self { folder }
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Where an encoder is, once it was added.
    pub fn path(&self, known: &Known) -> PathBuf {
        self.folder
            .join(format!("{}-encoder.safetensors", known.weights))
    }

    /// Adds the encoder in a file that [`read_encoder`] reads, if it is one of `known`. One that is there is replaced
    /// if `replace` is set.
    ///
    /// # Errors
    /// A file that cannot be read or holds another encoder, one in the folder that is damaged, or a folder that cannot
    /// be written.
    pub fn add<'a>(
        &self,
        file: &Path,
        known: &'a [Known],
        replace: bool,
    ) -> Result<(&'a Known, Added)> {
        let tensors = read_encoder(file)?;
        let known = recognise(file, &tensors, known)?;
        let path = self.path(known);
        if path.exists() && !replace {
            self.load(known)
                .map_err(|e| e.hint("give --force to replace it"))?;
            return Ok((known, Added::Before));
        }
        let bytes = in_halves(&tensors, known)?;
        let folder = &self.folder;
        std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
        remove_leftovers(folder);
        write_atomically(&path, |out| out.write_all(&bytes))?;
        Ok((known, Added::New))
    }

    /// The tensors of an encoder, by `DINOv2`'s names, with every bit as published, rounded to half precision.
    ///
    /// # Errors
    /// It was not added, or its file was damaged since.
    pub fn load(&self, known: &Known) -> Result<BTreeMap<String, Tensor>> {
        let path = self.path(known);
        let bytes = match bytes_of(&path) {
            Ok(bytes) => bytes,
            Err(_) if !path.exists() => return Err(self.missing(known)),
            Err(error) => return Err(error),
        };
        let damaged = || {
            Error::format(&path, format!("is not {} any more", known.name)).hint(format!(
                "{}, with --force to replace the file",
                how_to_install(known)
            ))
        };
        let file = SafeTensors::deserialize(&bytes).map_err(|e| damaged().because(e))?;
        let views: BTreeMap<String, TensorView<'_>> = file.tensors().into_iter().collect();
        let mut sum = Sum::default();
        let (found, tensors) = rayon::join(
            || {
                for (name, view) in &views {
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
        tensors
            .filter(|_| found == known.identity)
            .ok_or_else(damaged)
    }

    fn missing(&self, known: &Known) -> Error {
        let (weights, name) = (known.weights, known.name);
        let folder = self.folder.display();
        let message = format!(
            "the weights `{weights}` need the encoder of {name}, which is not in `{folder}`"
        );
        Error::new(Cause::Read, message).hint(how_to_install(known))
    }
}

/// Returns the commands that install an encoder, with its size and licence.
pub fn how_to_install(known: &Known) -> String {
    let Known {
        weights, licence, ..
    } = known;
    let (download, kept) = (known.download / 1_000_000, known.bytes() / 1_000_000);
    format!(
        "`lsdc weights get {weights}` downloads it ({download} MB, of which {kept} MB are kept; licence {licence}); \
         without a network, `lsdc weights add FILE` takes its published file"
    )
}

/// The bytes of a safetensors file. One record, so that they are the same each time.
fn in_halves(tensors: &BTreeMap<String, Tensor>, known: &Known) -> Result<Vec<u8>> {
    let broken = |e: safetensors::SafeTensorError| {
        Error::weights("the encoder cannot be written").because(e)
    };
    let stored: Vec<(&String, &Tensor, Vec<u8>)> = tensors
        .iter()
        .map(|(name, tensor)| (name, tensor, halves(tensor)))
        .collect();
    let views = stored
        .iter()
        .map(|(name, tensor, bytes)| {
            let view = TensorView::new(Dtype::F16, tensor.shape().to_vec(), bytes);
            view.map(|view| (*name, view)).map_err(broken)
        })
        .collect::<Result<Vec<_>>>()?;
    let about = format!("{}, licence {}", known.name, known.licence);
    let metadata = HashMap::from([("about".to_owned(), about)]);
    safetensors::serialize(views, Some(metadata)).map_err(broken)
}

/// A tensor in half precision; `None` if it is in another.
fn tensor(view: &TensorView<'_>) -> Option<Tensor> {
    if view.dtype() != Dtype::F16 {
        return None;
    }
    let (pairs, _) = view.data().as_chunks::<2>();
    let bits: Vec<u16> = pairs.iter().map(|pair| u16::from_le_bytes(*pair)).collect();
    let halves: &[f16] = bits.reinterpret_cast();
    Tensor::new(view.shape().to_vec(), halves.to_f32_vec())
}

#[cfg(test)]
mod tests;
