//! Optimisers of whole networks against burn's, which take one parameter at a time.

use super::*;
use crate::model::{BasisNet, InitNetwork as _, parameters};
use burn::grad_clipping::GradientClippingConfig;
use burn::module::ParamGroup;
use burn::optim::decay::WeightDecayConfig;
use burn::optim::momentum::MomentumConfig;
use burn::optim::{
    Adam, AdamConfig, AdjustLrFn, LearningRate, ModuleOptimizer, Muon, MuonConfig, MuonState,
    Optimizer, SgdConfig,
};
use faer::Mat;
use lsdc_core::network::{BackboneConfig, ExtractorConfig, NetworkConfig};
use lsdc_rng::Rng;

/// Muon, one matrix at a time.
#[derive(Clone)]
struct FlattenedMuon(Muon);

impl Optimizer for FlattenedMuon {
    type State<const D: usize> = MuonState<2>;

    fn step<const D: usize>(
        &self,
        rate: LearningRate,
        tensor: Tensor<D>,
        gradient: Tensor<D>,
        state: Option<Self::State<D>>,
    ) -> (Tensor<D>, Option<Self::State<D>>) {
        let shape = tensor.dims();
        let flat = [shape[0], shape[1..].iter().product()];
        let (tensor, gradient) = (tensor.reshape(flat), gradient.reshape(flat));
        let (tensor, state) = self.0.step(rate, tensor, gradient, state);
        (tensor.reshape(shape), state)
    }

    fn to_device<const D: usize>(state: Self::State<D>, device: &Device) -> Self::State<D> {
        Muon::to_device(state, device)
    }
}

/// Adam with a share of the learning rate.
#[derive(Clone)]
struct ScaledAdam(Adam, f64);

impl Optimizer for ScaledAdam {
    type State<const D: usize> = <Adam as Optimizer>::State<D>;

    fn step<const D: usize>(
        &self,
        rate: LearningRate,
        tensor: Tensor<D>,
        gradient: Tensor<D>,
        state: Option<Self::State<D>>,
    ) -> (Tensor<D>, Option<Self::State<D>>) {
        self.0.step(rate * self.1, tensor, gradient, state)
    }

    fn to_device<const D: usize>(state: Self::State<D>, device: &Device) -> Self::State<D> {
        Adam::to_device(state, device)
    }
}

/// Returns burn's optimisers with the same settings.
fn reference(config: &TrainConfig) -> ModuleOptimizer {
    let decay = WeightDecayConfig::new(config.weight_decay);
    let clip = config.clip.map(GradientClippingConfig::Norm);
    let adam = AdamConfig::new()
        .with_epsilon(1e-8)
        .with_weight_decay(Some(decay.clone()))
        .with_grad_clipping(clip.clone());
    let backbone = ScaledAdam(adam.build(), config.backbone.rate);
    let optimiser = match config.optimiser {
        OptimiserKind::Adam => adam.init(),
        OptimiserKind::Sgd => {
            let momentum = MomentumConfig::new().with_momentum(0.9).with_dampening(0.0);
            SgdConfig::new()
                .with_weight_decay(Some(decay))
                .with_momentum(Some(momentum))
                .with_gradient_clipping(clip.clone())
                .init()
        }
        OptimiserKind::Muon => {
            let muon = MuonConfig::new().with_adjust_lr_fn(AdjustLrFn::MatchRmsAdamW);
            let group = ParamGroup::from_predicate("weight");
            adam.init()
                .with_group(group, FlattenedMuon(muon.build()), None)
        }
    };
    let clip = clip.as_ref().map(GradientClippingConfig::init);
    optimiser.with_group(ParamGroup::from_predicate(BACKBONE), backbone, clip)
}

