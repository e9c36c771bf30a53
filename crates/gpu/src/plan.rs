//! The launches of a network for one image size, and the placement of its maps in their buffer.
//! A quad is a `vec4<f32>`: four channels of a pixel.

use crate::device::Gpu;
use crate::kernel::{
    Activation, Form, Kernel, MOST_GROUPS, PARAMETERS, PARTS, QUERIES, Source, Tile, UNITS,
};
use crate::traffic::Part;
use crate::weights::{GpuLayer, NONE, quads};
use lsdc_core::SettingsError;
use lsdc_core::network::{Executor, HeadExecutor};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;
use std::sync::Arc;
use wgpu::{BindGroup, Buffer, BufferDescriptor, BufferUsages, CommandEncoder, ComputePipeline};

/// Used regions of a buffer in vec4, and its largest extent so far.
#[derive(Debug, Default)]
struct Arena {
    /// The end of each region by its start.
    used: BTreeMap<usize, usize>,
    most: usize,
}

impl Arena {
    /// Reserves the first gap of this length, and returns its start.
    fn take(&mut self, length: usize) -> usize {
        let mut start = 0;
        for (&next, &end) in &self.used {
            if next - start >= length {
                break;
            }
            start = end;
        }
        self.used.insert(start, start + length);
        self.most = self.most.max(start + length);
        start
    }
}

/// A map `[height, width, quads]` in the buffer, until the last of its clones is dropped.
#[derive(Clone, Debug)]
pub(crate) struct Map(Rc<Region>);

#[derive(Debug)]
struct Region {
    arena: Rc<RefCell<Arena>>,
    place: Place,
}

impl Drop for Region {
    fn drop(&mut self) {
        self.arena.borrow_mut().used.remove(&self.place.offset);
    }
}

/// The placement of a map.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place {
    /// In vec4.
    pub(crate) offset: usize,
    pub(crate) height: usize,
    pub(crate) width: usize,
    /// Per pixel.
    pub(crate) quads: usize,
}

impl Place {
    pub(crate) fn pixels(self) -> usize {
        self.height * self.width
    }

    /// The same region without its first pixels, as a map of another size.
    pub(crate) fn after(self, pixels: usize, (height, width): (usize, usize)) -> Self {
        Self {
            offset: self.offset + pixels * self.quads,
            height,
            width,
            quads: self.quads,
        }
    }

    /// Offset and size in bytes.
    pub(crate) fn bytes(self) -> (u64, u64) {
        let quads = self.pixels() * self.quads;
        (16 * self.offset as u64, 16 * quads as u64)
    }

    fn parameters(self) -> [u32; 4] {
        [self.offset, self.height, self.width, self.quads].map(|v| v as u32)
    }
}

impl Map {
    pub(crate) fn place(&self) -> Place {
        self.0.place
    }
}

/// A launch.
#[derive(Debug)]
struct Step {
    kernel: Kernel,
    parameters: Vec<[u32; 4]>,
    groups: [usize; 3],
}

/// Records the layers of a network.
#[derive(Debug, Default)]
pub(crate) struct Recorder {
    arena: Rc<RefCell<Arena>>,
    steps: RefCell<Vec<Step>>,
}

/// The parameters of a convolution to whose output no map is added.
const NOTHING: [u32; 4] = [NONE, 1, 1, 0];

impl Recorder {
    /// Returns an unwritten map.
    pub(crate) fn map(&self, (height, width): (usize, usize), quads: usize) -> Map {
        let offset = self.arena.borrow_mut().take(height * width * quads);
        let place = Place {
            offset,
            height,
            width,
            quads,
        };
        Map(Rc::new(Region {
            arena: self.arena.clone(),
            place,
        }))
    }

    /// Records the affinities of an image, given their changes, two pixels to a vec4.
    pub(crate) fn affinities(&self, image: &Map, changes: Option<&Map>) -> Map {
        let image = image.place();
        let output = self.map((1, image.pixels().div_ceil(2)), 1);
        let changes = changes.map_or(NONE, |map| map.place().offset as u32);
        let [offset, height, width, _] = image.parameters();
        self.launch(
            Kernel::Affinities,
            vec![
                [offset, height, width, changes],
                output.place().parameters(),
            ],
            spread(output.place().pixels().div_ceil(UNITS)),
        );
        output
    }

    /// Number of recorded launches.
    pub(crate) fn launches(&self) -> usize {
        self.steps.borrow().len()
    }

