//! The network of `lsdc-core` on a GPU.

use crate::device::{Gpu, InFlight, Pending};
use crate::encoder::{GpuEncoder, Pretrained};
use crate::head::{Features, Head, MOST_LAYERS, MOST_WIDTH};
use crate::plan::{Launches, Map, Place, Recorder};
use crate::traffic::Part;
use crate::weights::{GpuLayer, Packer};
use lsdc_core::network::{
    Basis, EncoderSide, Executor as _, Forward, Network, NetworkConfig, NetworkLayers, NormKind,
    PATCH, in_patches,
};
use lsdc_core::{Error, Weights, WeightsError};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use wgpu::{Buffer, BufferDescriptor, BufferUsages};

/// Number of image sizes whose launches are cached.
const PLANS: usize = 2;

/// A network with its weights on a GPU. Clones share it.
#[derive(Clone, Debug)]
pub struct GpuNetwork {
    inner: Arc<Inner>,
    encoder_side: EncoderSide,
}

#[derive(Debug)]
struct Inner {
    gpu: Gpu,
    layers: NetworkLayers<GpuLayer>,
    encoder: Option<GpuEncoder>,
    head: Head,
    weights: Buffer,
    plans: Mutex<VecDeque<Arc<Plan>>>,
}

/// Whether a network can be run by [`GpuNetwork`], on its encoder if it was trained on one.
pub fn supports(config: &NetworkConfig) -> bool {
    let extractor = &config.extractor;
    // They are concatenated as vec4 of channels.
    let [_, second, _, fourth] = &extractor.stages;
    let mut merged = vec![second.width, fourth.width, extractor.encoder];
    merged.extend((!extractor.pools.is_empty()).then_some(extractor.branch));
    let widths = &config.hidden;
    config.norm == NormKind::Batch
        && merged.iter().all(|width| width % 4 == 0)
        && (1..=MOST_LAYERS).contains(&widths.len())
        && widths.iter().all(|&width| width <= MOST_WIDTH)
}

impl GpuNetwork {
    /// Prepares a network from its weights.
    ///
    /// # Errors
    /// Weights that do not match their network, a network on an encoder (see [`Self::with_encoder`]), and one that this crate
    /// does not run (see [`supports`]).
    pub fn new(weights: &Weights, gpu: &Gpu) -> Result<Self, Error> {
        Self::prepared(weights, None, gpu)
    }

    /// Prepares a network with the encoder that it was trained on, and the depth head on this, if it is given.
    ///
    /// # Errors
    /// As for [`Self::new`], and tensors that do not match the sizes of the encoder.
    pub fn with_encoder(
        weights: &Weights,
        encoder: &Pretrained<'_>,
        gpu: &Gpu,
    ) -> Result<Self, Error> {
        Self::prepared(weights, Some(encoder), gpu)
    }

    fn prepared(
        weights: &Weights,
        pretrained: Option<&Pretrained<'_>>,
        gpu: &Gpu,
    ) -> Result<Self, Error> {
        let unsupported = WeightsError::Unsupported("the GPU runs no network of this kind");
        let config = &weights.network;
        if !supports(config) {
            return Err(unsupported.into());
        }
        let packer = Packer::default();
        let pretrained = pretrained.filter(|_| config.extractor.encoder > 0);
        let sizes = pretrained.map(|encoder| &encoder.config);
        let (layers, head) = NetworkLayers::new(config, sizes, &weights.tensors, &packer)?;
        let encoder = pretrained.map(|encoder| GpuEncoder::new(encoder, &packer));
        let encoder = encoder.transpose()?;
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
        let inner = Inner {
            gpu: gpu.clone(),
            layers,
            encoder,
            head,
            weights,
            plans: Mutex::default(),
        };
        Ok(Self {
            inner: Arc::new(inner),
            encoder_side: EncoderSide::default(),
        })
    }

    /// The GPU that runs it.
    pub fn gpu(&self) -> &Gpu {
        &self.inner.gpu
    }

