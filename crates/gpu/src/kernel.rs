//! The kernels and their compile-time constants.

use lsdc_core::network::{
    CONTRAST, FirstFunction, LAYER_EPSILON, LEAST_AFFINITY, MAX_LOG_DEPTH, MAX_LOG_FACTOR,
};
use wgpu::{
    BindGroup, BindGroupDescriptor, BindGroupEntry, BindGroupLayout, BindGroupLayoutDescriptor,
    BindGroupLayoutEntry, BindingResource, BindingType, Buffer, BufferBinding, BufferBindingType,
    ComputePipeline, ComputePipelineDescriptor, Device, PipelineCompilationOptions, PipelineLayout,
    PipelineLayoutDescriptor, ShaderModuleDescriptor, ShaderSource, ShaderStages,
};

/// Invocations per workgroup.
pub(crate) const UNITS: usize = 128;
/// Largest number of workgroups along an axis: the default limit of WebGPU.
pub(crate) const MOST_GROUPS: usize = 65_535;
/// Size and alignment of the parameters of a launch, in bytes.
pub(crate) const PARAMETERS: usize = 256;
/// Largest number of maps that one launch averages or concatenates.
pub(crate) const PARTS: usize = 12;
/// Bytes of workgroup memory: the default limit of WebGPU.
const SHARED_BYTES: usize = 16_384;

/// The left matrix of a convolution.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Source {
    Convolved,
    Depthwise,
    Enlarged,
    Normalised,
}

/// The operation after a product.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Activation {
    None,
    Relu,
    Gelu,
}

/// How a map is rearranged when read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Form {
    Corners,
    Rectified,
    Sum,
    Blocks,
    Packed,
}

/// Queries per workgroup in attention.
pub(crate) const QUERIES: usize = UNITS / 4;
/// Largest size of an attention head, in vec4: keys and values must fit in workgroup memory.
pub(crate) const MOST_HEAD: usize = 24;

/// The division of a convolution among workgroups and invocations.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Tile {
    /// Outputs of a workgroup, in vec4.
    pub(crate) quads: usize,
    /// Pixels per invocation.
    pub(crate) rows: usize,
}

impl Tile {
    /// Workgroups that occupy a large GPU: two for each of its multiprocessors.
    const ENOUGH: usize = 256;

    /// The largest tiles that still occupy a large GPU.
    pub(crate) fn new(pixels: usize, quads: usize) -> Self {
        let own = quads.next_power_of_two().clamp(4, 16);
        let rows = [8, 4, 2].into_iter().find(|&rows| {
            let tile = Self { quads: own, rows };
            let [x, y] = tile.groups(pixels, quads);
            // More would not fit in workgroup memory.
            x * y >= Self::ENOUGH && tile.pixels() <= 128
        });
        Self {
            quads: own,
            rows: rows.unwrap_or(1),
        }
    }

    /// Pixels per workgroup.
    fn pixels(self) -> usize {
        UNITS / self.quads * self.rows
    }

    /// Workgroups along pixels and outputs.
    pub(crate) fn groups(self, pixels: usize, quads: usize) -> [usize; 2] {
        [pixels.div_ceil(self.pixels()), quads.div_ceil(self.quads)]
    }
}

/// The variant of the MLP kernel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct HeadKernel {
    /// Width of the widest hidden layer, in vec4.
    pub(crate) width: usize,
    /// Number of hidden layers after the first.
    pub(crate) layers: usize,
    /// The first basis function: 0: constant 1; 1: from the last hidden layer; 2: from the extractor.
    pub(crate) first: u8,
    /// Whether it returns the weighted sum instead of the basis functions.
    pub(crate) sum: bool,
}

impl HeadKernel {
    /// The code of a kind of first basis function.
    pub(crate) fn first(function: &FirstFunction) -> u8 {
        match function {
            FirstFunction::Constant => 0,
            FirstFunction::Hidden(_) => 1,
            FirstFunction::Extractor => 2,
        }
    }

    /// Positions per workgroup: as many as its memory holds twice, at most 16.
    pub(crate) fn places(self) -> usize {
        let most = SHARED_BYTES / (2 * 16 * self.width.max(4));
        let most = most.clamp(1, 16);
        // A power of two.
        (most + 1).next_power_of_two() / 2
    }
}

/// A kernel with its constants.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Kernel {
    /// Argument: whether the weights are in f16.
    Convolution(Source, Tile, bool),
    /// Argument: size of a head in vec4.
    Attention(usize),
    Features,
    Resampled(Form),
    Averages,
    Concatenation,
    Affinities,
    Head(HeadKernel),
}