    /// Records the product of tokens with a layer and the operation after it. With `norm`, the location of gain and shift,
    /// tokens are normalised first.
    pub(crate) fn token_layer(
        &self,
        layer: &GpuLayer,
        x: &Map,
        norm: Option<u32>,
        skip: Option<&Map>,
        activation: Activation,
    ) -> Map {
        let Place { height, width, .. } = x.place();
        let output = self.map((height, width), quads(layer.outputs));
        let source = match norm {
            Some(_) => Source::Normalised,
            None => Source::Convolved,
        };
        self.product(
            source,
            [layer, layer],
            [x.place(), output.place()],
            norm,
            (skip.map(Map::place), activation),
        );
        output
    }

    /// Records a layer whose output is part of another map, plus `skip`.
    pub(crate) fn layer_into(&self, layer: &GpuLayer, x: &Map, output: Place, skip: Place) {
        let tail = (Some(skip), Activation::None);
        let places = [x.place(), output];
        self.product(Source::Convolved, [layer, layer], places, None, tail);
    }

    /// Records attention, given queries, keys and values of all tokens, with heads of this size in vec4.
    pub(crate) fn attention(&self, rows: &Map, head: usize) -> Map {
        let place = rows.place();
        let output = self.map((place.height, place.width), place.quads / 3);
        let parameters = vec![place.parameters(), output.place().parameters()];
        let groups = [
            place.pixels().div_ceil(QUERIES),
            place.quads / (3 * head),
            1,
        ];
        self.launch(Kernel::Attention(head), parameters, groups);
        output
    }

    /// Tokens of as many places of `size` (rows, columns), each normalised, side by side; `norm` is where gain and shift are.
    pub(crate) fn features(&self, tokens: &[Place], size: (usize, usize), norm: u32) -> Map {
        let quads: usize = tokens.iter().map(|place| place.quads).sum();
        let output = self.map(size, quads);
        let mut part = output.place().parameters();
        for places in tokens.chunks(PARTS) {
            let own = places[0].quads as u32;
            let head = [part, [norm, norm + own, 0, 0]];
            let inputs = places.iter().map(|place| place.parameters());
            let groups = [size.0 * size.1, places.len(), 1];
            self.launch(
                Kernel::Features,
                head.into_iter().chain(inputs).collect(),
                groups,
            );
            part[0] += own * places.len() as u32;
        }
        output
    }

    /// Records the rearrangement of a map.
    fn resampled(&self, form: Form, x: &Map, output: &Map, other: u32) {
        let place = output.place();
        self.launch(
            Kernel::Resampled(form),
            vec![x.place().parameters(), place.parameters(), [other, 0, 0, 0]],
            spread((place.pixels() * place.quads).div_ceil(UNITS)),
        );
    }

    /// Records the first channel of a map, four pixels to a vec4.
    pub(crate) fn packed(&self, x: &Map) -> Map {
        let output = self.map((1, x.place().pixels().div_ceil(4)), 1);
        self.resampled(Form::Packed, x, &output, 0);
        output
    }

    fn launch(&self, kernel: Kernel, parameters: Vec<[u32; 4]>, groups: [usize; 3]) {
        self.steps.borrow_mut().push(Step {
            kernel,
            parameters,
            groups,
        });
    }

    fn convolution(
        &self,
        source: Source,
        layers: [&GpuLayer; 2],
        x: &Map,
        size: (usize, usize),
        (skip, relu): (Option<&Map>, bool),
    ) -> Map {
        let output = self.map(size, quads(layers[1].outputs));
        let activation = if relu {
            Activation::Relu
        } else {
            Activation::None
        };
        let places = [x.place(), output.place()];
        let tail = (skip.map(Map::place), activation);
        self.product(source, layers, places, None, tail);
        output
    }

    fn product(
        &self,
        source: Source,
        [first, second]: [&GpuLayer; 2],
        [x, output]: [Place; 2],
        norm: Option<u32>,
        (skip, activation): (Option<Place>, Activation),
    ) {
        let spec = first.spec;
        let window = [first.taps, spec.stride, spec.padding, spec.dilation];
        let tile = Tile::new(output.pixels(), output.quads);
        let [x_groups, y_groups] = tile.groups(output.pixels(), output.quads);
        let activation = activation as u32;
        self.launch(
            Kernel::Convolution(source, tile, second.half),
            vec![
                x.parameters(),
                output.parameters(),
                window.map(|v| v as u32),
                [second.weights, second.bias, activation, first.weights],
                skip.map_or(NOTHING, Place::parameters),
                [norm.unwrap_or(NONE), second.scale, 0, 0],
            ],
            [x_groups, y_groups, 1],
        );
    }
}