    fn plan(&self, size: (usize, usize)) -> Result<Arc<Plan>, Error> {
        let mut plans = self
            .inner
            .plans
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        let side = self.encoder_side;
        let known = |plan: &&Arc<Plan>| (plan.size, plan.encoder_side) == (size, side);
        if let Some(plan) = plans.iter().find(known) {
            return Ok(plan.clone());
        }
        let plan = Arc::new(Plan::new(&self.inner, size, side)?);
        plans.push_front(plan.clone());
        plans.truncate(PLANS);
        Ok(plan)
    }
}

/// The launches for images of one size (height, width), affinities first because the fit needs them first.
#[derive(Debug)]
struct Plan {
    size: (usize, usize),
    encoder_side: EncoderSide,
    launches: Launches,
    /// Number of launches for the affinities.
    first: usize,
    image: Place,
    /// The image for the encoder, in whole patches.
    patches: Option<Place>,
    affinities: Place,
    /// Output of the first layer of the MLP for the features.
    features: Place,
    logarithm: Option<Place>,
    /// The prediction of the depth head, four pixels to a vec4, and the number of launches up to it.
    depths: Option<(Place, usize)>,
    /// Held while an image uses the buffer.
    submitting: Mutex<()>,
}

impl Plan {
    fn new(
        network: &Inner,
        size: (usize, usize),
        encoder_side: EncoderSide,
    ) -> Result<Self, Error> {
        let recorder = Recorder::default();
        let image = recorder.map(size, 1);
        let encoder = network.encoder.as_ref();
        let (rows, columns) = encoder_side.patches(size);
        let patches = encoder.map(|_| recorder.map((rows * PATCH, columns * PATCH), 1));
        let encoded = (encoder.zip(patches.as_ref()))
            .map(|(encoder, patches)| encoder.record(patches, &recorder));
        let features = encoded.as_ref().map(|encoded| &encoded.features);
        let changes = network.layers.affinity_changes(&image, features, &recorder);
        let affinities = recorder.affinities(&image, changes.as_ref());
        drop(changes);
        let first = recorder.launches();
        let output = network.layers.features(&image, features, &recorder);
        let features = recorder.layer(&network.head.input, &output.features, None, false);
        let before_head = recorder.launches();
        let depths = (encoder.zip(encoded.as_ref()))
            .and_then(|(encoder, encoded)| encoder.record_head(encoded, &recorder));
        let kept = encoded
            .as_ref()
            .map(|encoded| encoded.kept.each_ref().map(Map::place));
        let plan = |launches| Self {
            size,
            encoder_side,
            launches,
            first,
            image: image.place(),
            patches: patches.as_ref().map(Map::place),
            affinities: affinities.place(),
            features: features.place(),
            logarithm: output.logarithm.as_ref().map(Map::place),
            depths: depths.as_ref().map(|map| (map.place(), before_head)),
            submitting: Mutex::default(),
        };
        let gpu = &network.gpu;
        let plan = plan(Launches::new(gpu, recorder, &network.weights)?);
        if let (Some(encoder), Some(places)) = (encoder, kept) {
            for (place, values) in places.into_iter().zip(encoder.kept((rows, columns))) {
                let (offset, bytes) = (place.bytes().0, bytemuck::cast_slice(&values));
                gpu.upload(Part::Preparation, &plan.launches.maps, offset, bytes);
            }
        }
        Ok(plan)
    }

