//! The systems beside `PyTorch` and torchvision: `scripts/golden_systems.py` makes the file, `scripts/peers/systems.py`
//! restates the publications.

use super::{Net, Seen, System as _, SystemConfig, begin};
use crate::model::parameter_count;
use crate::model::weights::{Filler, Named, named};
use crate::pretrained::read_tensors;
use burn::module::{Module, ModuleVisitor, Param};
use burn::optim::GradientsParams;
use burn::tensor::{Device, Tensor, TensorData};
use lsdc_core::weights::Tensor as Table;
use serde::Deserialize;
use std::collections::BTreeMap;

#[derive(Deserialize)]
struct Golden {
    images: usize,
    height: usize,
    width: usize,
    step: usize,
    cases: Vec<Case>,
    counts: Vec<(SystemConfig, usize, usize)>,
}

#[derive(Deserialize)]
struct Case {
    config: SystemConfig,
    /// Which of the ways of filling tensors.
    way: usize,
    /// Name, shape, scale, offset.
    tensors: Vec<(String, Vec<usize>, f64, f64)>,
    evaluated: Vec<f32>,
    trained: Vec<f32>,
    before: Option<Vec<f32>>,
    /// Name, length, and product with a direction.
    gradients: Vec<(String, f64, f64)>,
}

fn golden() -> Golden {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden/systems.json");
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

fn chirp(index: usize, count: usize) -> Vec<f64> {
    let at = |i: usize| {
        let i = i as f64;
        (0.013 * i * i + 0.37 * i + index as f64).sin()
    };
    (0..count).map(at).collect()
}

fn floats(values: &[f64]) -> Vec<f32> {
    values.iter().map(|v| *v as f32).collect()
}

impl Golden {
    fn seen(&self, device: &Device) -> Seen {
        let shape = [self.images, self.height, self.width];
        let pixels = self.height * self.width;
        let images = floats(&chirp(7, self.images * pixels * 3));
        let mut sparse = vec![0.0_f32; self.images * pixels];
        for image in 0..self.images {
            for point in 0..40 - 5 * image {
                let place = (point * 131 + image * 57) % pixels;
                sparse[image * pixels + place] = (2.0 + 0.05 * (point % 17) as f64) as f32;
            }
        }
        let images = TensorData::new(images, [shape[0], shape[1], shape[2], 3]);
        Seen {
            images: Tensor::from_data(images, device),
            sparse: Tensor::from_data(TensorData::new(sparse, shape), device),
        }
    }

    /// Every so many depths.
    fn some(&self, depth: &Tensor<3>) -> Vec<f32> {
        let values: Vec<f32> = depth.clone().into_data().iter().collect();
        values.into_iter().step_by(self.step).collect()
    }
}

impl Case {
    fn net(&self, device: &Device) -> Net {
        let tensors = self.tensors.iter().enumerate();
        let tensors = tensors.map(|(index, (name, shape, scale, offset))| {
            let values = chirp(index + 1000 * self.way, shape.iter().product());
            let values: Vec<f64> = values.iter().map(|v| offset + scale * v).collect();
            let table = Table::new(shape.clone(), floats(&values)).unwrap();
            (name.clone(), table)
        });
        let mut filler = Filler::new(tensors.collect());
        let net = self.config.blank(device).unwrap().map(&mut filler);
        filler.check().unwrap();
        net
    }
}

/// The gradients of a network by the names of its tensors.
struct Read<'a> {
    gradients: &'a GradientsParams,
    path: Vec<String>,
    found: BTreeMap<String, Vec<f64>>,
}

impl ModuleVisitor for Read<'_> {
    fn enter_module(&mut self, name: &str, _: &str) {
        self.path.push(name.to_owned());
    }

    fn exit_module(&mut self, _: &str, _: &str) {
        self.path.pop();
    }

    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        if let Some(gradient) = self.gradients.get::<D>(param.id) {
            let values = gradient.into_data().iter::<f64>().collect();
            self.found.insert(self.path.join("."), values);
        }
    }
}

fn agree(ours: &[f32], theirs: &[f32], what: &str) {
    assert_eq!(ours.len(), theirs.len(), "{what}");
    let size = |values: &mut dyn Iterator<Item = f32>| values.map(|v| v * v).sum::<f32>().sqrt();
    let apart = size(&mut ours.iter().zip(theirs).map(|(a, b)| a - b));
    let length = size(&mut theirs.iter().copied());
    assert!(apart < 1e-4 * length, "{what}: {apart} of {length}");
    for (a, b) in ours.iter().zip(theirs) {
        assert!((a - b).abs() < 1e-3 * (1.0 + b.abs()), "{what}: {a} {b}");
    }
}