/// Workgroups along two axes, for kernels that count them linearly.
pub(crate) fn spread(groups: usize) -> [usize; 3] {
    let x = groups.clamp(1, MOST_GROUPS);
    [x, groups.div_ceil(x), 1]
}

/// The size of a layer's output.
fn output_size(layer: &GpuLayer, x: &Map) -> (usize, usize) {
    let Place { height, width, .. } = x.place();
    let along = |length| layer.spec.output(length, layer.taps);
    (along(height), along(width))
}

impl Executor for Recorder {
    type Layer = GpuLayer;
    type Map = Map;

    fn layer(&self, layer: &GpuLayer, x: &Map, skip: Option<&Map>, relu: bool) -> Map {
        let size = output_size(layer, x);
        let tail = (skip, relu);
        self.convolution(Source::Convolved, [layer, layer], x, size, tail)
    }

    fn layer_plus_enlarged(&self, layer: &GpuLayer, x: &Map, coarser: &Map) -> Map {
        let size = output_size(layer, x);
        let tail = (Some(coarser), false);
        self.convolution(Source::Convolved, [layer, layer], x, size, tail)
    }

    fn plus_enlarged_layer(&self, map: Map, layer: &GpuLayer, x: &Map) -> Map {
        let Place { height, width, .. } = map.place();
        let (size, tail) = ((height, width), (Some(&map), false));
        self.convolution(Source::Enlarged, [layer, layer], x, size, tail)
    }

    fn separable(
        &self,
        depthwise: &GpuLayer,
        pointwise: &GpuLayer,
        x: &Map,
        skip: Option<&Map>,
    ) -> Map {
        let size = output_size(depthwise, x);
        let layers = [depthwise, pointwise];
        self.convolution(Source::Depthwise, layers, x, size, (skip, false))
    }

    fn enlarged(&self, map: &Map, like: &Map) -> Map {
        let Place { height, width, .. } = like.place();
        let output = self.map((height, width), map.place().quads);
        self.concatenation(&[map], &output);
        output
    }

    fn averages(&self, map: &Map, sizes: &[usize]) -> Vec<Map> {
        let Place {
            height,
            width,
            quads,
            ..
        } = map.place();
        let pool = |&size: &usize| self.map((height.div_ceil(size), width.div_ceil(size)), quads);
        let pools: Vec<Map> = sizes.iter().map(pool).collect();
        for (pools, sizes) in pools.chunks(PARTS).zip(sizes.chunks(PARTS)) {
            let each = pools.iter().zip(sizes).map(|(pool, &size)| {
                let [offset, height, width, _] = pool.place().parameters();
                [offset, height, width, size as u32]
            });
            let most = pools.iter().map(|pool| pool.place().pixels()).max();
            let groups = [most.unwrap_or(0), quads, pools.len()];
            let parameters = [map.place().parameters()].into_iter().chain(each);
            self.launch(Kernel::Averages, parameters.collect(), groups);
        }
        pools
    }

    fn concatenated(&self, maps: [&Map; 2], coarser: &[Map]) -> Map {
        let all: Vec<&Map> = maps.into_iter().chain(coarser).collect();
        let quads = all.iter().map(|map| map.place().quads).sum();
        let Place { height, width, .. } = maps[0].place();
        let output = self.map((height, width), quads);
        self.concatenation(&all, &output);
        output
    }
}

impl HeadExecutor for Recorder {
    fn size(&self, map: &Map) -> (usize, usize) {
        let Place { height, width, .. } = map.place();
        (height, width)
    }

    fn rectified(&self, map: &Map) -> Map {
        let output = self.map(self.size(map), map.place().quads);
        self.resampled(Form::Rectified, map, &output, 0);
        output
    }

    fn sum(&self, one: &Map, other: &Map) -> Map {
        let output = self.map(self.size(one), one.place().quads);
        self.resampled(Form::Sum, one, &output, other.place().offset as u32);
        output
    }

    fn in_blocks(&self, layer: &GpuLayer, side: usize, x: &Map) -> Map {
        let product = self.layer(layer, x, None, false);
        let Place { height, width, .. } = product.place();
        let size = (side * height, side * width);
        let output = self.map(size, product.place().quads / (side * side));
        self.resampled(Form::Blocks, &product, &output, side as u32);
        output
    }

