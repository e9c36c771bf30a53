//! The network of `lsdc-core` on a GPU.

use crate::device::{Gpu, Pending};
use crate::head::{Features, Head, MOST_LAYERS, MOST_WIDTH};
use crate::plan::{Launches, Map, Place, Recorder};
use crate::traffic::Part;
use crate::weights::{GpuLayer, Packer};
use lsdc_core::network::{
    Basis, Executor as _, Forward, Network, NetworkConfig, NetworkLayers, NormKind,
};
use lsdc_core::{Error, Weights, WeightsError};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use wgpu::{Buffer, BufferDescriptor, BufferUsages};

/// Sizes of images whose launches are kept.
const PLANS: usize = 2;

/// A network whose weights are on a GPU. Clones share it.
#[derive(Clone, Debug)]
pub struct GpuNetwork(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    gpu: Gpu,
    layers: NetworkLayers<GpuLayer>,
    head: Head,
    weights: Buffer,
    plans: Mutex<VecDeque<Arc<Plan>>>,
}

/// Whether a network can be run by [`GpuNetwork`].
pub fn supports(config: &NetworkConfig) -> bool {
    let extractor = &config.extractor;
    // They are concatenated by quads of channels.
    let mut merged = vec![extractor.stages[1].width, extractor.stages[3].width];
    merged.extend((!extractor.pools.is_empty()).then_some(extractor.branch));
    let widths = &config.hidden;
    extractor.encoder == 0
        && config.norm == NormKind::Batch
        && merged.iter().all(|width| width % 4 == 0)
        && (1..=MOST_LAYERS).contains(&widths.len())
        && widths.iter().all(|&width| width <= MOST_WIDTH)
}

