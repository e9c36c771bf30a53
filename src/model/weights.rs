//! Weights files: safetensors with a record of what the weights belong to.

use super::{BasisNet, BasisNetConfig};
use crate::error::{Error, Result};
use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::{DType, Device, Tensor, TensorData};
use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, TensorView};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashMap};

/// What is done to colours before the network sees them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Normalisation {
    /// Subtracted from colours in `[0, 1]`.
    pub mean: [f32; 3],
    /// Then divided by.
    pub deviation: [f32; 3],
    /// Height and width of the images of training: the size at which the network works best.
    pub input: [usize; 2],
}

impl Default for Normalisation {
    /// `ImageNet`'s statistics and NYU's evaluation size.
    fn default() -> Self {
        Self {
            mean: [0.485, 0.456, 0.406],
            deviation: [0.229, 0.224, 0.225],
            input: [228, 304],
        }
    }
}

/// Everything that must go with a set of weights.
#[derive(Clone, Debug, PartialEq)]
pub struct WeightsRecord {
    /// The network.
    pub network: BasisNetConfig,
    /// The preprocessing.
    pub normalisation: Normalisation,
    /// Settings of other modules, as JSON by name (`fit`, `training`).
    pub notes: BTreeMap<String, String>,
}

/// A record and its tensors, as they lie in a file.
#[derive(Clone, Debug)]
pub struct Weights {
    /// What the tensors belong to.
    pub record: WeightsRecord,
    /// Numbers of other modules, by name.
    pub tables: BTreeMap<String, Table>,
    tensors: HashMap<String, TensorData>,
}

/// How the numbers of a network lie in a file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Precision {
    /// Two bytes each (IEEE 754 binary16), but for tensors with numbers that do not fit: variances of
    /// features are large where weights have grown.
    #[default]
    Half,
    /// Four bytes each.
    Single,
}

impl Precision {
    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Half => "f16",
            Self::Single => "f32",
        }
    }
}

/// Numbers, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// Lengths of the axes.
    pub shape: Vec<usize>,
    /// As many as `shape` says.
    pub values: Vec<f32>,
}

/// What the names of tables begin with in a file.
const TABLE: &str = "table.";

const NETWORK: &str = "network";
const NORMALISATION: &str = "normalisation";
const VERSION: &str = "lsdc";

impl Weights {
    /// Takes the weights out of a network.
    pub fn of(net: &BasisNet, record: WeightsRecord) -> Self {
        let tensors = named(net).into_iter().map(|t| (t.name, t.data)).collect();
        Self {
            record,
            tables: BTreeMap::new(),
            tensors,
        }
    }