    fn enlarged_by_corners(&self, map: &Map, size: (usize, usize)) -> Map {
        let output = self.map(size, map.place().quads);
        self.resampled(Form::Corners, map, &output, 0);
        output
    }
}

impl Recorder {
    fn concatenation(&self, all: &[&Map], output: &Map) {
        let mut first = 0;
        for maps in all.chunks(PARTS) {
            let places = maps.iter().map(|map| map.place().parameters());
            let count: usize = maps.iter().map(|map| map.place().quads).sum();
            let head = [
                output.place().parameters(),
                [first as u32, maps.len() as u32, 0, 0],
            ];
            self.launch(
                Kernel::Concatenation,
                head.into_iter().chain(places).collect(),
                spread((output.place().pixels() * count).div_ceil(UNITS)),
            );
            first += count;
        }
    }
}

/// Launches ready for submission, in order, and the buffer of their maps.
#[derive(Debug)]
pub(crate) struct Launches {
    steps: Vec<(Arc<ComputePipeline>, [u32; 3])>,
    group: BindGroup,
    pub(crate) maps: Buffer,
}

impl Launches {
    /// Prepares the recorded launches.
    ///
    /// # Errors
    /// The maps do not fit in a buffer of the GPU, or there are more pixels than it can launch.
    pub(crate) fn new(
        gpu: &Gpu,
        recorder: Recorder,
        weights: &Buffer,
    ) -> Result<Self, SettingsError> {
        let (steps, device) = (recorder.steps.into_inner(), gpu.device());
        let bytes = 16 * recorder.arena.borrow().most as u64;
        let most = device.limits().max_storage_buffer_binding_size;
        let groups = steps.iter().flat_map(|step| step.groups).max();
        if bytes > most || groups > Some(MOST_GROUPS) {
            let message = format!(
                "the network needs {} MB at once for images of this working size, and `{}` has {} MB",
                bytes / 1_000_000,
                gpu.name(),
                most / 1_000_000
            );
            return Err(SettingsError::new(message).with_hint("use a smaller working size"));
        }
        let buffer = |size, usage| {
            device.create_buffer(&BufferDescriptor {
                label: None,
                size,
                usage,
                mapped_at_creation: false,
            })
        };
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_DST | BufferUsages::COPY_SRC;
        let maps = buffer(bytes, usage);
        let mut values = vec![0_u32; steps.len() * PARAMETERS / 4];
        for (own, step) in values.chunks_exact_mut(PARAMETERS / 4).zip(&steps) {
            let parameters = step.parameters.as_flattened();
            own[..parameters.len()].copy_from_slice(parameters);
        }
        let usage = BufferUsages::UNIFORM | BufferUsages::COPY_DST;
        let parameters = buffer((4 * values.len()) as u64, usage);
        let part = Part::Preparation;
        gpu.upload(part, &parameters, 0, bytemuck::cast_slice(&values));
        let buffers = [(&maps, 0), (weights, 0), (&parameters, 0)];
        let prepared = |step: &Step| (gpu.kernel(&step.kernel), step.groups.map(|v| v as u32));
        Ok(Self {
            steps: steps.iter().map(prepared).collect(),
            group: gpu.bindings().group(device, &buffers),
            maps,
        })
    }

    /// Encodes some of the launches, and returns their number.
    pub(crate) fn encode(
        &self,
        encoder: &mut CommandEncoder,
        range: std::ops::Range<usize>,
    ) -> u64 {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        for (number, (kernel, [x, y, z])) in self.steps[range.clone()].iter().enumerate() {
            let offset = (range.start + number) * PARAMETERS;
            pass.set_pipeline(kernel);
            pass.set_bind_group(0, &self.group, &[offset as u32]);
            pass.dispatch_workgroups(*x, *y, *z);
        }
        range.len() as u64
    }

    pub(crate) fn len(&self) -> usize {
        self.steps.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_in_use_never_overlap_and_freed_ones_are_reused() {
        let recorder = Recorder::default();
        let (a, b) = (recorder.map((2, 3), 4), recorder.map((1, 5), 2));
        assert_eq!((a.place().offset, b.place().offset), (0, 24));
        let copy = a.clone();
        drop(a);
        assert_eq!(recorder.map((1, 1), 1).place().offset, 34);
        drop(copy);
        let small = recorder.map((1, 1), 20);
        let large = recorder.map((1, 1), 25);
        assert_eq!((small.place().offset, large.place().offset), (0, 34));
        assert_eq!(recorder.arena.borrow().most, 59);
    }
}
