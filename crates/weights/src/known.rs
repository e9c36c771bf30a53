//! Known encoders, and their identification.

use super::names::{LEARNED_LAYER, RESIZE_LAYER};
use half::f16;
use half::slice::HalfFloatSliceExt as _;
use lsdc_core::network::{EncoderConfig, PATCH};
use lsdc_core::weights::Tensor;
use lsdc_files::error::{Error, Result};
use sha2::{Digest as _, Sha256};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

/// A published encoder that weights of the program are built on.
#[derive(Clone, Copy, Debug)]
pub struct KnownEncoder {
    /// Name of the weights.
    pub weights: &'static str,
    /// Name of the encoder.
    pub name: &'static str,
    /// Licence of its values.
    pub licence: &'static str,
    /// [`identity`] of its tensors.
    pub identity: &'static str,
    /// Returns its sizes.
    pub sizes: fn() -> EncoderConfig,
    /// Download addresses, in the order in which they are tried.
    pub urls: &'static [&'static str],
    /// Size of a published file in bytes, to three digits.
    pub download_bytes: u64,
    /// Additional time of a completion.
    pub extra_time: &'static str,
    /// Depth head published with it.
    pub head: Option<KnownHead>,
}

/// The depth head of a published network, which the guide `depth-anything` needs in addition to the encoder.
#[derive(Clone, Copy, Debug)]
pub struct KnownHead {
    /// [`identity`] of its tensors, except for `depth_head.resize_layers.3.weight`, which lsdc replaces by its own.
    pub identity: &'static str,
    /// Size in the data folder, in bytes.
    pub bytes: u64,
}

/// Encoder of the weights `anything`.
pub const ANYTHING: KnownEncoder = KnownEncoder {
    weights: "anything",
    name: "Depth Anything V2 Small (ViT-S/14)",
    licence: "Apache-2.0",
    identity: "285a2de5a485fce67de54fd0e01da30a1d1c3f35434c51149d25c661874dbb3a",
    sizes: EncoderConfig::small,
    urls: &[
        "https://huggingface.co/depth-anything/Depth-Anything-V2-Small-hf/resolve/main/model.safetensors",
        "https://huggingface.co/depth-anything/Depth-Anything-V2-Small/resolve/main/depth_anything_v2_vits.pth",
    ],
    download_bytes: 99_200_000,
    extra_time: "0.12 to 0.25 s more per image on two cores",
    head: Some(KnownHead {
        identity: "54bdb01234e19cb4d473d54247159f24af66c3ba49eb00f173d05aad70e1e818",
        bytes: 5_457_026,
    }),
};

/// All known encoders.
pub const KNOWN: [KnownEncoder; 1] = [ANYTHING];

impl KnownEncoder {
    /// Returns the shapes of its tensors.
    pub(super) fn shapes(&self) -> BTreeMap<String, Vec<usize>> {
        let EncoderConfig {
            width,
            hidden,
            blocks,
            side,
            ..
        } = (self.sizes)();
        let mut shapes = BTreeMap::new();
        let mut add = |name: String, shape: &[usize]| shapes.insert(name, shape.to_vec());
        add("cls_token".into(), &[1, 1, width]);
        add("pos_embed".into(), &[1, 1 + side * side, width]);
        add("patch_embed.proj.weight".into(), &[width, 3, PATCH, PATCH]);
        add("patch_embed.proj.bias".into(), &[width]);
        for block in 0..blocks {
            for (part, rows, columns) in [
                ("attn.qkv", 3 * width, width),
                ("attn.proj", width, width),
                ("mlp.fc1", hidden, width),
                ("mlp.fc2", width, hidden),
            ] {
                add(format!("blocks.{block}.{part}.weight"), &[rows, columns]);
                add(format!("blocks.{block}.{part}.bias"), &[rows]);
            }
            for part in [
                "norm1.weight",
                "norm1.bias",
                "norm2.weight",
                "norm2.bias",
                "ls1.gamma",
                "ls2.gamma",
            ] {
                add(format!("blocks.{block}.{part}"), &[width]);
            }
        }
        add("norm.weight".into(), &[width]);
        add("norm.bias".into(), &[width]);
        shapes
    }

    /// Returns its size in the data folder in bytes, without a header of some kilobytes.
    pub fn bytes(&self) -> u64 {
        let counts = self.shapes().into_values();
        2 * counts
            .map(|shape| shape.iter().product::<usize>() as u64)
            .sum::<u64>()
    }

    /// Describes the first tensor with an unexpected shape; `None` if all shapes match.
    fn difference(&self, tensors: &BTreeMap<String, Tensor>) -> Option<String> {
        let shapes = self.shapes();
        let wrong = shapes.iter().find_map(|(name, shape)| {
            let Some(tensor) = tensors.get(name) else {
                return Some(format!("has no `{name}`"));
            };
            let found = tensor.shape();
            (found != shape).then(|| {
                let (found, expected) = (shape_text(found), shape_text(shape));
                format!("has `{name}` of shape {found} instead of {expected}")
            })
        });
        wrong.or_else(|| {
            let superfluous = tensors.keys().find(|name| !shapes.contains_key(*name))?;
            Some(format!("has `{superfluous}` too"))
        })
    }