    /// The bytes of a safetensors file with f16 tensors, where their numbers fit, and f32 tables.
    ///
    /// # Errors
    /// A record that cannot be written as JSON.
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        self.to_bytes_in(Precision::Half)
    }

    /// The bytes of a safetensors file with tensors of that precision, and f32 tables.
    ///
    /// # Errors
    /// A record that cannot be written as JSON.
    pub fn to_bytes_in(&self, precision: Precision) -> Result<Vec<u8>> {
        let broken = |e: &dyn std::fmt::Display| {
            Error::weights(format!("the weights cannot be written: {e}"))
        };
        let json = |value: &dyn erased::Json| value.json().map_err(|e| broken(&e));
        let mut metadata: HashMap<String, String> = self.record.notes.clone().into_iter().collect();
        metadata.insert(VERSION.into(), env!("CARGO_PKG_VERSION").into());
        metadata.insert(NETWORK.into(), json(&self.record.network)?);
        metadata.insert(NORMALISATION.into(), json(&self.record.normalisation)?);
        let tensors = self.tensors.iter().map(|(name, data)| {
            let values: Vec<f32> = data.iter::<f32>().collect();
            let held = |v: &f32| v.abs() <= half::f16::MAX.to_f32();
            let (dtype, bytes) = match precision {
                Precision::Half if values.iter().all(held) => {
                    let halves = values.iter().map(|v| half::f16::from_f32(*v));
                    (
                        Dtype::F16,
                        halves.flat_map(half::f16::to_le_bytes).collect(),
                    )
                }
                _ => {
                    let bytes = values.iter().flat_map(|v| v.to_le_bytes());
                    (Dtype::F32, bytes.collect())
                }
            };
            (name.clone(), (dtype, data.shape().to_vec(), bytes))
        });
        let tables = self.tables.iter().map(|(name, table)| {
            let bytes = table.values.iter().flat_map(|v| v.to_le_bytes());
            let name = format!("{TABLE}{name}");
            (name, (Dtype::F32, table.shape.clone(), bytes.collect()))
        });
        let all: BTreeMap<String, (Dtype, Vec<usize>, Vec<u8>)> = tensors.chain(tables).collect();
        let views = all
            .iter()
            .map(|(name, (dtype, shape, bytes))| {
                let view = TensorView::new(*dtype, shape.clone(), bytes);
                view.map(|view| (name, view)).map_err(|e| broken(&e))
            })
            .collect::<Result<Vec<_>>>()?;
        safetensors::serialize(views, Some(metadata)).map_err(|e| broken(&e))
    }

    /// Reads a safetensors file; `name` says in errors which one.
    ///
    /// # Errors
    /// Bytes that are no safetensors file of this program.
    pub fn from_bytes(bytes: &[u8], name: &str) -> Result<Self> {
        let foreign = |what: String| {
            Error::weights(format!("`{name}` is not a weights file of lsdc: {what}"))
                .hint("`lsdc train` writes `weights.safetensors` into its run folder")
        };
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(|e| foreign(e.to_string()))?;
        let metadata = header
            .metadata()
            .clone()
            .ok_or_else(|| foreign("it has no record".into()))?;
        let record = record(metadata).map_err(foreign)?;
        let file = SafeTensors::deserialize(bytes).map_err(|e| foreign(e.to_string()))?;
        let mut weights = Self {
            record,
            tables: BTreeMap::new(),
            tensors: HashMap::new(),
        };
        for (name, view) in file.tensors() {
            let values = decode(&view)
                .ok_or_else(|| foreign(format!("tensor `{name}` is neither f16 nor f32")))?;
            if !values.iter().all(|v| v.is_finite()) {
                return Err(foreign(format!(
                    "tensor `{name}` has values that are not finite"
                )));
            }
            let shape = view.shape().to_vec();
            match name.strip_prefix(TABLE) {
                Some(name) => {
                    weights
                        .tables
                        .insert(name.to_owned(), Table { shape, values });
                }
                None => {
                    weights.tensors.insert(name, TensorData::new(values, shape));
                }
            }
        }
        Ok(weights)
    }

    /// The number of trained numbers of the network.
    pub fn parameters(&self) -> usize {
        let trained = self.tensors.iter().filter(|(name, _)| !is_statistic(name));
        trained.map(|(_, data)| data.num_elements()).sum()
    }

    /// Builds the network and fills in the weights.
    ///
    /// # Errors
    /// A tensor that is missing, superfluous or of another shape.
    pub fn load(&self, device: &Device) -> Result<BasisNet> {
        let net = self.record.network.blank(device)?;
        let mut filler = Filler::new(self);
        let net = net.map(&mut filler);
        let superfluous = filler
            .tensors
            .keys()
            .min()
            .map(|n| format!("`{n}` is superfluous"));
        match filler.wrong.into_iter().next().or(superfluous) {
            None => Ok(net),
            Some(what) => Err(Error::weights(format!(
                "the weights do not belong to their network: {what}"
            ))
            .hint("the file is damaged or was edited; train or download it again")),
        }
    }

    /// Gives a network, which may be another one, the tensors that agree in name and shape; the
    /// others stay as they are. Returns the number of tensors that stayed.
    ///
    /// # Errors
    /// Not a single tensor agrees.
    pub fn transfer(&self, net: BasisNet) -> Result<(BasisNet, usize)> {
        let mut filler = Filler::new(self);
        let net = net.map(&mut filler);
        if filler.filled == 0 {
            return Err(
                Error::weights("no tensor of the start weights fits the network")
                    .hint("set `preset` or `network` closer to that of the start weights"),
            );
        }
        Ok((net, filler.wrong.len()))
    }
}

/// `&dyn` access to serde's JSON.
mod erased {
    pub(super) trait Json {
        fn json(&self) -> serde_json::Result<String>;
    }

    impl<T: serde::Serialize> Json for T {
        fn json(&self) -> serde_json::Result<String> {
            serde_json::to_string(self)
        }
    }
}

fn record(mut metadata: HashMap<String, String>) -> std::result::Result<WeightsRecord, String> {
    let mut take = |key: &str| {
        metadata
            .remove(key)
            .ok_or(format!("it has no `{key}` record"))
    };
    let network = take(NETWORK)?;
    let normalisation = take(NORMALISATION)?;
    take(VERSION)?;
    Ok(WeightsRecord {
        network: serde_json::from_str(&network).map_err(|e| format!("`network`: {e}"))?,
        normalisation: serde_json::from_str(&normalisation)
            .map_err(|e| format!("`normalisation`: {e}"))?,
        notes: metadata.into_iter().collect(),
    })
}

