use super::*;
use crate::{KNOWN, named};
use std::collections::BTreeSet;

fn exported(name: &str) -> (Weights, Model) {
    let weights = named(name).unwrap().read().unwrap();
    let bytes = to_onnx(&weights, "these").unwrap();
    (weights, Model::decode(&bytes[..]).unwrap())
}

#[test]
fn every_value_is_made_once_and_before_it_is_read() {
    for name in ["default", "small"] {
        let (_, model) = exported(name);
        let graph = model.graph.unwrap();
        let constants = graph.initializer.iter().map(|constant| &constant.name);
        let inputs = graph.input.iter().map(|input| &input.name);
        let mut known = BTreeSet::from([""]);
        for name in constants.chain(inputs) {
            assert!(known.insert(name), "{name}");
        }
        for node in &graph.node {
            let mut inputs = node.input.iter();
            assert!(inputs.all(|x| known.contains(x.as_str())), "{node:?}");
            for output in &node.output {
                assert!(known.insert(output), "{output}");
            }
        }
        let mut outputs = graph.output.iter().map(|output| output.name.as_str());
        assert!(outputs.all(|output| known.contains(output)));
    }
}

#[test]
fn height_and_width_are_chosen_when_the_graph_runs() {
    let (weights, model) = exported("default");
    let graph = model.graph.unwrap();
    let shapes = graph.input.iter().chain(&graph.output).map(|value| {
        let kind = value.kind.clone().unwrap().tensor_type.unwrap();
        assert_eq!(kind.elem_type, element::FLOAT);
        let lengths = kind
            .shape
            .unwrap()
            .dim
            .into_iter()
            .map(|dim| match dim.length {
                Some(Length::Fixed(length)) => length.to_string(),
                Some(Length::Named(name)) => name,
                None => String::new(),
            });
        (value.name.clone(), lengths.collect::<Vec<_>>().join(" "))
    });
    let expected = [
        ("image".to_owned(), "batch 3 height width".to_owned()),
        (
            "basis".to_owned(),
            format!("batch {} height width", weights.network.bases + 1),
        ),
        ("affinities".to_owned(), "batch 2 height width".to_owned()),
    ];
    assert_eq!(shapes.collect::<Vec<_>>(), expected);
    assert_eq!(model.opset_import[0].version, OPSET);
    let value = |key: &str| {
        let mut entries = model.metadata_props.iter();
        entries
            .find(|entry| entry.key == key)
            .unwrap()
            .value
            .clone()
    };
    assert_eq!(value("lsdc.input_size"), "304x228");
    assert_eq!(value("lsdc.weights"), "these");
}

#[test]
fn every_convolution_of_the_weights_is_in_the_graph() {
    let (weights, model) = exported("default");
    let graph = model.graph.unwrap();
    let convolutions = graph.node.iter().filter(|node| node.op_type == "Conv");
    let layers = weights.tensors.iter().filter(|(name, tensor)| {
        name.ends_with(".weight") && matches!(tensor.shape().len(), 2 | 4)
    });
    assert_eq!(convolutions.count(), layers.count());
    for constant in &graph.initializer {
        let count: i64 = constant.dims.iter().product();
        let bytes = if constant.data_type == element::FLOAT {
            4
        } else {
            8
        };
        assert_eq!(
            count as usize * bytes,
            constant.raw_data.len(),
            "{}",
            constant.name
        );
    }
}

#[test]
fn networks_on_an_encoder_are_rejected() {
    let weights = named(KNOWN[0].weights).unwrap().read().unwrap();
    let error = to_onnx(&weights, "these").unwrap_err();
    assert!(error.to_string().contains("pretrained encoder"), "{error}");
    assert!(error.advice().is_some());
}

#[test]
fn damaged_weights_are_rejected() {
    let mut weights = named("small").unwrap().read().unwrap();
    weights.tensors.remove("edges.last.weight").unwrap();
    let error = to_onnx(&weights, "these").unwrap_err();
    assert!(
        error.to_string().contains("`edges.last.weight` is missing"),
        "{error}"
    );
}
