//! The MLP: its weights in the shared buffer, and its launches, each with one upload and one read-back.

use crate::device::{Gpu, Pending};
use crate::kernel::{HeadKernel, Kernel, PARAMETERS};
use crate::memory::Pooled;
use crate::plan::{Place, spread};
use crate::traffic::Part;
use crate::weights::{GpuLayer, Packer, quads};
use lsdc_core::network::{FirstFunction, HeadWeights, LinearWeights, Prepare, codes};
use lsdc_kernels::conv::ConvSpec;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};
use wgpu::{Buffer, BufferDescriptor, BufferUsages};

/// Limit of hidden layers: their sizes must fit in the parameters of a launch.
pub(crate) const MOST_LAYERS: usize = PARAMETERS / 16 - 4;
/// Limit of the width of a hidden layer: one position must fit in workgroup memory.
pub(crate) const MOST_WIDTH: usize = 2048;
/// Positions per launch.
const PLACES: usize = 1 << 15;
/// Number of cached grids.
const GRIDS: usize = 2;

/// The MLP.
#[derive(Debug)]
pub(crate) struct Head {
    /// The first layer for the features; it commutes with their upsampling.
    pub(crate) input: GpuLayer,
    first: LinearWeights,
    last: LinearWeights,
    features: usize,
    octaves: usize,
    kernel: HeadKernel,
    /// Offsets of the codes, bias, last layer and first basis function.
    offsets: [u32; 4],
    layers: Vec<[u32; 4]>,
    /// Outputs of the first layer for the positional codes of all rows and columns, for the last few image sizes.
    grids: Mutex<VecDeque<Grid>>,
}

/// Outputs of the first layer for the positional codes of images of one size (height, width).
type Grid = ((usize, usize), Arc<Buffer>);

/// Outputs of the first layer for the features of an image, followed by the logarithm of the first basis function.
#[derive(Debug)]
pub(crate) struct Features {
    pub(crate) buffer: Pooled,
    pub(crate) place: Place,
}

impl Head {
    /// Packs the weights; `None` without hidden layers.
    pub(crate) fn new(weights: HeadWeights, packer: &Packer) -> Option<Self> {
        let HeadWeights {
            hidden,
            features,
            octaves,
            last,
            first: function,
        } = weights;
        let width = hidden.iter().map(|layer| layer.columns).max()?;
        let mut hidden = hidden.into_iter();
        let first = hidden.next()?;
        let columns = first.columns;
        let transposed: Vec<f32> = (0..columns)
            .flat_map(|o| (0..features).map(move |i| (i, o)))
            .map(|(i, o)| first.values[i * columns + o])
            .collect();
        let sizes = [columns, features, 1];
        let input = packer.layer(&transposed, sizes, &[], ConvSpec::pointwise());
        let codes = packer.rows(&first.values[features * columns..], columns, 0);
        let bias = packer.rows(&first.bias, columns, 0);
        let padding = |inputs: usize| inputs.next_multiple_of(4) - inputs;
        let layers = hidden.map(|layer| {
            let inputs = layer.rows();
            let weights = packer.rows(&layer.values, layer.columns, padding(inputs));
            let bias = packer.rows(&layer.bias, layer.columns, 0);
            let sizes = [inputs, layer.columns].map(|values| quads(values) as u32);
            [weights, bias, sizes[0], sizes[1]]
        });
        let layers: Vec<[u32; 4]> = layers.collect();
        let mean = match &function {
            FirstFunction::Hidden(weights) => weights.clone(),
            _ => vec![0.0; last.rows()],
        };
        // The first column is the logarithm of the first basis function.
        let rows = mean.iter().zip(last.values.chunks_exact(last.columns));
        let rows = rows.flat_map(|(first, row)| std::iter::once(first).chain(row));
        let rows: Vec<f32> = rows.copied().collect();
        let kernel = HeadKernel {
            width: quads(width),
            layers: layers.len(),
            first: HeadKernel::first(&function),
            sum: false,
        };
        Some(Self {
            input,
            octaves,
            features,
            kernel,
            offsets: [
                codes,
                bias,
                packer.rows(&rows, last.columns + 1, padding(last.rows())),
                packer.rows(&mean, mean.len(), 0),
            ],
            layers,
            first,
            last,
            grids: Mutex::default(),
        })
    }

