//! Names that different programs give to the tensors of an encoder.

use lsdc_core::network::DEPTH_HEAD;
use lsdc_core::weights::Tensor;
use lsdc_files::error::{Error, Result};
use std::collections::BTreeMap;
use std::path::Path;

/// Prefixes of the names of an encoder in larger networks.
const PREFIXES: [&str; 5] = ["pretrained.", "backbone.", "dinov2.", "model.", "module."];
/// Tensor that every encoder has.
const PATCHES: &str = "patch_embed.proj.weight";
/// Tensor that is only needed in training.
const UNUSED: &str = "mask_token";
/// Tensors of queries, keys and values, which `DINOv2` stores as one.
const QKV_PARTS: [[&str; 3]; 2] = [
    [
        "attention.attention.query",
        "attention.attention.key",
        "attention.attention.value",
    ],
    ["attention.q_proj", "attention.k_proj", "attention.v_proj"],
];
/// Names in transformers, and in `DINOv2`.
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
/// Tensor of a depth head that was trained by the authors of lsdc to replace [`RESIZE_LAYER`].
pub(super) const LEARNED_LAYER: &str = "learned.resize_layers.3.weight";
/// Published tensor that [`LEARNED_LAYER`] replaces.
pub(super) const RESIZE_LAYER: &str = "depth_head.resize_layers.3.weight";
/// Prefixes of the tensor names of an encoder.
const ENCODER_PREFIXES: [&str; 5] = ["cls_token", "pos_embed", "patch_embed.", "blocks.", "norm."];

/// Returns the tensors of the encoder among `all`, under `DINOv2`'s names.
///
/// # Errors
/// There is no encoder, or queries, keys or values are missing.
pub(super) fn dinov2(
    path: &Path,
    all: BTreeMap<String, Tensor>,
) -> Result<BTreeMap<String, Tensor>> {
    let mut found = BTreeMap::new();
    let mut qkv: BTreeMap<String, [Option<Tensor>; 3]> = BTreeMap::new();
    for (name, tensor) in all {
        let name = dinov2_name(&name);
        if let Some((name, index)) = qkv_part(&name) {
            qkv.entry(name).or_default()[index] = Some(tensor);
        } else if name != UNUSED && ENCODER_PREFIXES.iter().any(|start| name.starts_with(start)) {
            found.insert(name, tensor);
        }
    }
    for (name, parts) in qkv {
        let joined = concatenated(parts)
            .ok_or_else(|| Error::format(path, format!("parts of `{name}` are missing")))?;
        found.insert(name, joined);
    }
    if found.contains_key(PATCHES) {
        Ok(found)
    } else {
        Err(Error::format(path, "holds no encoder in the form of DINOv2").hint(
            "expected is the published `depth_anything_v2_vits.pth` or a safetensors file of the same network",
        ))
    }
}

/// Splits `all` into the tensors of a depth head, under their published names, and the others.
pub(super) fn depth_head(
    all: BTreeMap<String, Tensor>,
) -> (BTreeMap<String, Tensor>, BTreeMap<String, Tensor>) {
    let (mut head, mut others) = (BTreeMap::new(), BTreeMap::new());
    for (name, tensor) in all {
        match depth_head_name(&name) {
            Some(name) => head.insert(name, tensor),
            None => others.insert(name, tensor),
        };
    }
    (head, others)
}

/// Whether the tensors include an encoder, judging by one name.
pub(super) fn has_encoder(tensors: &BTreeMap<String, Tensor>) -> bool {
    tensors.keys().any(|name| dinov2_name(name) == PATCHES)
}

