//! Optimisers of whole networks. All parameters with one rule are parts of one vector, so that on a GPU a step takes as many
//! launches for a hundred tensors as for one.

mod muon;
mod rules;
#[cfg(test)]
mod tests;

use super::TrainConfig;
use super::config::OptimiserKind;
use crate::ops::pack::{ALIGNMENT, Layout};
use crate::ops::weighted_sum::weighted_sum;
use crate::traffic::count_readback;
use burn::module::{Module, ModuleMapper, ModuleVisitor, Param, ParamId};
use burn::optim::GradientsParams;
use burn::tensor::{Device, Int, Tensor, TensorData};
use lsdc_core::weights::Tensor as Table;
use rules::{Rule, clipped};
use std::collections::BTreeMap;

/// The path of the stages of a pretrained network, which have a share of the learning rate.
const BACKBONE: &str = "extractor.backbone.";
/// Part of the paths of the weights in all layers.
const WEIGHT: &str = "weight";

/// The optimiser of a network with the state of every parameter.
pub(super) struct Optimiser {
    /// The later of two groups that accept a parameter has it.
    groups: Vec<Group>,
}

impl Optimiser {
    /// Creates the optimiser of the settings.
    pub(super) fn new(config: &TrainConfig) -> Self {
        let group = |name, rule, path| Group {
            name,
            path,
            rule,
            decay: config.weight_decay.into(),
            clip: config.clip,
            share: 1.0,
            steps: 0,
            members: Members::default(),
            moments: Vec::new(),
            stored: BTreeMap::new(),
        };
        let mut groups = match config.optimiser {
            OptimiserKind::Adam => vec![group("adam", Rule::Adam, "")],
            OptimiserKind::Sgd => vec![group("sgd", Rule::Sgd, "")],
            OptimiserKind::Muon => vec![
                group("adam", Rule::Adam, ""),
                Group {
                    decay: 0.0,
                    clip: None,
                    ..group("muon", Rule::Muon, WEIGHT)
                },
            ],
        };
        groups.push(Group {
            share: config.backbone.rate,
            ..group("backbone", Rule::Adam, BACKBONE)
        });
        Self { groups }
    }

    /// Takes a step with a learning rate. Parameters without a gradient stay as they are, unless they had one before: then it
    /// counts as 0. All parameters of a group have its number of steps.
    pub(super) fn step<M: Module>(&mut self, rate: f64, net: M, gradients: GradientsParams) -> M {
        let mut gathered = Gather {
            groups: &self.groups,
            path: Vec::new(),
            gradients,
            found: self.groups.iter().map(|_| Vec::new()).collect(),
        };
        net.visit(&mut gathered);
        let found = gathered.found;
        let groups = self.groups.iter_mut().zip(found);
        let values = groups.flat_map(|(group, found)| group.step(rate, found));
        let mut deliver = Deliver(values.collect());
        net.map(&mut deliver)
    }

    /// Returns the state as named tensors.
    pub(super) fn tables(&self) -> BTreeMap<String, Table> {
        let mut all = BTreeMap::new();
        for group in &self.groups {
            all.extend(group.tables());
            let steps = Table::new(vec![1], vec![group.steps as f32]);
            all.extend(steps.map(|steps| (format!("{STEPS}{}", group.name), steps)));
        }
        all
    }

    /// Replaces the state by one that [`tables`](Self::tables) returned for a network with parameters of these shapes.
    ///
    /// # Errors
    /// The name of a tensor that is not part of the state.
    pub(super) fn restore(
        &mut self,
        tables: BTreeMap<String, Table>,
        shapes: &BTreeMap<String, Vec<usize>>,
    ) -> Result<(), String> {
        for group in &mut self.groups {
            group.members = Members::default();
            group.stored.clear();
            group.steps = 0;
        }
        for (name, table) in tables {
            if let Some(group) = name.strip_prefix(STEPS) {
                let group = self.groups.iter_mut().find(|g| g.name == group);
                let (Some(group), Some(steps)) = (group, table.values().first()) else {
                    return Err(name);
                };
                group.steps = *steps as usize;
                continue;
            }
            let place = name.rsplit_once('/').and_then(|(path, moment)| {
                let group = group_of(&self.groups, path)?;
                let known = self.groups[group].rule.moments().contains(&moment);
                let fits = shapes.get(path).is_some_and(|shape| shape == table.shape());
                (known && fits).then_some(group)
            });
            let Some(group) = place else { return Err(name) };
            self.groups[group].stored.insert(name, table);
        }
        Ok(())
    }
}

/// Begins the names of the numbers of steps.
const STEPS: &str = "steps/";

/// Returns the group that has a parameter.
fn group_of(groups: &[Group], path: &str) -> Option<usize> {
    groups.iter().rposition(|group| path.contains(group.path))
}

/// A parameter with its gradient, both as vectors, not on an autodiff device.
struct Found {
    id: ParamId,
    path: String,
    shape: Vec<usize>,
    value: Tensor<1>,
    gradient: Option<Tensor<1>>,
}

/// Parameters with a common rule.
struct Group {
    name: &'static str,
    /// Part of the paths of all parameters.
    path: &'static str,
    rule: Rule,
    /// L2 penalty added to the gradient.
    decay: f64,
    /// Largest norm of the gradient of each parameter.
    clip: Option<f32>,
    /// Factor on the learning rate.
    share: f64,
    /// Number of steps so far.
    steps: usize,
    members: Members,
    /// Vectors of the state, as [`Rule::moments`] names them.
    moments: Vec<Tensor<1>>,
    /// The state of parameters that are not members yet, by path and moment.
    stored: BTreeMap<String, Table>,
}

