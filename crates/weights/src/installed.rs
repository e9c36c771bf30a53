//! The encoder that weights need, and its depth head, from the user's data folder.

use crate::embedded::resize_layer;
use crate::known::sha256;
use crate::names::{LEARNED_LAYER, RESIZE_LAYER};
use crate::{KNOWN, Store, identity};
use lsdc_core::network::{DepthHead, Encoder, EncoderConfig, NetworkConfig};
use lsdc_core::weights::Tensor;
use lsdc_core::{Completer, DepthAnything, Weights};
use lsdc_files::error::{Error, Result};
use lsdc_kernels::simd::Level;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, OnceLock};

/// Reads the encoder of the weights `anything` from the user's data folder.
///
/// # Errors
/// The encoder is not installed (the error contains its size, its licence, and the commands that install it), or its file
/// was damaged since.
pub fn installed() -> Result<BTreeMap<String, Tensor>> {
    let [anything] = &KNOWN;
    Store::open()?.load(anything)
}

/// Returns the encoder that a network was trained on, prepared for the CPU; `None` if it needs none. It is prepared once
/// per process.
///
/// # Errors
/// As [`installed`].
pub fn encoder_of(network: &NetworkConfig) -> Result<Option<Arc<Encoder>>> {
    if network.extractor.encoder == 0 {
        return Ok(None);
    }
    prepared_encoder().map(Some)
}

/// Returns the encoder of the weights `anything`, prepared once per process.
fn prepared_encoder() -> Result<Arc<Encoder>> {
    static PREPARED: OnceLock<Arc<Encoder>> = OnceLock::new();
    if let Some(encoder) = PREPARED.get() {
        return Ok(encoder.clone());
    }
    // Without a lock, because a pool thread that waits here for its subtasks could start another call of this function.
    let encoder = Encoder::new(EncoderConfig::small(), &installed()?, Level::here())?;
    Ok(PREPARED.get_or_init(|| Arc::new(encoder)).clone())
}

/// Variants of the tensor `depth_head.resize_layers.3.weight` of Depth Anything V2 Small.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ResizeLayer {
    /// The tensor of this library, trained in place of the published one. Published results use it. Without the feature
    /// `weights`, that of the installed file.
    #[default]
    Learned,
    /// The published tensor.
    Published,
}

impl ResizeLayer {
    /// Both variants.
    pub const ALL: [Self; 2] = [Self::Learned, Self::Published];

    /// Returns the argument of `--head`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Learned => "learned",
            Self::Published => "published",
        }
    }

    /// Removes both tensors from a head read from the file `path`, and returns this one.
    fn take_from(self, head: &mut BTreeMap<String, Tensor>, path: &Path) -> Result<Tensor> {
        let learned = head.remove(LEARNED_LAYER);
        let published = head.remove(RESIZE_LAYER);
        let chosen = match self {
            Self::Learned => resize_layer().or(learned),
            Self::Published => published,
        };
        chosen.ok_or_else(|| match self {
            Self::Learned => Error::format(path, format!("has no `{LEARNED_LAYER}`"))
                .hint("a program built with its weights has this tensor"),
            Self::Published => Error::format(path, format!("has no `{RESIZE_LAYER}`")).hint(
                "`lsdc weights add FILE` adds it from the published file; only --head published needs it",
            ),
        })
    }
}

/// Depth Anything V2 Small, as installed.
#[derive(Clone, Debug)]
pub struct InstalledDepthAnything {
    /// The network.
    pub network: DepthAnything,
    /// Hash of its tensors.
    pub hash: String,
}

/// Depth Anything V2 Small with each [`ResizeLayer`], once it is prepared.
static PREPARED: [OnceLock<InstalledDepthAnything>; 2] = [const { OnceLock::new() }; 2];

/// Returns Depth Anything V2 Small from the user's data folder, prepared for the CPU. It is prepared once per process, and
/// shares its encoder with the weights `anything`.
///
/// # Errors
/// It is not installed, or without its depth head, or its files were damaged since.
pub fn depth_anything(layer: ResizeLayer) -> Result<InstalledDepthAnything> {
    let place = &PREPARED[layer as usize];
    if let Some(found) = place.get() {
        return Ok(found.clone());
    }
    let [known] = &KNOWN;
    let store = Store::open()?;
    if !store.path(known).exists() {
        return Err(store.missing(known, "the guide `depth-anything` needs"));
    }
    let (head, hash) = head_tensors(&store, layer)?;
    let head = DepthHead::new(&head, Level::here())?;
    let found = InstalledDepthAnything {
        network: DepthAnything::with_parts(prepared_encoder()?, head)?,
        hash,
    };
    Ok(place.get_or_init(|| found).clone())
}