/// Returns the published name of a tensor of a depth head; `None` for other tensors.
fn depth_head_name(name: &str) -> Option<String> {
    let name = bare(name);
    if name == LEARNED_LAYER || name.starts_with(DEPTH_HEAD) {
        return Some(name.to_owned());
    }
    // Names in transformers.
    let parts: Vec<&str> = name.split('.').collect();
    let place = |text: &str| text.parse::<usize>().ok().filter(|place| *place < 4);
    let renamed = match parts[..] {
        ["neck", "reassemble_stage", "layers", i, "projection", part] => {
            format!("projects.{}.{part}", place(i)?)
        }
        ["neck", "reassemble_stage", "layers", i, "resize", part] => {
            format!("resize_layers.{}.{part}", place(i)?)
        }
        ["neck", "convs", i, part] => format!("scratch.layer{}_rn.{part}", place(i)? + 1),
        // In transformers the coarsest layer is first.
        ["neck", "fusion_stage", "layers", i, "projection", part] => {
            format!("scratch.refinenet{}.out_conv.{part}", 4 - place(i)?)
        }
        ["neck", "fusion_stage", "layers", i, unit, conv, part] => {
            let unit = unit.strip_prefix("residual_layer")?;
            let conv = conv.strip_prefix("convolution")?;
            let number = 4 - place(i)?;
            format!("scratch.refinenet{number}.resConfUnit{unit}.conv{conv}.{part}")
        }
        ["head", "conv1", part] => format!("scratch.output_conv1.{part}"),
        ["head", "conv2", part] => format!("scratch.output_conv2.0.{part}"),
        ["head", "conv3", part] => format!("scratch.output_conv2.2.{part}"),
        _ => return None,
    };
    Some(format!("{DEPTH_HEAD}{renamed}"))
}

/// Returns a name without the prefixes of larger networks.
fn bare(name: &str) -> &str {
    let mut name = name;
    while let Some(rest) = PREFIXES.iter().find_map(|prefix| name.strip_prefix(prefix)) {
        name = rest;
    }
    name
}

/// Returns the name in `DINOv2`.
fn dinov2_name(name: &str) -> String {
    let name = bare(name);
    let mut name = match name.strip_prefix("encoder.layer.") {
        Some(rest) => format!("blocks.{rest}"),
        None => name.to_owned(),
    };
    for (theirs, ours) in RENAMED {
        name = name.replace(theirs, ours);
    }
    name
}

/// Returns the combined tensor of queries, keys or values, and the index of this part.
fn qkv_part(name: &str) -> Option<(String, usize)> {
    QKV_PARTS.iter().find_map(|parts| {
        let index = parts.iter().position(|part| name.contains(part))?;
        Some((name.replace(parts[index], "attn.qkv"), index))
    })
}

/// Concatenates three tensors along the first axis.
fn concatenated(parts: [Option<Tensor>; 3]) -> Option<Tensor> {
    let parts = parts.into_iter().collect::<Option<Vec<_>>>()?;
    let mut shape = parts[0].shape().to_vec();
    if parts.iter().any(|part| part.shape() != shape) {
        return None;
    }
    *shape.first_mut()? *= 3;
    let values = parts.iter().flat_map(Tensor::values).copied();
    Tensor::new(shape, values.collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_transformers_are_those_that_were_published() {
        for (theirs, published) in [
            (
                "neck.reassemble_stage.layers.3.projection.bias",
                "projects.3.bias",
            ),
            (
                "neck.reassemble_stage.layers.0.resize.weight",
                "resize_layers.0.weight",
            ),
            ("neck.convs.2.weight", "scratch.layer3_rn.weight"),
            (
                "neck.fusion_stage.layers.0.projection.weight",
                "scratch.refinenet4.out_conv.weight",
            ),
            (
                "neck.fusion_stage.layers.3.residual_layer1.convolution2.bias",
                "scratch.refinenet1.resConfUnit1.conv2.bias",
            ),
            ("head.conv1.weight", "scratch.output_conv1.weight"),
            ("head.conv2.bias", "scratch.output_conv2.0.bias"),
            ("head.conv3.weight", "scratch.output_conv2.2.weight"),
        ] {
            let published = Some(format!("depth_head.{published}"));
            assert_eq!(depth_head_name(theirs), published);
            if let Some(published) = &published {
                assert_eq!(depth_head_name(published).as_ref(), Some(published));
            }
        }
        for other in [
            "blocks.0.norm1.bias",
            "head.hidden.0.weight",
            "neck.fusion_stage.layers.4.projection.weight",
        ] {
            assert_eq!(depth_head_name(other), None);
        }
        assert_eq!(
            depth_head_name(LEARNED_LAYER).as_deref(),
            Some(LEARNED_LAYER)
        );
    }
}