/// A network with a backbone.
fn net() -> BasisNet {
    let network = NetworkConfig {
        extractor: ExtractorConfig {
            backbone: Some(BackboneConfig {
                stages: 2,
                decoder: 16,
            }),
            ..ExtractorConfig::slimmer()
        },
        hidden: vec![24],
        bases: 12,
        affinities: 8,
        ..NetworkConfig::sharp()
    };
    network.init(0, &Device::flex().autodiff()).unwrap()
}

/// Draws gradients of all parameters, some of them large.
struct Draw(Rng, GradientsParams);

impl ModuleVisitor for Draw {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        // Running statistics have no gradients, and clones of a network share them.
        if !param.val().is_require_grad() {
            return;
        }
        let value = param.val().inner();
        let scale = if self.0.below(2) == 0 { 3.0 } else { 1e-3 };
        let values = (0..value.shape().num_elements()).map(|_| self.0.normal() * scale);
        let data = TensorData::new(values.collect::<Vec<f32>>(), value.shape());
        self.1
            .register(param.id, Tensor::<D>::from_data(data, &value.device()));
    }
}

fn gradients(net: &BasisNet, number: u64) -> GradientsParams {
    let mut draw = Draw(Rng::stream(number, &["gradients"]), GradientsParams::new());
    net.visit(&mut draw);
    draw.1
}

fn config(optimiser: OptimiserKind) -> TrainConfig {
    TrainConfig {
        optimiser,
        weight_decay: 0.01,
        clip: Some(1.0),
        ..TrainConfig::default()
    }
}

const KINDS: [OptimiserKind; 3] = [OptimiserKind::Adam, OptimiserKind::Sgd, OptimiserKind::Muon];

#[test]
fn steps_are_those_of_single_parameters() {
    for kind in KINDS {
        let config = config(kind);
        let (mut all, mut each) = (Optimiser::new(&config), reference(&config));
        let start = net();
        let (mut found, mut expected) = (start.clone(), start.clone());
        for number in 0..3 {
            found = all.step(0.01, found, gradients(&start, number));
            expected = each.step(0.01, expected, gradients(&start, number));
        }
        let tables = [&found, &expected, &start].map(parameters::tables);
        let [found, expected, start] = tables;
        assert!(found.len() > 100);
        for (name, expected) in &expected {
            // Relative to the change of the largest value.
            let change = |a: &Table, b: &Table| {
                let pairs = a.values().iter().zip(b.values());
                pairs.fold(0.0_f32, |most, (a, b)| most.max((a - b).abs()))
            };
            let off = change(&found[name], expected);
            let moved = change(expected, &start[name]);
            assert!(off <= 2e-4 * moved, "{kind:?} {name}: {off} of {moved}");
            assert!(moved > 0.0 || name.contains("running"), "{name}");
        }
    }
}

#[test]
fn a_restored_state_gives_the_same_bits() {
    for kind in KINDS {
        let config = config(kind);
        let mut optimiser = Optimiser::new(&config);
        let start = net();
        let between = optimiser.step(0.01, start.clone(), gradients(&start, 0));
        let mut restored = Optimiser::new(&config);
        let shapes = parameters::shapes(&start);
        restored.restore(optimiser.tables(), &shapes).unwrap();
        // Nothing is lost if it is stored again at once.
        assert!(restored.tables() == optimiser.tables());
        let next = |optimiser: &mut Optimiser| {
            let net = optimiser.step(0.01, between.clone(), gradients(&start, 1));
            (parameters::tables(&net), optimiser.tables())
        };
        let (found, expected) = (next(&mut restored), next(&mut optimiser));
        for (found, expected) in [(found.0, expected.0), (found.1, expected.1)] {
            assert_eq!(found.len(), expected.len());
            for (name, expected) in &expected {
                assert!(found[name] == *expected, "{kind:?} {name}");
            }
        }
    }
}