    /// Number of basis functions, including the first one.
    fn functions(&self) -> usize {
        self.last.columns + 1
    }

    /// Values `[places, N + 1]` at positions (u, v) of an image of `size` (height, width).
    pub(crate) fn at(
        &self,
        gpu: &Gpu,
        weights: &Buffer,
        features: &Features,
        size: (usize, usize),
        places: &[[f64; 2]],
    ) -> Vec<f32> {
        let mut values = Vec::with_capacity(places.len() * self.functions());
        for places in places.chunks(PLACES) {
            let input = self.coded_places(features.place, size, places);
            let count = (places.len(), places.len() * self.functions());
            let kernel = self.kernel;
            let parameters = self.parameters(features.place, places.len(), size);
            let buffers = [weights, weights];
            values.extend(launch(
                gpu,
                (Part::Functions, kernel),
                features,
                buffers,
                parameters,
                &input,
                count,
            ));
        }
        values
    }

    /// Basis functions times weights at every pixel of an image of `size` (height, width).
    pub(crate) fn combine(
        &self,
        gpu: &Gpu,
        weights: &Buffer,
        features: &Features,
        size: (usize, usize),
        factors: &[f64],
    ) -> Vec<f32> {
        let pixels = size.0 * size.1;
        if pixels == 0 {
            return Vec::new();
        }
        let (first, others) = factors.split_first().unwrap_or((&0.0, &[]));
        let rows = self.last.values.chunks_exact(self.last.columns);
        let folded = rows.map(|row| {
            let terms = row.iter().zip(others).map(|(a, w)| f64::from(*a) * w);
            terms.sum::<f64>() as f32
        });
        let mut input = vec![*first as f32, 0.0, 0.0, 0.0];
        input.extend(folded);
        input.resize(input.len().next_multiple_of(4), 0.0);
        let kernel = HeadKernel {
            sum: true,
            ..self.kernel
        };
        let grid = self.grid(gpu, size);
        let parameters = self.parameters(features.place, pixels, size);
        launch(
            gpu,
            (Part::Map, kernel),
            features,
            [weights, &grid],
            parameters,
            &input,
            (pixels, pixels),
        )
    }

    fn parameters(&self, features: Place, places: usize, size: (usize, usize)) -> Vec<[u32; 4]> {
        let logarithm = features.pixels() * features.quads;
        let functions = self.functions();
        let sizes = [
            [features.height, features.width, features.quads, logarithm],
            [places, size.0, size.1, 0],
            [
                functions,
                self.octaves,
                quads(functions),
                quads(self.last.rows()),
            ],
        ];
        let [map, image, sizes] = sizes.map(|four| four.map(|v| v as u32));
        let head = [map, image, self.offsets, sizes];
        head.into_iter()
            .chain(self.layers.iter().copied())
            .collect()
    }

    /// For each position: row and column in the features, then the indices of the codes of its column and row.
    fn coded_places(&self, map: Place, size: (usize, usize), places: &[[f64; 2]]) -> Vec<f32> {
        let of_axis = |axis: usize, length: usize| {
            let places = places.iter().map(|place| place[axis]);
            codes(places, length, self.octaves)
        };
        let (columns, rows) = (of_axis(0, size.1), of_axis(1, size.0));
        let position = |place: f64, from: usize, to: usize| {
            let position = (place + 0.5) * (to as f64 / from as f64) - 0.5;
            position.clamp(0.0, (to - 1) as f64) as f32
        };
        let half = 2 * self.octaves;
        let mut input = Vec::with_capacity(places.len() * (4 + 2 * half));
        for (i, &[u, v]) in places.iter().enumerate() {
            let row = position(v, size.0, map.height);
            let column = position(u, size.1, map.width);
            input.extend([row, column, 0.0, 0.0]);
            input.extend(&columns[i * half..][..half]);
            input.extend(&rows[i * half..][..half]);
        }
        input
    }