impl Kernel {
    /// The WGSL source.
    fn source(&self) -> String {
        let (constants, text) = match *self {
            Self::Convolution(source, tile, half) => {
                let (pixels, Tile { quads, rows }) = (tile.pixels(), tile);
                let depth = if rows > 2 { 4 } else { 8 };
                let source = source as u32;
                (
                    format!(
                        "const PIXELS = {pixels}u;\nconst QUADS = {quads}u;\nconst ROWS = {rows}u;\n\
                         const DEPTH = {depth}u;\nconst SOURCE = {source}u;\nconst HALF = {half};\n\
                         const EPSILON = {LAYER_EPSILON:?}f;\n"
                    ),
                    include_str!("shaders/convolution.wgsl"),
                )
            }
            Self::Attention(depth) => {
                let scale = (4.0 * depth as f32).sqrt().recip();
                (
                    format!("const DEPTH = {depth}u;\nconst SCALE = {scale:?}f;\n"),
                    include_str!("shaders/attention.wgsl"),
                )
            }
            Self::Features => (
                format!("const PARTS = {PARTS}u;\nconst EPSILON = {LAYER_EPSILON:?}f;\n"),
                include_str!("shaders/features.wgsl"),
            ),
            Self::Resampled(form) => (
                format!("const FORM = {}u;\n", form as u32),
                include_str!("shaders/resampled.wgsl"),
            ),
            Self::Averages => (
                format!("const PARTS = {PARTS}u;\n"),
                include_str!("shaders/averages.wgsl"),
            ),
            Self::Concatenation => (
                format!("const PARTS = {PARTS}u;\n"),
                include_str!("shaders/concatenation.wgsl"),
            ),
            Self::Affinities => (
                format!(
                    "const CONTRAST = {CONTRAST:?}f;\nconst LEAST_AFFINITY = {LEAST_AFFINITY:?}f;\n\
                     const MAX_LOG_FACTOR = {MAX_LOG_FACTOR:?}f;\n"
                ),
                include_str!("shaders/affinities.wgsl"),
            ),
            Self::Head(head) => {
                let HeadKernel {
                    width,
                    layers,
                    first,
                    sum,
                } = head;
                let (width, places) = (width.max(4), head.places());
                (
                    format!(
                        "const PLACES = {places}u;\nconst WIDTH = {width}u;\nconst LAYERS = {layers}u;\n\
                         const SUM = {sum};\nconst FIRST = {first}u;\n\
                         const MAX_LOG_DEPTH = {MAX_LOG_DEPTH:?}f;\n"
                    ),
                    include_str!("shaders/head.wgsl"),
                )
            }
        };
        format!("const UNITS = {UNITS}u;\n{constants}{text}")
    }

    /// Compiles the kernel.
    pub(crate) fn compile(&self, device: &Device, bindings: &Bindings) -> ComputePipeline {
        let module = device.create_shader_module(ShaderModuleDescriptor {
            label: None,
            source: ShaderSource::Wgsl(self.source().into()),
        });
        let layout = match self {
            Self::Head(_) => &bindings.head.1,
            _ => &bindings.layers.1,
        };
        device.create_compute_pipeline(&ComputePipelineDescriptor {
            label: None,
            layout: Some(layout),
            module: &module,
            entry_point: None,
            compilation_options: PipelineCompilationOptions {
                // Kernels write workgroup memory before they read it.
                zero_initialize_workgroup_memory: false,
                ..PipelineCompilationOptions::default()
            },
            cache: None,
        })
    }
}

/// The buffers bound to kernels.
#[derive(Debug)]
pub(crate) struct Bindings {
    layers: (BindGroupLayout, PipelineLayout),
    head: (BindGroupLayout, PipelineLayout),
}

/// The binding of the parameters, with a dynamic offset for each launch.
const UNIFORM: u32 = 2;

impl Bindings {
    pub(crate) fn new(device: &Device) -> Self {
        let writable = BufferBindingType::Storage { read_only: false };
        let readable = BufferBindingType::Storage { read_only: true };
        let uniform = BufferBindingType::Uniform;
        let types = [writable, readable, uniform, readable, writable, readable];
        let layout = |count: usize| {
            let entry = |(binding, &ty)| BindGroupLayoutEntry {
                binding: binding as u32,
                visibility: ShaderStages::COMPUTE,
                ty: BindingType::Buffer {
                    ty,
                    has_dynamic_offset: binding as u32 == UNIFORM,
                    min_binding_size: None,
                },
                count: None,
            };
            let entries: Vec<_> = types[..count].iter().enumerate().map(entry).collect();
            let groups = device.create_bind_group_layout(&BindGroupLayoutDescriptor {
                label: None,
                entries: &entries,
            });
            let pipelines = device.create_pipeline_layout(&PipelineLayoutDescriptor {
                label: None,
                bind_group_layouts: &[Some(&groups)],
                immediate_size: 0,
            });
            (groups, pipelines)
        };
        Self {
            layers: layout(3),
            head: layout(6),
        }
    }

    /// Binds the buffers of layers (3) or of the MLP (6) from some bytes on, in the order of the kernels.
    pub(crate) fn group(&self, device: &Device, buffers: &[(&Buffer, u64)]) -> BindGroup {
        let layout = if buffers.len() > 3 {
            &self.head.0
        } else {
            &self.layers.0
        };
        let entry = |(binding, (buffer, offset))| BindGroupEntry {
            binding,
            resource: BindingResource::Buffer(BufferBinding {
                buffer,
                offset,
                size: (binding == UNIFORM)
                    .then_some(PARAMETERS as u64)
                    .and_then(std::num::NonZeroU64::new),
            }),
        };
        let entries: Vec<_> = (0..).zip(buffers.iter().copied()).map(entry).collect();
        device.create_bind_group(&BindGroupDescriptor {
            label: None,
            layout,
            entries: &entries,
        })
    }
}