impl GpuNetwork {
    /// Prepares a network from its weights.
    ///
    /// # Errors
    /// Weights that do not match their network, and a network that this crate does not run (see [`supports`]).
    pub fn new(weights: &Weights, gpu: &Gpu) -> Result<Self, Error> {
        let unsupported = WeightsError::Unsupported("the GPU runs no network of this kind");
        if !supports(&weights.network) {
            return Err(unsupported.into());
        }
        let packer = Packer::default();
        let (layers, head) = NetworkLayers::new(&weights.network, &weights.tensors, &packer)?;
        let head = Head::new(head, &packer).ok_or(unsupported)?;
        let values = packer.into_values();
        let weights = gpu.device().create_buffer(&BufferDescriptor {
            label: None,
            size: 4 * values.len() as u64,
            usage: BufferUsages::STORAGE | BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        gpu.upload(
            Part::Preparation,
            &weights,
            0,
            bytemuck::cast_slice(&values),
        );
        Ok(Self(Arc::new(Inner {
            gpu: gpu.clone(),
            layers,
            head,
            weights,
            plans: Mutex::default(),
        })))
    }

    /// The GPU that it is on.
    pub fn gpu(&self) -> &Gpu {
        &self.0.gpu
    }

    fn plan(&self, size: (usize, usize)) -> Result<Arc<Plan>, Error> {
        let mut plans = self.0.plans.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(plan) = plans.iter().find(|plan| plan.size == size) {
            return Ok(plan.clone());
        }
        let plan = Arc::new(Plan::new(&self.0, size)?);
        plans.push_front(plan.clone());
        plans.truncate(PLANS);
        Ok(plan)
    }
}

/// The launches for images of one size (height, width): affinities first, which the fit needs first.
#[derive(Debug)]
struct Plan {
    size: (usize, usize),
    launches: Launches,
    /// How many of the launches are for the affinities.
    first: usize,
    image: Place,
    affinities: Place,
    /// The first layer of the MLP on the features.
    features: Place,
    logarithm: Option<Place>,
    /// One image at a time is in the buffer.
    submitting: Mutex<()>,
}

impl Plan {
    fn new(network: &Inner, size: (usize, usize)) -> Result<Self, Error> {
        let recorder = Recorder::default();
        let image = recorder.map(size, 1);
        let changes = network.layers.affinity_changes(&image, None, &recorder);
        let affinities = recorder.affinities(&image, changes.as_ref());
        drop(changes);
        let first = recorder.launches();
        let output = network.layers.features(&image, None, &recorder);
        let features = recorder.layer(&network.head.input, &output.features, None, false);
        let plan = |launches| Self {
            size,
            launches,
            first,
            image: image.place(),
            affinities: affinities.place(),
            features: features.place(),
            logarithm: output.logarithm.as_ref().map(Map::place),
            submitting: Mutex::default(),
        };
        let launches = Launches::new(&network.gpu, recorder, &network.weights)?;
        Ok(plan(launches))
    }

    /// Submits everything for an image.
    fn run(&self, gpu: &Gpu, image: &[f32]) -> (Pending, Features) {
        // Pixels of three colours and a zero.
        let pixels = image.as_chunks::<3>().0.iter();
        let quads: Vec<[f32; 4]> = pixels.map(|&[r, g, b]| [r, g, b, 0.0]).collect();
        let (_, bytes) = self.features.bytes();
        let logarithm = self.logarithm.map_or(0, |map| map.bytes().1);
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_DST;
        let kept = gpu.pool().take(gpu.device(), bytes + logarithm, usage);
        let maps = &self.launches.maps;
        let (_, count) = self.affinities.bytes();
        let staging = gpu.staging(count);
        let one = self
            .submitting
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        let (offset, _) = self.image.bytes();
        gpu.upload(Part::Network, maps, offset, bytemuck::cast_slice(&quads));
        let copy = |encoder: &mut wgpu::CommandEncoder, from: Place, to: &Buffer, start: u64| {
            let (offset, bytes) = from.bytes();
            encoder.copy_buffer_to_buffer(maps, offset, to, start, bytes);
        };
        let submitted = gpu.submit(Part::Network, |encoder| {
            let launches = self.launches.encode(encoder, 0..self.first);
            copy(encoder, self.affinities, &staging, 0);
            launches
        });
        let affinities = Pending::new(staging, 2 * self.size.0 * self.size.1, submitted);
        gpu.submit(Part::Network, |encoder| {
            let launches = (self.launches).encode(encoder, self.first..self.launches.len());
            copy(encoder, self.features, &kept, 0);
            if let Some(map) = self.logarithm {
                copy(encoder, map, &kept, bytes);
            }
            launches
        });
        drop(one);
        let features = Features {
            buffer: kept,
            place: self.features,
        };
        (affinities, features)
    }
}

impl Network for GpuNetwork {
    fn forward(&self, image: &[f32], size: (usize, usize)) -> Result<Box<dyn Forward>, Error> {
        let plan = self.plan(size)?;
        let (affinities, features) = plan.run(&self.0.gpu, image);
        self.0.gpu.check()?;
        Ok(Box::new(GpuForward {
            network: self.clone(),
            size,
            features: Arc::new(features),
            pending: Mutex::new(Some(affinities)),
            affinities: OnceLock::new(),
        }))
    }

    fn release(&self) {
        let plans = &self.0.plans;
        plans.lock().unwrap_or_else(PoisonError::into_inner).clear();
        self.0.head.clear();
        self.0.gpu.pool().clear();
    }
}

/// An image whose features and affinities are being computed.
#[derive(Debug)]
struct GpuForward {
    network: GpuNetwork,
    size: (usize, usize),
    features: Arc<Features>,
    pending: Mutex<Option<Pending>>,
    affinities: OnceLock<Vec<f32>>,
}

impl Forward for GpuForward {
    fn basis(&self) -> Box<dyn Basis> {
        Box::new(GpuBasis {
            network: self.network.clone(),
            features: self.features.clone(),
        })
    }

    fn affinities(&self) -> (Vec<f32>, (usize, usize)) {
        let read = || {
            let mut pending = self.pending.lock().unwrap_or_else(PoisonError::into_inner);
            let gpu = &self.network.0.gpu;
            let values = pending
                .take()
                .map(|pending| gpu.wait(Part::Network, pending));
            values.unwrap_or_default()
        };
        (self.affinities.get_or_init(read).clone(), self.size)
    }
}

/// The basis functions of an image.
#[derive(Debug)]
struct GpuBasis {
    network: GpuNetwork,
    features: Arc<Features>,
}

impl Basis for GpuBasis {
    fn at(&self, size: (usize, usize), places: &[[f64; 2]]) -> Vec<f32> {
        let Inner {
            gpu, head, weights, ..
        } = &*self.network.0;
        head.at(gpu, weights, &self.features, size, places)
    }

    fn combine(&self, size: (usize, usize), factors: &[f64]) -> Vec<f32> {
        let Inner {
            gpu, head, weights, ..
        } = &*self.network.0;
        head.combine(gpu, weights, &self.features, size, factors)
    }
}