    /// Error of a file with tensors of these shapes whose identity is `found`.
    fn other_values(&self, path: &Path, found: &str) -> Error {
        // Long enough to distinguish them.
        let start = |identity: &str| identity.chars().take(12).collect::<String>();
        let Self { weights, name, .. } = self;
        let what = format!(
            "has the tensors of {name}, but other values (SHA-256 {}... instead of {}...)",
            start(found),
            start(self.identity)
        );
        Error::format(path, what).hint(format!(
            "the file is damaged, or of another training, as DINOv2's own `dinov2_vits14_pretrain.pth` is; \
             the weights `{weights}` were trained on the values of {name} and fit no others"
        ))
    }
}

/// Returns the encoder among `known` with these tensors of the file `path`.
///
/// # Errors
/// None matches: the message contains what was expected and found.
pub fn recognise<'a>(
    path: &Path,
    tensors: &BTreeMap<String, Tensor>,
    known: &'a [KnownEncoder],
) -> Result<&'a KnownEncoder> {
    let found = identity(tensors);
    if let Some(known) = known.iter().find(|known| known.identity == found) {
        return Ok(known);
    }
    let same_shapes = known
        .iter()
        .find(|known| known.difference(tensors).is_none());
    if let Some(same_shapes) = same_shapes {
        return Err(same_shapes.other_values(path, &found));
    }
    let names: Vec<&str> = known.iter().map(|known| known.name).collect();
    let urls: Vec<&str> = known.iter().flat_map(|known| known.urls).copied().collect();
    let difference = known.iter().find_map(|known| known.difference(tensors));
    let what = format!(
        "is not the encoder of {}: it {}",
        names.join(" or "),
        difference.unwrap_or_default()
    );
    Err(Error::format(path, what).hint(format!("expected is a file from {}", urls.join(" or "))))
}

/// Returns the encoder among `known` that the depth head in the file `path` belongs to.
///
/// # Errors
/// None matches.
pub(super) fn recognise_head<'a>(
    path: &Path,
    head: &BTreeMap<String, Tensor>,
    known: &'a [KnownEncoder],
) -> Result<&'a KnownEncoder> {
    let found = head_identity(head);
    let is_found = |known: &&KnownEncoder| known.head.is_some_and(|head| head.identity == found);
    if let Some(known) = known.iter().find(is_found) {
        return Ok(known);
    }
    let with_head = known.iter().filter(|known| known.head.is_some());
    let names: Vec<&str> = with_head.clone().map(|known| known.name).collect();
    let urls: Vec<&str> = with_head.flat_map(|known| known.urls).copied().collect();
    let what = format!(
        "has a depth head of other values than that of {}",
        names.join(" or ")
    );
    Err(Error::format(path, what).hint(format!(
        "the file is damaged, or of another training; expected is a file from {}",
        urls.join(" or ")
    )))
}

/// Returns the [`identity`] of the tensors of a depth head with known published values.
fn head_identity(head: &BTreeMap<String, Tensor>) -> String {
    let mut sum = IdentityHash::default();
    for (name, tensor) in head.iter().filter(|(name, _)| is_fixed(name)) {
        sum.add(name, tensor.shape(), &f16_bytes(tensor));
    }
    sum.text()
}

/// Whether a tensor is part of the identity of a network.
pub(super) fn is_fixed(name: &str) -> bool {
    name != RESIZE_LAYER && name != LEARNED_LAYER
}

/// Returns the SHA-256 of the names, shapes and values of tensors, rounded to half precision. It does not depend on the
/// container and the precision of a network.
pub fn identity(tensors: &BTreeMap<String, Tensor>) -> String {
    let mut sum = IdentityHash::default();
    for (name, tensor) in tensors {
        sum.add(name, tensor.shape(), &f16_bytes(tensor));
    }
    sum.text()
}

/// Incremental computation of an [`identity`].
#[derive(Default)]
pub(super) struct IdentityHash(Sha256);

impl IdentityHash {
    /// Adds a tensor with its values in half precision; tensors must be added in the order of their names.
    pub(super) fn add(&mut self, name: &str, shape: &[usize], f16_bytes: &[u8]) {
        self.0.update(format!("{name} {}\n", shape_text(shape)));
        self.0.update(f16_bytes);
    }

    pub(super) fn text(self) -> String {
        hexadecimal(&self.0.finalize())
    }
}

/// Returns the SHA-256 of bytes.
pub(super) fn sha256(bytes: &[u8]) -> String {
    hexadecimal(&Sha256::digest(bytes))
}

fn hexadecimal(bytes: &[u8]) -> String {
    let mut text = String::new();
    for byte in bytes {
        // Writing to a string does not fail.
        let _ = write!(text, "{byte:02x}");
    }
    text
}

/// Returns the values of a tensor in half precision, little-endian.
pub(super) fn f16_bytes(tensor: &Tensor) -> Vec<u8> {
    let mut rounded = vec![f16::ZERO; tensor.values().len()];
    rounded.convert_from_f32_slice(tensor.values());
    rounded.iter().flat_map(|v| v.to_le_bytes()).collect()
}

fn shape_text(shape: &[usize]) -> String {
    let sides: Vec<String> = shape.iter().map(usize::to_string).collect();
    sides.join("x")
}