#[test]
fn depths_and_gradients_are_those_of_pytorch() {
    let golden = golden();
    assert_eq!(golden.cases.len(), 5);
    let mut wrong = Vec::new();
    for case in &golden.cases {
        let name = format!("{:?}", case.config);
        let device = Device::flex();
        let said = case.net(&device).say(&golden.seen(&device));
        agree(&golden.some(&said.depth), &case.evaluated, &name);

        let device = device.autodiff();
        let net = case.net(&device);
        let said = net.say(&golden.seen(&device));
        agree(&golden.some(&said.depth), &case.trained, &name);
        let direction = |depth: &Tensor<3>| {
            let shape = depth.dims();
            let values = floats(&chirp(11, shape.iter().product()));
            Tensor::<3>::from_data(TensorData::new(values, shape), &device)
        };
        let mut loss = (said.depth.clone() * direction(&said.depth)).sum();
        assert_eq!(said.before.is_some(), case.before.is_some());
        if let (Some(before), Some(expected)) = (said.before, &case.before) {
            agree(&golden.some(&before), expected, &name);
            loss = loss + (before.clone() * direction(&before)).sum();
        }
        let gradients = GradientsParams::from_grads(loss.backward(), &net);
        let mut read = Read {
            gradients: &gradients,
            path: Vec::new(),
            found: BTreeMap::new(),
        };
        net.visit(&mut read);
        assert_eq!(read.found.len(), case.gradients.len(), "{name}");
        // Biases before a normalisation change nothing: their gradients are what rounding leaves.
        let largest = case.gradients.iter().map(|g| g.1).fold(0.0, f64::max);
        for (tensor, length, along) in &case.gradients {
            let found = &read.found[tensor];
            let names = case.tensors.iter().position(|t| t.0 == *tensor).unwrap();
            let product = found.iter().zip(chirp(1000 + names, found.len()));
            let product: f64 = product.map(|(a, b)| a * b).sum();
            let size = found.iter().map(|v| v * v).sum::<f64>().sqrt();
            let most = 1e-3 * length + 1e-6 * largest;
            if (size - length).abs() > most || (product - along).abs() > most * 3.0 {
                wrong.push(format!(
                    "{name}, {tensor}: {size} {length}, {product} {along}"
                ));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// A tiny encoder that `PyTorch` saved.
const ENCODER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden/resnet18.pth");

fn named_values(net: &Net) -> BTreeMap<String, Vec<f32>> {
    let values = |tensor: Named| (tensor.name, tensor.data.iter::<f32>().collect());
    named(net).into_iter().map(values).collect()
}

#[test]
fn encoders_start_from_files_of_torchvision() {
    let device = Device::flex();
    let config = |method: &str, encoder: &str, file: &str| -> SystemConfig {
        serde_json::from_str(&format!(
            r#"{{ "method": "{method}", "encoder": "{encoder}", "width": 2{file} }}"#
        ))
        .unwrap()
    };
    let file = format!(r#", "pretrained": "{ENCODER}""#);
    for (method, prefix) in [("s2d", "S2d.resnet."), ("cspn", "Cspn.resnet.")] {
        let random = begin(&config(method, "resnet18", ""), 3, &device).unwrap();
        let started = begin(&config(method, "resnet18", &file), 3, &device).unwrap();
        let (random, started) = (named_values(&random), named_values(&started));
        let place = |theirs: &str| {
            let names = read_tensors(ENCODER.as_ref()).unwrap();
            assert!(names.contains_key(theirs), "{theirs}");
            names[theirs].values().to_vec()
        };
        for (ours, theirs) in [
            ("layer1.1.convs.0.conv.weight", "layer1.1.conv1.weight"),
            (
                "layer2.0.shortcut.norm.Batch.gain",
                "layer2.0.downsample.1.weight",
            ),
            (
                "layer4.1.convs.1.norm.Batch.running_mean",
                "layer4.1.bn2.running_mean",
            ),
        ] {
            let ours = format!("{prefix}{ours}");
            assert_eq!(started[&ours], place(theirs), "{ours}");
            assert_ne!(started[&ours], random[&ours], "{ours}");
        }
        // The first layer sees a depth: it is random, and in sparse-to-dense so is what follows it.
        let stem = format!("{prefix}stem.conv.weight");
        assert_eq!(started[&stem], random[&stem]);
        let gain = format!("{prefix}stem.norm.Batch.gain");
        assert_eq!(started[&gain] == random[&gain], method == "s2d");
        for (name, values) in &started {
            if !name.contains("resnet") {
                assert_eq!(values, &random[name], "{name}");
            }
        }
    }
    // The first name, as the script fills it.
    let tensors = read_tensors(ENCODER.as_ref()).unwrap();
    let name = "bn1.bias";
    let found = tensors[name].values();
    let expected = chirp(0, 2);
    assert!(
        found
            .iter()
            .zip(expected)
            .all(|(a, b)| (f64::from(*a) - b).abs() < 1e-3)
    );

    let error = begin(&config("s2d", "resnet50", &file), 3, &device).unwrap_err();
    let text = error.with_causes();
    assert!(text.contains("layer1.0"), "{text}");
    let missing = config("s2d", "resnet18", r#", "pretrained": "nowhere.pth""#);
    assert!(begin(&missing, 3, &device).is_err());
}

#[test]
fn parameters_are_as_many_as_published() {
    let golden = golden();
    let count = |config: &SystemConfig| {
        let net = config.blank(&Device::flex()).unwrap();
        (parameter_count(&net), config.never_run())
    };
    for (config, own, never_run) in &golden.counts {
        assert!(config.at_least() < *own && config.at_least() > own / 32);
        assert_eq!(count(config), (*own, *never_run), "{config:?}");
    }
    let published = |name: &str| {
        let text = format!("{{\"method\":\"{name}\"}}");
        let config = serde_json::from_str(&text).unwrap();
        let (own, never_run) = count(&config);
        own + never_run
    };
    // Fang et al., table 5. That of learned steering kernels is without the network of the kernels.
    assert_eq!(published("s2d"), 63_566_144);
    assert_eq!(published("cspn"), 256_078_272);
    assert_eq!(published("lsk"), 13_421_970 + 3_065_475);
}
