//! The systems against `PyTorch` and torchvision: `scripts/golden_systems.py` generates the file, `scripts/peers/systems.py`
//! reimplements the publications.

use super::{System as _, SystemConfig, SystemInput, SystemNet, initial_net};
use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::optim::GradientsParams;
use burn::tensor::{DType, Device, Tensor, TensorData};
use lsdc_core::weights::Tensor as Table;
use lsdc_train::model::parameter_count;
use lsdc_train::model::parameters::{NamedTensor, named};
use lsdc_train::model::weights::fill;
use lsdc_weights::read_tensors;
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
    /// Index of the method of filling tensors.
    way: usize,
    /// Name, shape, scale, offset of each tensor.
    tensors: Vec<(String, Vec<usize>, f64, f64)>,
    evaluated: Vec<f32>,
    trained: Vec<f32>,
    before: Option<Vec<f32>>,
    /// Name, norm, and product with a direction of each gradient.
    gradients: Vec<(String, f64, f64)>,
}

fn golden() -> Golden {
    let path = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../tests/golden/systems.json"
    );
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
    fn seen(&self, device: &Device) -> SystemInput {
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
        SystemInput {
            images: Tensor::from_data(images, device),
            sparse: Tensor::from_data(TensorData::new(sparse, shape), device),
        }
    }

    /// Returns every `step`-th depth.
    fn some(&self, depth: &Tensor<3>) -> Vec<f32> {
        let values: Vec<f32> = depth.clone().into_data().iter().collect();
        values.into_iter().step_by(self.step).collect()
    }
}

impl Case {
    fn net(&self, device: &Device) -> SystemNet {
        let tensors = self.tensors.iter().enumerate();
        let tensors = tensors.map(|(index, (name, shape, scale, offset))| {
            let values = chirp(index + 1000 * self.way, shape.iter().product());
            let values: Vec<f64> = values.iter().map(|v| offset + scale * v).collect();
            let table = Table::new(shape.clone(), floats(&values)).unwrap();
            (name.clone(), table)
        });
        fill(tensors.collect(), self.config.blank(device).unwrap()).unwrap()
    }
}

/// Collects the gradients of a network by the names of its tensors.
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

/// Converts all values of a module to double precision.
struct Double;

impl ModuleMapper for Double {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let learned = param.is_require_grad();
        let doubled = param.map(|tensor| {
            let device = tensor.device();
            let data = tensor.into_data().convert_dtype(DType::F64);
            Tensor::from_data(data, (&device, DType::F64))
        });
        doubled.set_require_grad(learned)
    }
}

/// The output of a network in training, and its gradients.
struct Trained {
    depth: Vec<f32>,
    before: Option<Vec<f32>>,
    gradients: BTreeMap<String, Vec<f64>>,
}

impl Trained {
    fn new(golden: &Golden, net: &SystemNet, input: &SystemInput) -> Self {
        let output = net.predict(input);
        let along = |depth: &Tensor<3>| {
            let shape = depth.dims();
            let values = TensorData::new(chirp(11, shape.iter().product()), shape);
            let kind = (&depth.device(), depth.dtype());
            (depth.clone() * Tensor::<3>::from_data(values, kind)).sum()
        };
        let before = output.unrefined.iter().map(along);
        let loss = before.fold(along(&output.depth), |sum, more| sum + more);
        let gradients = GradientsParams::from_grads(loss.backward(), net);
        let mut read = Read {
            gradients: &gradients,
            path: Vec::new(),
            found: BTreeMap::new(),
        };
        net.visit(&mut read);
        Self {
            depth: golden.some(&output.depth),
            before: output.unrefined.map(|before| golden.some(&before)),
            gradients: read.found,
        }
    }

    /// Compares depths within a relative tolerance.
    fn depths_agree(&self, case: &Case, share: f32) {
        let name = format!("{:?}", case.config);
        agree(&self.depth, &case.trained, share, &name);
        assert_eq!(self.before.is_some(), case.before.is_some());
        for (before, expected) in self.before.iter().zip(&case.before) {
            agree(before, expected, share, &name);
        }
    }