    /// Submits all work for an image.
    fn run(&self, gpu: &Gpu, image: &[f32]) -> Result<Submitted, Error> {
        let patches = match self.patches {
            None => None,
            Some(place) => Some((place, in_patches(image, self.size, self.encoder_side)?.0)),
        };
        let (_, bytes) = self.features.bytes();
        let logarithm = self.logarithm.map_or(0, |map| map.bytes().1);
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_DST;
        let kept = gpu.pool().take(gpu.device(), bytes + logarithm, usage);
        let maps = &self.launches.maps;
        let staging = gpu.staging(self.affinities.bytes().1);
        let in_flight = gpu.in_flight();
        let one = self
            .submitting
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        let upload = |place: Place, image: &[f32]| {
            // Pixels with three colours and a zero.
            let pixels = image.as_chunks::<3>().0.iter();
            let quads: Vec<[f32; 4]> = pixels.map(|&[r, g, b]| [r, g, b, 0.0]).collect();
            let (offset, _) = place.bytes();
            gpu.upload(Part::Network, maps, offset, bytemuck::cast_slice(&quads));
        };
        upload(self.image, image);
        if let Some((place, image)) = patches {
            upload(place, &image);
        }
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
        let last = self.launches.len();
        let before_head = self.depths.map_or(last, |(_, before)| before);
        gpu.submit(Part::Network, |encoder| {
            let launches = self.launches.encode(encoder, self.first..before_head);
            copy(encoder, self.features, &kept, 0);
            if let Some(map) = self.logarithm {
                copy(encoder, map, &kept, bytes);
            }
            launches
        });
        let depths = self.depths.zip(self.patches).map(|((place, _), patches)| {
            let staging = gpu.staging(place.bytes().1);
            let submitted = gpu.submit(Part::Network, |encoder| {
                let launches = self.launches.encode(encoder, before_head..last);
                copy(encoder, place, &staging, 0);
                launches
            });
            Pending::new(staging, patches.pixels(), submitted)
        });
        drop(one);
        Ok(Submitted {
            affinities: (affinities, in_flight),
            depths,
            features: Features {
                buffer: kept,
                place: self.features,
            },
        })
    }
}

/// An image in flight.
struct Submitted {
    affinities: (Pending, InFlight),
    depths: Option<Pending>,
    features: Features,
}

impl Network for GpuNetwork {
    fn forward(&self, image: &[f32], size: (usize, usize)) -> Result<Box<dyn Forward>, Error> {
        let plan = self.plan(size)?;
        let Submitted {
            affinities,
            depths,
            features,
        } = plan.run(&self.inner.gpu, image)?;
        self.inner.gpu.check()?;
        Ok(Box::new(GpuForward {
            network: self.clone(),
            size,
            features: Arc::new(features),
            pending: Mutex::new(Some(affinities)),
            affinities: OnceLock::new(),
            depths: Mutex::new(depths),
            patches: plan.patches,
        }))
    }

    fn has_depth_head(&self) -> bool {
        self.inner
            .encoder
            .as_ref()
            .is_some_and(GpuEncoder::has_head)
    }

    fn with_encoder_side(&self, encoder_side: EncoderSide) -> Option<Arc<dyn Network>> {
        self.inner.encoder.as_ref()?;
        let inner = self.inner.clone();
        Some(Arc::new(Self {
            inner,
            encoder_side,
        }))
    }

    fn release(&self) {
        let plans = &self.inner.plans;
        plans.lock().unwrap_or_else(PoisonError::into_inner).clear();
        self.inner.head.clear();
        self.inner.gpu.pool().clear();
    }
}

/// An image whose features and affinities are in flight.
#[derive(Debug)]
struct GpuForward {
    network: GpuNetwork,
    size: (usize, usize),
    features: Arc<Features>,
    pending: Mutex<Option<(Pending, InFlight)>>,
    affinities: OnceLock<Vec<f32>>,
    /// The pending prediction of the depth head.
    depths: Mutex<Option<Pending>>,
    /// The image that the encoder saw.
    patches: Option<Place>,
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
            let gpu = &self.network.inner.gpu;
            let values = pending.take();
            let values = values.map(|(pending, _in_flight)| gpu.wait(Part::Network, pending));
            values.unwrap_or_default()
        };
        (self.affinities.get_or_init(read).clone(), self.size)
    }

    fn published_depths(&self) -> Option<(Vec<f32>, (usize, usize))> {
        let place = self.patches?;
        let pending = self
            .depths
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take()?;
        let values = self.network.inner.gpu.wait(Part::Network, pending);
        Some((values, (place.height, place.width)))
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
        } = &*self.network.inner;
        head.at(gpu, weights, &self.features, size, places)
    }

    fn combine(&self, size: (usize, usize), factors: &[f64]) -> Vec<f32> {
        let Inner {
            gpu, head, weights, ..
        } = &*self.network.inner;
        head.combine(gpu, weights, &self.features, size, factors)
    }
}