fn decode(view: &TensorView<'_>) -> Option<Vec<f32>> {
    match view.dtype() {
        Dtype::F16 => {
            let (pairs, _) = view.data().as_chunks::<2>();
            Some(
                pairs
                    .iter()
                    .map(|b| half::f16::from_le_bytes(*b).to_f32())
                    .collect(),
            )
        }
        Dtype::F32 => {
            let (words, _) = view.data().as_chunks::<4>();
            Some(words.iter().map(|b| f32::from_le_bytes(*b)).collect())
        }
        _ => None,
    }
}

/// A tensor of a module and its path, such as `extractor.stem.0.conv.weight`.
pub(super) struct Named {
    pub(super) name: String,
    pub(super) data: TensorData,
}

impl Named {
    /// Whether this is a running statistic, not a trained parameter.
    pub(super) fn is_statistic(&self) -> bool {
        is_statistic(&self.name)
    }
}

fn is_statistic(name: &str) -> bool {
    name.contains(".running_")
}

/// All float tensors of a module.
pub(super) fn named<M: Module>(module: &M) -> Vec<Named> {
    let mut collector = Collector::default();
    module.visit(&mut collector);
    collector.found
}

#[derive(Default)]
struct Collector {
    path: Vec<String>,
    found: Vec<Named>,
}

impl ModuleVisitor for Collector {
    fn enter_module(&mut self, name: &str, _: &str) {
        self.path.push(name.to_owned());
    }

    fn exit_module(&mut self, _: &str, _: &str) {
        self.path.pop();
    }

    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        self.found.push(Named {
            name: self.path.join("."),
            data: param.val().into_data().convert_dtype(DType::F32),
        });
    }
}

struct Filler {
    tensors: HashMap<String, TensorData>,
    path: Vec<String>,
    filled: usize,
    wrong: Vec<String>,
}

impl Filler {
    fn new(weights: &Weights) -> Self {
        Self {
            tensors: weights.tensors.clone(),
            path: Vec::new(),
            filled: 0,
            wrong: Vec::new(),
        }
    }
}

impl ModuleMapper for Filler {
    fn enter_module(&mut self, name: &str, _: &str) {
        self.path.push(name.to_owned());
    }

    fn exit_module(&mut self, _: &str, _: &str) {
        self.path.pop();
    }

    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let name = self.path.join(".");
        let shape = param.val().dims();
        match self.tensors.remove(&name) {
            Some(data) if data.shape()[..] == shape => {
                self.filled += 1;
                let learned = param.is_require_grad();
                param
                    .map(|tensor| Tensor::from_data(data, &tensor.device()))
                    .set_require_grad(learned)
            }
            Some(data) => {
                let found = data.shape();
                self.wrong
                    .push(format!("`{name}` has shape {found:?}, expected {shape:?}"));
                param
            }
            None => {
                self.wrong.push(format!("`{name}` is missing"));
                param
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn small() -> Weights {
        let network = BasisNetConfig::small();
        let net = network.init(0, &Device::flex()).unwrap();
        let normalisation = Normalisation::default();
        let record = WeightsRecord {
            network,
            normalisation,
            notes: BTreeMap::new(),
        };
        Weights::of(&net, record)
    }

    /// The name of a running variance, and the tensor with one number replaced.
    fn with_variance(weights: &mut Weights, value: f32) -> String {
        let mut names = weights.tensors.keys();
        let name = names.find(|n| n.contains("running_var")).unwrap().clone();
        let data = &weights.tensors[&name];
        let mut values: Vec<f32> = data.iter::<f32>().collect();
        values[1] = value;
        let data = TensorData::new(values, data.shape().to_vec());
        weights.tensors.insert(name.clone(), data);
        name
    }

    #[test]
    fn numbers_that_do_not_fit_half_precision_stay() {
        let mut weights = small();
        let name = with_variance(&mut weights, 123_456.0);
        let read = Weights::from_bytes(&weights.to_bytes().unwrap(), "w").unwrap();
        assert_eq!(read.tensors[&name], weights.tensors[&name]);
        let single = weights.to_bytes_in(Precision::Single).unwrap().len();
        assert!(2 * weights.to_bytes().unwrap().len() < single + 200_000);
    }

    #[test]
    fn numbers_that_are_not_finite_are_refused() {
        let mut weights = small();
        let name = with_variance(&mut weights, f32::INFINITY);
        let error = Weights::from_bytes(&weights.to_bytes().unwrap(), "w").unwrap_err();
        let text = error.to_string();
        assert!(
            text.contains(&name) && text.contains("not finite"),
            "{text}"
        );
    }
}