    /// Compares gradients within a tolerance relative to their norms, or to the largest norm: biases before a normalisation
    /// have no effect, and their gradients are rounding errors.
    fn gradients_agree(&self, case: &Case, share: f64, of_largest: f64) {
        assert_eq!(self.gradients.len(), case.gradients.len());
        let largest = case.gradients.iter().map(|g| g.1).fold(0.0, f64::max);
        for (name, size, along) in &case.gradients {
            let found = &self.gradients[name];
            let place = case.tensors.iter().position(|t| t.0 == *name).unwrap();
            let product = found.iter().zip(chirp(1000 + place, found.len()));
            let product: f64 = product.map(|(a, b)| a * b).sum();
            let length = found.iter().map(|v| v * v).sum::<f64>().sqrt();
            let most = share * size + of_largest * largest;
            assert!(
                (length - size).abs() < most && (product - along).abs() < 3.0 * most,
                "{:?}, {name}: {length} {size}, {product} {along}",
                case.config
            );
        }
    }
}

fn agree(ours: &[f32], theirs: &[f32], share: f32, what: &str) {
    assert_eq!(ours.len(), theirs.len(), "{what}");
    let size = |values: &mut dyn Iterator<Item = f32>| values.map(|v| v * v).sum::<f32>().sqrt();
    let apart = size(&mut ours.iter().zip(theirs).map(|(a, b)| a - b));
    let length = size(&mut theirs.iter().copied());
    assert!(apart < share * length, "{what}: {apart} of {length}");
}

#[test]
fn depths_and_gradients_are_those_of_pytorch() {
    let golden = golden();
    assert_eq!(golden.cases.len(), 5);
    for case in &golden.cases {
        let name = format!("{:?}", case.config);
        let device = Device::flex();
        let output = case.net(&device).predict(&golden.seen(&device));
        agree(&golden.some(&output.depth), &case.evaluated, 1e-4, &name);

        // First the fast kernels, then double precision.
        let device = device.autodiff();
        let (net, input) = (case.net(&device), golden.seen(&device));
        let single = Trained::new(&golden, &net, &input);
        single.depths_agree(case, 1e-4);
        single.gradients_agree(case, 1e-3, 1e-5);
        let input = SystemInput {
            images: input.images.cast(DType::F64),
            sparse: input.sparse.cast(DType::F64),
        };
        let double = Trained::new(&golden, &net.map(&mut Double), &input);
        double.depths_agree(case, 1e-6);
        double.gradients_agree(case, 1e-5, 1e-9);
    }
}

/// A tiny encoder saved by `PyTorch`.
const ENCODER: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../../tests/golden/resnet18.pth"
);

fn named_values(net: &SystemNet) -> BTreeMap<String, Vec<f32>> {
    let values = |tensor: NamedTensor| (tensor.name, tensor.data.iter::<f32>().collect());
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
        let random = initial_net(&config(method, "resnet18", ""), 3, &device).unwrap();
        let started = initial_net(&config(method, "resnet18", &file), 3, &device).unwrap();
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
        // The first layer also reads depth: it is random, and in sparse-to-dense so is its normalisation.
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
    // The first tensor, as filled by the script.
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

    let error = initial_net(&config("s2d", "resnet50", &file), 3, &device).unwrap_err();
    let text = error.with_causes();
    assert!(text.contains("layer1.0"), "{text}");
    let missing = config("s2d", "resnet18", r#", "pretrained": "nowhere.pth""#);
    assert!(initial_net(&missing, 3, &device).is_err());
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
    // Fang et al., table 5. The number of learned steering kernels excludes the network of the kernels.
    assert_eq!(published("s2d"), 63_566_144);
    assert_eq!(published("cspn"), 256_078_272);
    assert_eq!(published("lsk"), 13_421_970 + 3_065_475);
}

/// With a momentum of a tenth, the running mean of a constant is a tenth of it after a step, 0.19 after two.
#[test]
fn running_statistics_follow_by_the_momentum_of_pytorch() {
    let golden = golden();
    let device = Device::flex().autodiff();
    let input = golden.seen(&device);
    for case in &golden.cases {
        let net = case.config.init(0, &device).unwrap();
        let means = |net: &SystemNet| -> Vec<f32> {
            net.predict(&input);
            let values = named_values(net).into_iter();
            let means = values.filter(|(name, _)| name.ends_with("running_mean"));
            means.flat_map(|(_, values)| values).collect()
        };
        let (once, twice) = (means(&net), means(&net));
        assert!(!once.is_empty());
        let expected: Vec<f32> = once.iter().map(|mean| 1.9 * mean).collect();
        agree(&twice, &expected, 1e-5, &format!("{:?}", case.config));
    }
}