/// Returns the tensors of the installed depth head, and the hash of all tensors of Depth Anything.
fn head_tensors(store: &Store, layer: ResizeLayer) -> Result<(BTreeMap<String, Tensor>, String)> {
    let [known] = &KNOWN;
    let mut head = store.load_head(known)?;
    let chosen = layer.take_from(&mut head, &store.head_path(known))?;
    let chosen = BTreeMap::from([(RESIZE_LAYER.to_owned(), chosen)]);
    // The identities of the other tensors have been checked.
    let fixed = known.head.map_or("", |head| head.identity);
    let tensors = format!("{} {fixed} {}", known.identity, identity(&chosen));
    head.extend(chosen);
    let hash = sha256(tensors.as_bytes()).chars().take(16).collect();
    Ok((head, hash))
}

/// Returns the tensors of the depth head that [`guided_by_head`] uses, for other devices; `None` if it is not installed.
///
/// # Errors
/// Files in the user's data folder were damaged.
pub fn installed_head() -> Result<Option<BTreeMap<String, Tensor>>> {
    let store = Store::open()?;
    if !head_exists(&store) {
        return Ok(None);
    }
    let (head, _) = head_tensors(&store, ResizeLayer::default())?;
    Ok(Some(head))
}

/// Returns the hash of Depth Anything V2 Small, whose depth head guides the scenes of a network with its encoder (see
/// [`guided_by_head`]). `None` for other networks, and if the head is not installed.
///
/// # Errors
/// Files in the user's data folder were damaged.
pub fn head_hash(network: &NetworkConfig) -> Result<Option<String>> {
    if network.extractor.encoder == 0 {
        return Ok(None);
    }
    let store = Store::open()?;
    if !head_exists(&store) {
        return Ok(None);
    }
    let layer = ResizeLayer::default();
    if let Some(prepared) = PREPARED[layer as usize].get() {
        return Ok(Some(prepared.hash.clone()));
    }
    let (_, hash) = head_tensors(&store, layer)?;
    Ok(Some(hash))
}

/// Adds the depth head of the encoder as a guide of the scenes of a completer, if it is installed; the encoder runs once
/// for both. Other completers, and those whose device already runs the head, are returned unchanged.
///
/// # Errors
/// As for [`head_hash`].
pub fn guided_by_head(completer: Completer) -> Result<Completer> {
    if !completer.can_have_depth_head() {
        return Ok(completer);
    }
    if !head_exists(&Store::open()?) {
        return Ok(completer);
    }
    let found = depth_anything(ResizeLayer::default())?;
    Ok(completer.with_depth_head(found.network.depth_head())?)
}

fn head_exists(store: &Store) -> bool {
    let [known] = &KNOWN;
    store.path(known).exists() && store.head_path(known).exists()
}

/// Prepares weights for the CPU, with the fit that they were trained for, and the encoder that they need.
///
/// # Errors
/// The weights do not match their network, or as [`installed`].
pub fn completer(weights: &Weights) -> Result<Completer> {
    let builder = Completer::builder(weights);
    Ok(match encoder_of(&weights.network)? {
        None => builder,
        Some(encoder) => builder.encoder(encoder),
    }
    .build()?)
}

#[cfg(all(test, feature = "weights"))]
mod tests {
    use super::*;

    #[test]
    fn the_published_tensor_is_used_where_it_is_asked_for_alone() {
        let tensor = |value: f32| Tensor::new(vec![1], vec![value]).unwrap();
        let bias = "depth_head.resize_layers.3.bias";
        let named = [(bias, 0.5), (LEARNED_LAYER, 1.5), (RESIZE_LAYER, 2.5)];
        let named = named.map(|(name, value)| (name.to_owned(), tensor(value)));
        let whole = BTreeMap::from(named);
        let path = Path::new("anything-head.safetensors");
        for (layer, expected) in [
            (ResizeLayer::Learned, resize_layer().unwrap()),
            (ResizeLayer::Published, tensor(2.5)),
        ] {
            let mut head = whole.clone();
            assert_eq!(layer.take_from(&mut head, path).unwrap(), expected);
            assert_eq!(head, BTreeMap::from([(bias.to_owned(), tensor(0.5))]));
        }

        let mut lacking = whole.clone();
        lacking.remove(RESIZE_LAYER);
        let learned = ResizeLayer::Learned.take_from(&mut lacking.clone(), path);
        assert_eq!(learned.unwrap(), resize_layer().unwrap());
        let error = ResizeLayer::Published.take_from(&mut lacking, path);
        let error = error.unwrap_err();
        assert!(error.to_string().contains(RESIZE_LAYER), "{error}");
        assert!(error.advice().unwrap().contains("`lsdc weights add FILE`"));
    }
}