#[test]
fn a_state_of_another_network_is_refused() {
    let start = net();
    let mut optimiser = Optimiser::new(&config(OptimiserKind::Adam));
    optimiser.step(0.01, start.clone(), gradients(&start, 0));
    let tables = optimiser.tables();
    let shapes = parameters::shapes(&start);
    let name = tables.keys().find(|name| name.ends_with("/first")).unwrap();
    let path = name.strip_suffix("/first").unwrap();
    let mut missing = shapes.clone();
    missing.remove(path);
    let mut larger = shapes.clone();
    larger.insert(path.to_owned(), vec![1000]);
    for other in [missing, larger] {
        let refused = optimiser.restore(tables.clone(), &other);
        assert_eq!(refused, Err(name.clone()));
    }
    let mut muon = Optimiser::new(&config(OptimiserKind::Muon));
    assert!(muon.restore(tables, &shapes).is_err());
}

/// Removes the gradients of the affinity network, and collects their paths.
struct Leave<'a>(&'a mut GradientsParams, Vec<String>, Vec<String>);
impl ModuleVisitor for Leave<'_> {
    fn enter_module(&mut self, name: &str, _: &str) {
        self.1.push(name.to_owned());
    }

    fn exit_module(&mut self, _: &str, _: &str) {
        self.1.pop();
    }

    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        if self.1[0] == "edges" && self.0.remove::<D>(param.id).is_some() {
            self.2.push(self.1.join("."));
        }
    }
}

#[test]
fn parameters_without_a_gradient_stay() {
    let start = net();
    let mut optimiser = Optimiser::new(&config(OptimiserKind::Adam));
    let mut some = gradients(&start, 0);
    let all = gradients(&start, 0);
    let mut leave = Leave(&mut some, Vec::new(), Vec::new());
    start.visit(&mut leave);
    let left = leave.2;
    assert!(left.len() > 3);
    let before = parameters::tables(&start);
    let between = optimiser.step(0.01, start.clone(), some);
    let after = parameters::tables(&between);
    for name in &left {
        assert!(after[name] == before[name], "{name}");
    }
    // They join later, and the others go on.
    let last = parameters::tables(&optimiser.step(0.01, between, all));
    for name in &left {
        assert!(last[name] != before[name], "{name}");
    }
    let state = optimiser.tables();
    assert!(state.keys().any(|name| name.starts_with(&left[0])));
}

#[test]
fn steps_of_muon_go_along_the_nearest_orthogonal_matrix() {
    // Wide, tall, and two of one shape.
    let shapes = [vec![6, 2, 3, 3], vec![6, 2, 3, 3], vec![20, 7]];
    let layout = Rule::Muon.layout(&shapes);
    let mut rng = Rng::stream(2, &[]);
    let values: Vec<f32> = (0..layout.size()).map(|_| rng.normal()).collect();
    let device = Device::flex();
    let gradient = vector(values.clone(), &device);
    let mut moments = [gradient.zeros_like()];
    let steps = muon::step(&mut moments, gradient, &layout, &shapes, 0.01);
    let steps: Vec<f32> = steps.into_data().iter().collect();
    for (shape, &(start, _)) in shapes.iter().zip(layout.places()) {
        let [rows, columns] = muon::matrix(shape);
        // Liu et al. 2025, equation 4: 0.2 sqrt(max(rows, columns)) times the rate.
        let length = 0.01 * 0.2 * f64::from(rows.max(columns) as u32).sqrt();
        let of = |values: &[f32], scale: f64| {
            Mat::from_fn(rows, columns, |r, c| {
                f64::from(values[start + r * columns + c]) / scale
            })
        };
        let svd = of(&values, 1.0).thin_svd().unwrap();
        let along = svd.U().transpose() * of(&steps, length) * svd.V();
        // Five iterations map singular values to between 0.68 and 1.13 (Jordan et al. 2024).
        for r in 0..rows.min(columns) {
            for c in 0..rows.min(columns) {
                let value = along[(r, c)];
                if r == c {
                    assert!((0.65..1.2).contains(&value), "{value}");
                } else {
                    assert!(value.abs() < 1e-3, "{value}");
                }
            }
        }
    }
}
