//! Which encoders are known, and how one is recognised.

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

/// A published encoder, on which weights of the program are built.
#[derive(Clone, Copy, Debug)]
pub struct KnownEncoder {
    /// What the weights are called.
    pub weights: &'static str,
    /// What the encoder is.
    pub name: &'static str,
    /// The licence of its values.
    pub licence: &'static str,
    /// [`identity`] of its tensors.
    pub identity: &'static str,
    /// Its sizes.
    pub sizes: fn() -> EncoderConfig,
    /// Where it is published; the first is tried first.
    pub urls: &'static [&'static str],
    /// Bytes of a published file, to three digits.
    pub download_bytes: u64,
    /// The time that it adds to a completion.
    pub extra_time: &'static str,
    /// The depth head that was published with it.
    pub head: Option<KnownHead>,
}

/// The depth head of a published network, which the guide `depth-anything` needs beside the encoder.
#[derive(Clone, Copy, Debug)]
pub struct KnownHead {
    /// [`identity`] of its tensors, but for `depth_head.resize_layers.3.weight`, in whose place lsdc has a tensor of its own.
    pub identity: &'static str,
    /// Bytes that it takes in the data folder.
    pub bytes: u64,
}

/// The encoder of the weights `anything`.
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

/// All of them.
pub const KNOWN: [KnownEncoder; 1] = [ANYTHING];

impl KnownEncoder {
    /// The shapes of its tensors.
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

    /// Bytes that it takes in the data folder, but for a header of some kilobytes.
    pub fn bytes(&self) -> u64 {
        let counts = self.shapes().into_values();
        2 * counts
            .map(|shape| shape.iter().product::<usize>() as u64)
            .sum::<u64>()
    }

    /// The first tensor that has another shape than it should; `None` if all are as they should be.
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

    /// The file holds tensors of these shapes whose identity is `found`.
    fn other_values(&self, path: &Path, found: &str) -> Error {
        // Enough to tell them apart.
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

/// Which of `known` these tensors of the file `path` are.
///
/// # Errors
/// None of them: the message says what was expected, and what was found.
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

/// Which of `known` the depth head in the file `path` belongs to.
///
/// # Errors
/// None of them.
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

/// [`identity`] of the tensors of a depth head whose published values are known.
fn head_identity(head: &BTreeMap<String, Tensor>) -> String {
    let mut sum = IdentityHash::default();
    for (name, tensor) in head.iter().filter(|(name, _)| is_fixed(name)) {
        sum.add(name, tensor.shape(), &f16_bytes(tensor));
    }
    sum.text()
}

/// Whether a tensor counts for the identity of a network.
pub(super) fn is_fixed(name: &str) -> bool {
    name != RESIZE_LAYER && name != LEARNED_LAYER
}

/// SHA-256 over the names, shapes and values of tensors, rounded to half precision: the same for every container and
/// precision of a network.
pub fn identity(tensors: &BTreeMap<String, Tensor>) -> String {
    let mut sum = IdentityHash::default();
    for (name, tensor) in tensors {
        sum.add(name, tensor.shape(), &f16_bytes(tensor));
    }
    sum.text()
}

/// An [`identity`] in the making.
#[derive(Default)]
pub(super) struct IdentityHash(Sha256);

impl IdentityHash {
    /// Adds a tensor, by its values in half precision; names must come in their order.
    pub(super) fn add(&mut self, name: &str, shape: &[usize], f16_bytes: &[u8]) {
        self.0.update(format!("{name} {}\n", shape_text(shape)));
        self.0.update(f16_bytes);
    }

    pub(super) fn text(self) -> String {
        hexadecimal(&self.0.finalize())
    }
}

/// The SHA-256 of bytes.
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

/// The values of a tensor in half precision, the least byte first.
pub(super) fn f16_bytes(tensor: &Tensor) -> Vec<u8> {
    let mut rounded = vec![f16::ZERO; tensor.values().len()];
    rounded.convert_from_f32_slice(tensor.values());
    rounded.iter().flat_map(|v| v.to_le_bytes()).collect()
}

fn shape_text(shape: &[usize]) -> String {
    let sides: Vec<String> = shape.iter().map(usize::to_string).collect();
    sides.join("x")
}