/// The parameters of a group that ever had a gradient, as parts of a vector.
#[derive(Default)]
struct Members {
    paths: Vec<String>,
    shapes: Vec<Vec<usize>>,
    layout: Layout,
    /// The part of each row of [`ALIGNMENT`] values; for groups with a clipped gradient.
    rows: Option<Tensor<1, Int>>,
}

impl Group {
    /// Returns the values after a step.
    fn step(&mut self, rate: f64, mut found: Vec<Found>) -> Vec<(ParamId, Tensor<1>)> {
        let members = &self.members.paths;
        found.retain(|f| f.gradient.is_some() || members.contains(&f.path));
        if found.iter().all(|found| found.gradient.is_none()) {
            return Vec::new();
        }
        self.rule.order(&mut found, |found| &found.shape);
        if !found.iter().map(|f| &f.path).eq(&self.members.paths) {
            self.arrange(&found);
        }
        let Members { layout, rows, .. } = &self.members;
        let values: Vec<_> = found.iter().map(|found| found.value.clone()).collect();
        let gradients = found.iter_mut().map(|found| {
            let gradient = found.gradient.take();
            gradient.unwrap_or_else(|| found.value.zeros_like())
        });
        let mut gradient = layout.pack(&gradients.collect::<Vec<_>>());
        let values = layout.pack(&values);
        if let (Some(limit), Some(rows)) = (self.clip, rows) {
            gradient = clipped(gradient, rows, found.len(), limit);
        }
        if self.decay > 0.0 {
            gradient = weighted_sum(values.clone(), self.decay, gradient, 1.0);
        }
        self.steps += 1;
        let shapes = &self.members.shapes;
        let rate = rate * self.share;
        let step = match self.rule {
            Rule::Adam => rules::adam(&mut self.moments, gradient, self.steps, rate),
            Rule::Sgd => rules::sgd(&mut self.moments, gradient, rate),
            Rule::Muon => muon::step(&mut self.moments, gradient, layout, shapes, rate),
        };
        let values = values - step;
        let ids = found.iter().enumerate();
        ids.map(|(i, found)| (found.id, layout.part(&values, i)))
            .collect()
    }

    /// Makes these parameters the members, with the state that they have.
    fn arrange(&mut self, found: &[Found]) {
        self.stored = self.tables();
        let paths: Vec<String> = found.iter().map(|found| found.path.clone()).collect();
        let shapes: Vec<Vec<usize>> = found.iter().map(|found| found.shape.clone()).collect();
        let layout = self.rule.layout(&shapes);
        let device = found[0].value.device();
        let moments = self.rule.moments().iter();
        self.moments = moments
            .map(|moment| {
                let mut values = vec![0.0; layout.size()];
                for (path, &(start, length)) in paths.iter().zip(layout.places()) {
                    if let Some(table) = self.stored.remove(&format!("{path}/{moment}")) {
                        values[start..start + length].copy_from_slice(table.values());
                    }
                }
                vector(values, &device)
            })
            .collect();
        let rows = self.clip.map(|_| {
            let parts = layout.places().iter().enumerate();
            let rows = parts.flat_map(|(i, (_, length))| {
                std::iter::repeat_n(i as i32, length.div_ceil(ALIGNMENT))
            });
            let rows: Vec<i32> = rows.collect();
            let count = rows.len();
            Tensor::from_data(TensorData::new(rows, [count]), &device)
        });
        self.members = Members {
            paths,
            shapes,
            layout,
            rows,
        };
    }

    /// Returns the state of each parameter.
    fn tables(&self) -> BTreeMap<String, Table> {
        let mut all = self.stored.clone();
        let Members {
            paths,
            shapes,
            layout,
            ..
        } = &self.members;
        if paths.is_empty() {
            return all;
        }
        for (moment, values) in self.rule.moments().iter().zip(&self.moments) {
            count_readback();
            let values: Vec<f32> = values.to_data().iter().collect();
            let parts = paths.iter().zip(shapes).zip(layout.places());
            all.extend(parts.filter_map(|((path, shape), &(start, length))| {
                let values = values[start..start + length].to_vec();
                let table = Table::new(shape.clone(), values)?;
                Some((format!("{path}/{moment}"), table))
            }));
        }
        all
    }
}

fn vector(values: Vec<f32>, device: &Device) -> Tensor<1> {
    let count = values.len();
    Tensor::from_data(TensorData::new(values, [count]), device)
}

/// Finds the parameters of each group.
struct Gather<'a> {
    groups: &'a [Group],
    path: Vec<String>,
    gradients: GradientsParams,
    found: Vec<Vec<Found>>,
}

impl ModuleVisitor for Gather<'_> {
    fn enter_module(&mut self, name: &str, _: &str) {
        self.path.push(name.to_owned());
    }

    fn exit_module(&mut self, _: &str, _: &str) {
        self.path.pop();
    }

    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let path = self.path.join(".");
        let Some(group) = group_of(self.groups, &path) else {
            return;
        };
        let value = param.val().inner();
        let count = value.shape().num_elements();
        let gradient = self.gradients.remove::<D>(param.id);
        self.found[group].push(Found {
            id: param.id,
            path,
            shape: value.dims().to_vec(),
            value: value.reshape([count]),
            gradient: gradient.map(|gradient| gradient.reshape([count])),
        });
    }
}

/// Replaces the values of parameters.
struct Deliver(BTreeMap<ParamId, Tensor<1>>);

impl ModuleMapper for Deliver {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let Some(values) = self.0.remove(&param.id) else {
            return param;
        };
        param.map(|old| {
            let mut new = Tensor::from_inner(values.reshape(old.dims()));
            if let Some(strategy) = old.gradient_checkpointing_strategy() {
                new = new.with_gradient_checkpointing_strategy(strategy);
            }
            if old.is_require_grad() {
                new.require_grad()
            } else {
                new
            }
        })
    }
}
