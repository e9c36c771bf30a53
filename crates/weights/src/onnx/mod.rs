//! Export of networks as ONNX graphs, for ONNX Runtime, `TensorRT` and other runtimes.
//!
//! The graph computes what `lsdc_core::network::CpuNetwork` computes. Its outputs are fitted to depths by
//! `Completer::scene_with_output`.

mod affinities;
mod extractor;
mod graph;
mod head;
mod layers;
mod proto;

use crate::error::{Error, Result};
use layers::Layers;
use lsdc_core::Weights;
use lsdc_core::network::CpuNetwork;
use lsdc_kernels::simd::Level;
use prost::Message;
use proto::{
    Dimension, Entry, Length, Model, OperatorSet, Shape, TensorType, Type, ValueInfo, element,
};

/// Version of the ONNX operator set, which runtimes have supported since 2020.
pub const OPSET: i64 = 13;
/// Version of the file format for this operator set.
const IR_VERSION: i64 = 7;

/// Returns the bytes of an ONNX file of the network of `weights`; `origin` describes them in its metadata.
///
/// Height and width of the image and the batch size are chosen at run time:
///
/// | name | shape | values |
/// |---|---|---|
/// | `image` | `[batch, 3, height, width]` | red, green, blue from 0 to 1; normalisation is part of the graph |
/// | `basis` | `[batch, N + 1, height, width]` | the basis functions; the first is 1, or a depth map up to scale |
/// | `affinities` | `[batch, 2, height, width]` | of each pixel with its right and its lower neighbour, above 0 |
///
/// # Errors
/// The weights do not match their network, or the network has a pretrained encoder or group normalisation.
///
/// ```
/// # fn main() -> lsdc_files::error::Result<()> {
/// # #[cfg(feature = "weights")] {
/// let weights = lsdc_weights::named("small").expect("built in").read()?;
/// let file = lsdc_weights::to_onnx(&weights, "`small`")?;
/// // As many parameters as the network has, of four bytes.
/// assert!(file.len() > 3_000_000);
/// # }
/// # Ok(())
/// # }
/// ```
pub fn to_onnx(weights: &Weights, origin: &str) -> Result<Vec<u8>> {
    let network = &weights.network;
    if network.extractor.encoder > 0 {
        return Err(
            Error::weights("a network on a pretrained encoder cannot be written as ONNX")
                .hint("export the weights `default` or `small`"),
        );
    }
    // Checks the name and shape of every tensor.
    CpuNetwork::new(network, &weights.tensors, None, Level::here())?;
    let mut layers = Layers::new(&weights.tensors);
    let image = normalised(&mut layers, weights);
    let features = extractor::extractor(&mut layers, &image, &network.extractor, network.mean)?;
    let basis = head::basis(&mut layers, &image, &features, network)?;
    let affinities = affinities::affinities(&mut layers, &image, network)?;
    layers.graph.rename(&basis, "basis");
    layers.graph.rename(&affinities, "affinities");
    let first = if network.mean {
        "The first is the depth that the image suggests, up to scale."
    } else {
        "The first is the constant 1."
    };
    let about = [
        "Red, green and blue from 0 (black) to 1 (white).".to_owned(),
        format!("Basis functions of depth. {first}"),
        "Affinities of each pixel with its right and its lower neighbour, above 0.".to_owned(),
    ];
    let [height, width] = weights.normalisation.input;
    let entries = [
        ("lsdc.version", env!("CARGO_PKG_VERSION").to_owned()),
        ("lsdc.weights", origin.to_owned()),
        ("lsdc.input_size", format!("{width}x{height}")),
        ("lsdc.image", about[0].clone()),
        ("lsdc.basis", about[1].clone()),
        ("lsdc.affinities", about[2].clone()),
    ];
    let [image, basis, affinities] = about;
    let model = Model {
        ir_version: IR_VERSION,
        producer_name: "lsdc".to_owned(),
        producer_version: env!("CARGO_PKG_VERSION").to_owned(),
        doc_string: format!(
            "An image to basis functions of depth and affinities of its pixels. The network works best on images of \
             about as many pixels as {width}x{height} has."
        ),
        graph: Some(layers.graph.finish(
            vec![map("image", 3, image)],
            vec![
                map("basis", network.bases + 1, basis),
                map("affinities", 2, affinities),
            ],
        )),
        opset_import: vec![OperatorSet {
            domain: Some(String::new()),
            version: OPSET,
        }],
        metadata_props: entries.map(|(key, value)| entry(key, value)).into(),
    };
    Ok(model.encode_to_vec())
}

fn entry(key: &str, value: String) -> Entry {
    Entry {
        key: key.to_owned(),
        value,
    }
}

/// Normalises the image. Its borders are padded with 0 afterwards, so normalisation cannot be folded into the first layer.
fn normalised(layers: &mut Layers<'_>, weights: &Weights) -> String {
    let shape = [1, 3, 1, 1];
    let graph = &mut layers.graph;
    let normalisation = &weights.normalisation;
    let mean = graph.floats("normalisation.mean".into(), &shape, &normalisation.mean);
    let name = "normalisation.deviation".into();
    let deviation = graph.floats(name, &shape, &normalisation.deviation);
    let centred = graph.apply("Sub", &["image", &mean]);
    graph.apply("Div", &[&centred, &deviation])
}

/// Returns the description of an input or output `[batch, channels, height, width]`.
fn map(name: &str, channels: usize, doc_string: String) -> ValueInfo {
    let named = |name: &str| Length::Named(name.to_owned());
    let lengths = [
        named("batch"),
        Length::Fixed(channels as i64),
        named("height"),
        named("width"),
    ];
    let dim = lengths.map(|length| Dimension {
        length: Some(length),
    });
    ValueInfo {
        name: name.to_owned(),
        kind: Some(Type {
            tensor_type: Some(TensorType {
                elem_type: element::FLOAT,
                shape: Some(Shape { dim: dim.into() }),
            }),
        }),
        doc_string,
    }
}

#[cfg(test)]
#[cfg(feature = "weights")]
mod tests;