    /// Outputs of the first layer for the codes of all rows, then of all columns, with its bias.
    fn grid(&self, gpu: &Gpu, size: (usize, usize)) -> Arc<Buffer> {
        let mut grids = self.grids.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, grid)) = grids.iter().find(|(known, _)| *known == size) {
            return grid.clone();
        }
        let (width, half) = (self.first.columns, 2 * self.octaves);
        let layer = self.first.values.chunks_exact(width);
        let layer: Vec<&[f32]> = layer.skip(self.features).collect();
        let mut values: Vec<f32> = Vec::new();
        let mut axis = |length: usize, layer: &[&[f32]], bias: &[f32]| {
            let all = codes((0..length).map(|i| i as f64), length, self.octaves);
            for i in 0..length {
                let mut row = bias.to_vec();
                for (code, weights) in all[i * half..][..half].iter().zip(layer) {
                    let pairs = row.iter_mut().zip(*weights);
                    pairs.for_each(|(sum, weight)| *sum += code * weight);
                }
                row.resize(width.next_multiple_of(4), 0.0);
                values.extend(row);
            }
        };
        axis(size.0, &layer[half..], &vec![0.0; width]);
        axis(size.1, &layer[..half], &self.first.bias);
        let grid = Arc::new(gpu.device().create_buffer(&BufferDescriptor {
            label: None,
            size: 4 * values.len() as u64,
            usage: BufferUsages::STORAGE | BufferUsages::COPY_DST,
            mapped_at_creation: false,
        }));
        gpu.upload(Part::Preparation, &grid, 0, bytemuck::cast_slice(&values));
        grids.push_front((size, grid.clone()));
        grids.truncate(GRIDS);
        grid
    }

    /// Frees everything cached for further images.
    pub(crate) fn clear(&self) {
        self.grids
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clear();
    }
}

/// Runs the MLP at some positions.
fn launch(
    gpu: &Gpu,
    (part, kernel): (Part, HeadKernel),
    features: &Features,
    [weights, grid]: [&Buffer; 2],
    parameters: Vec<[u32; 4]>,
    input: &[f32],
    (places, count): (usize, usize),
) -> Vec<f32> {
    let (device, pool) = (gpu.device(), gpu.pool());
    let mut bytes = bytemuck::cast_slice(&parameters).to_vec();
    bytes.resize(PARAMETERS, 0);
    bytes.extend_from_slice(bytemuck::cast_slice(input));
    // Parameters and values are one transfer.
    let usage = BufferUsages::UNIFORM | BufferUsages::STORAGE | BufferUsages::COPY_DST;
    let input = pool.take(device, bytes.len() as u64, usage);
    gpu.upload(part, &input, 0, &bytes);
    let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC;
    let output = pool.take(device, 4 * count as u64, usage);
    let staging = gpu.staging(4 * count as u64);
    let group = gpu.bindings().group(
        device,
        &[
            (&features.buffer, 0),
            (weights, 0),
            (&input, 0),
            (&input, PARAMETERS as u64),
            (&output, 0),
            (grid, 0),
        ],
    );
    let pipeline = gpu.kernel(&Kernel::Head(kernel));
    let [x, y, z] = spread(places.div_ceil(kernel.places())).map(|v| v as u32);
    let submitted = gpu.submit(part, |encoder| {
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_pipeline(&pipeline);
            pass.set_bind_group(0, &group, &[0]);
            pass.dispatch_workgroups(x, y, z);
        }
        encoder.copy_buffer_to_buffer(&output, 0, &staging, 0, 4 * count as u64);
        1
    });
    gpu.wait(part, Pending::new(staging, count, submitted))
}
