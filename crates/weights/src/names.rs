//! The names that different programs give to the tensors of one encoder.

use lsdc_core::weights::Tensor;
use lsdc_files::error::{Error, Result};
use std::collections::BTreeMap;
use std::path::Path;

/// What stands before the names of an encoder in larger networks.
const PREFIXES: [&str; 5] = ["pretrained.", "backbone.", "dinov2.", "model.", "module."];
/// Needed in training only.
const UNUSED: &str = "mask_token";
/// Tensors of queries, keys and values, which `DINOv2` has in one.
const PARTS: [[&str; 3]; 2] = [
    [
        "attention.attention.query",
        "attention.attention.key",
        "attention.attention.value",
    ],
    ["attention.q_proj", "attention.k_proj", "attention.v_proj"],
];
/// Names of transformers, and those of `DINOv2`.
const RENAMED: [(&str, &str); 9] = [
    ("embeddings.cls_token", "cls_token"),
    ("embeddings.mask_token", "mask_token"),
    ("embeddings.position_embeddings", "pos_embed"),
    ("embeddings.patch_embeddings.projection", "patch_embed.proj"),
    ("attention.output.dense", "attn.proj"),
    ("attention.o_proj", "attn.proj"),
    ("layer_scale1.lambda1", "ls1.gamma"),
    ("layer_scale2.lambda1", "ls2.gamma"),
    ("layernorm", "norm"),
];
/// What names of an encoder begin with.
const BEGINNINGS: [&str; 5] = ["cls_token", "pos_embed", "patch_embed.", "blocks.", "norm."];

/// The tensors of the encoder among `all`, by `DINOv2`'s names.
///
/// # Errors
/// No encoder, or one of which queries, keys or values are missing.
pub(super) fn dinov2(
    path: &Path,
    all: BTreeMap<String, Tensor>,
) -> Result<BTreeMap<String, Tensor>> {
    let mut found = BTreeMap::new();
    let mut thirds: BTreeMap<String, [Option<Tensor>; 3]> = BTreeMap::new();
    for (name, tensor) in all {
        let name = plain(&name);
        if let Some((joint, place)) = third(&name) {
            thirds.entry(joint).or_default()[place] = Some(tensor);
        } else if name != UNUSED && BEGINNINGS.iter().any(|start| name.starts_with(start)) {
            found.insert(name, tensor);
        }
    }
    for (name, parts) in thirds {
        let joined = join(parts)
            .ok_or_else(|| Error::format(path, format!("parts of `{name}` are missing")))?;
        found.insert(name, joined);
    }
    if found.contains_key("patch_embed.proj.weight") {
        Ok(found)
    } else {
        Err(Error::format(path, "holds no encoder in the form of DINOv2").hint(
            "expected is the published `depth_anything_v2_vits.pth` or a safetensors file of the same network",
        ))
    }
}

/// A name as in `DINOv2`.
fn plain(name: &str) -> String {
    let mut name = name;
    while let Some(rest) = PREFIXES.iter().find_map(|prefix| name.strip_prefix(prefix)) {
        name = rest;
    }
    let mut name = match name.strip_prefix("encoder.layer.") {
        Some(rest) => format!("blocks.{rest}"),
        None => name.to_owned(),
    };
    for (theirs, ours) in RENAMED {
        name = name.replace(theirs, ours);
    }
    name
}

/// Where queries, keys or values belong: the name of all three, and which it is.
fn third(name: &str) -> Option<(String, usize)> {
    PARTS.iter().find_map(|parts| {
        let place = parts.iter().position(|part| name.contains(part))?;
        Some((name.replace(parts[place], "attn.qkv"), place))
    })
}

/// Three tensors in one, along the first axis.
fn join(parts: [Option<Tensor>; 3]) -> Option<Tensor> {
    let parts = parts.into_iter().collect::<Option<Vec<_>>>()?;
    let mut shape = parts[0].shape().to_vec();
    if parts.iter().any(|part| part.shape() != shape) {
        return None;
    }
    *shape.first_mut()? *= 3;
    let values = parts.iter().flat_map(Tensor::values).copied();
    Tensor::new(shape, values.collect())
}
