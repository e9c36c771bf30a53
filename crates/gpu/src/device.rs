//! A GPU: choosing and opening it, its compiled kernels, and its transfers.

use crate::kernel::{Bindings, Kernel};
use crate::memory::{Pool, Pooled};
use crate::traffic::{Counters, Part, Traffic};
use lsdc_core::SettingsError;
use std::collections::HashMap;
use std::pin::pin;
use std::str::FromStr;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::task::{Context, Poll, Waker};
use wgpu::{
    BufferUsages, CommandEncoder, CommandEncoderDescriptor, ComputePipeline, DeviceDescriptor,
    DeviceType, Instance, InstanceDescriptor, Limits, MapMode, PollType, SubmissionIndex,
};

/// Which GPU to use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Adapter {
    /// A discrete one, else an integrated one, else any other, else a software driver.
    #[default]
    Best,
    /// The discrete GPU with this index, counted from 0.
    Discrete(usize),
    /// The first integrated GPU.
    Integrated,
    /// A software driver on the CPU.
    Software,
}

impl FromStr for Adapter {
    type Err = GpuError;

    /// Parses the names of the command line: `wgpu` (the best), `wgpu:N` (discrete, from 0), `wgpu:integrated`,
    /// `wgpu:software`.
    fn from_str(name: &str) -> Result<Self, GpuError> {
        let (kind, which) = name.split_once(':').unwrap_or((name, ""));
        let adapter = match (kind, which) {
            ("wgpu", "") => Some(Self::Best),
            ("wgpu", "integrated") => Some(Self::Integrated),
            ("wgpu", "software") => Some(Self::Software),
            ("wgpu", number) => number.parse().ok().map(Self::Discrete),
            _ => None,
        };
        adapter.ok_or_else(|| GpuError::Unknown {
            name: name.to_owned(),
        })
    }
}

/// Why a GPU cannot be opened.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GpuError {
    /// No kind of GPU has this name.
    #[error("unknown device `{name}`")]
    Unknown {
        /// The given name.
        name: String,
    },
    /// There is no GPU of this kind.
    #[error("there is no GPU of this kind ({wanted:?}); found: {found}")]
    Missing {
        /// The requested kind.
        wanted: Adapter,
        /// Names of the available GPUs.
        found: String,
    },
    /// The process was forked after it opened a GPU, which does not survive that.
    #[error("this process was forked from one that had opened a GPU")]
    Forked,
    /// The driver refused.
    #[error("the GPU `{name}` cannot be opened: {why}")]
    Refused {
        /// The name of the GPU.
        name: String,
        /// The driver's reason.
        why: String,
    },
}

impl GpuError {
    /// A suggestion for what to do.
    pub fn hint(&self) -> &'static str {
        match self {
            Self::Unknown { .. } => "GPUs are wgpu, wgpu:N, wgpu:integrated and wgpu:software",
            Self::Missing { .. } | Self::Refused { .. } => {
                "check the graphics driver (`vulkaninfo --summary`), or use the device `cpu`"
            }
            Self::Forked => "start processes with \"spawn\", or open the GPU after the fork",
        }
    }
}

/// An open GPU. Clones share it.
#[derive(Clone, Debug)]
pub struct Gpu(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    name: String,
    device: wgpu::Device,
    queue: wgpu::Queue,
    bindings: Bindings,
    kernels: Mutex<HashMap<Kernel, Arc<ComputePipeline>>>,
    pool: Pool,
    counters: Counters,
    /// Images whose affinities have not been read back yet, and their largest number so far.
    flights: [AtomicUsize; 2],
    /// The first error of the driver.
    failure: Arc<OnceLock<String>>,
}

impl Gpu {
    /// Returns the GPU of a kind. It is opened once per process, and reopened after a failure.
    ///
    /// # Errors
    /// As for [`Gpu::open`], and a process that was forked after it opened one.
    pub fn shared(adapter: Adapter) -> Result<Self, GpuError> {
        static OPENED: Mutex<Vec<(Adapter, Gpu)>> = Mutex::new(Vec::new());
        static PROCESS: OnceLock<u32> = OnceLock::new();
        if *PROCESS.get_or_init(std::process::id) != std::process::id() {
            return Err(GpuError::Forked);
        }
        let mut opened = OPENED.lock().unwrap_or_else(PoisonError::into_inner);
        opened.retain(|(_, gpu)| gpu.check().is_ok());
        if let Some((_, gpu)) = opened.iter().find(|(known, _)| *known == adapter) {
            return Ok(gpu.clone());
        }
        let gpu = Self::open(adapter)?;
        opened.push((adapter, gpu.clone()));
        Ok(gpu)
    }

    /// Opens a GPU.
    ///
    /// # Errors
    /// No adapter of this kind exists, or it does not meet the default limits of WebGPU.
    pub fn open(adapter: Adapter) -> Result<Self, GpuError> {
        let instance = Instance::new(InstanceDescriptor::new_without_display_handle());
        let backends = wgpu::Backends::PRIMARY;
        let all = ready(instance.enumerate_adapters(backends)).unwrap_or_default();
        let kind = |adapter: &wgpu::Adapter| adapter.get_info().device_type;
        let of = |wanted: DeviceType, number: usize| {
            let mut some = all.iter().filter(|found| kind(found) == wanted);
            some.nth(number)
        };
        let found = match adapter {
            Adapter::Discrete(number) => of(DeviceType::DiscreteGpu, number),
            Adapter::Integrated => of(DeviceType::IntegratedGpu, 0),
            Adapter::Software => of(DeviceType::Cpu, 0),
            Adapter::Best => [
                DeviceType::DiscreteGpu,
                DeviceType::IntegratedGpu,
                DeviceType::VirtualGpu,
                DeviceType::Other,
                DeviceType::Cpu,
            ]
            .into_iter()
            .find_map(|kind| of(kind, 0)),
        };
        let Some(found) = found else {
            let names: Vec<String> = all.iter().map(|found| found.get_info().name).collect();
            return Err(GpuError::Missing {
                wanted: adapter,
                found: if names.is_empty() {
                    "none".to_owned()
                } else {
                    names.join(", ")
                },
            });
        };
        Self::of(found)
    }

    fn of(adapter: &wgpu::Adapter) -> Result<Self, GpuError> {
        let name = adapter.get_info().name;
        let available = adapter.limits();
        // Images much larger than those of training need buffers beyond the default limits.
        let required_limits = Limits {
            max_storage_buffer_binding_size: available.max_storage_buffer_binding_size,
            max_buffer_size: available.max_buffer_size,
            ..Limits::default()
        };
        let descriptor = DeviceDescriptor {
            label: Some("lsdc"),
            required_limits,
            ..DeviceDescriptor::default()
        };
        let opened = ready(adapter.request_device(&descriptor));
        let refused = |why: String| GpuError::Refused {
            name: name.clone(),
            why,
        };
        let (device, queue) = opened
            .ok_or_else(|| refused("the driver does not answer".to_owned()))?
            .map_err(|error| refused(error.to_string()))?;
        let failure = Arc::new(OnceLock::new());
        let first = failure.clone();
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            // Later errors follow from the first.
            let _ = first.set(error.to_string());
        }));
        let bindings = Bindings::new(&device);
        Ok(Self(Arc::new(Inner {
            name,
            device,
            queue,
            bindings,
            kernels: Mutex::default(),
            pool: Pool::default(),
            counters: Counters::default(),
            flights: [const { AtomicUsize::new(0) }; 2],
            failure,
        })))
    }

    /// Name reported by the driver.
    pub fn name(&self) -> &str {
        &self.0.name
    }

    /// Launches and transfers since the device was opened, by part.
    pub fn traffic(&self) -> [(Part, Traffic); Part::ALL.len()] {
        self.0.counters.all()
    }

    /// Largest number of images in flight at once since the device was opened.
    pub fn most_in_flight(&self) -> usize {
        self.0.flights[1].load(Ordering::Relaxed)
    }

    /// Counts an image as in flight until the returned value is dropped.
    pub(crate) fn in_flight(&self) -> InFlight {
        let [now, most] = &self.0.flights;
        let count = now.fetch_add(1, Ordering::Relaxed) + 1;
        most.fetch_max(count, Ordering::Relaxed);
        InFlight(self.clone())
    }

    pub(crate) fn device(&self) -> &wgpu::Device {
        &self.0.device
    }

    pub(crate) fn bindings(&self) -> &Bindings {
        &self.0.bindings
    }

    pub(crate) fn pool(&self) -> &Pool {
        &self.0.pool
    }

    pub(crate) fn count(&self, part: Part, more: Traffic) {
        self.0.counters.add(part, more);
    }

    /// Returns a compiled kernel.
    pub(crate) fn kernel(&self, kernel: &Kernel) -> Arc<ComputePipeline> {
        let kernels = &self.0.kernels;
        let mut kernels = kernels.lock().unwrap_or_else(PoisonError::into_inner);
        let compiled = kernels
            .entry(kernel.clone())
            .or_insert_with(|| Arc::new(kernel.compile(&self.0.device, &self.0.bindings)));
        compiled.clone()
    }

    /// Writes values to a buffer, before the next submission.
    pub(crate) fn upload(&self, part: Part, buffer: &wgpu::Buffer, offset: u64, bytes: &[u8]) {
        self.0.queue.write_buffer(buffer, offset, bytes);
        let more = Traffic {
            uploads: 1,
            bytes_up: bytes.len() as u64,
            ..Traffic::default()
        };
        self.count(part, more);
    }

    /// Records and submits work.
    pub(crate) fn submit(
        &self,
        part: Part,
        record: impl FnOnce(&mut CommandEncoder) -> u64,
    ) -> SubmissionIndex {
        let descriptor = CommandEncoderDescriptor { label: None };
        let mut encoder = self.0.device.create_command_encoder(&descriptor);
        let launches = record(&mut encoder);
        let more = Traffic {
            launches,
            submissions: 1,
            ..Traffic::default()
        };
        self.count(part, more);
        self.0.queue.submit([encoder.finish()])
    }

    /// Returns a staging buffer for a read-back.
    pub(crate) fn staging(&self, bytes: u64) -> Pooled {
        let usage = BufferUsages::MAP_READ | BufferUsages::COPY_DST;
        self.0.pool.take(&self.0.device, bytes, usage)
    }

    /// Waits for values. If the driver has failed they are NaN, which fits and maps report as an error.
    pub(crate) fn wait(&self, part: Part, pending: Pending) -> Vec<f32> {
        let waited = self.0.device.poll(PollType::Wait {
            submission_index: Some(pending.after.clone()),
            timeout: None,
        });
        let more = Traffic {
            readbacks: 1,
            bytes_down: pending.bytes,
            ..Traffic::default()
        };
        self.count(part, more);
        if let Err(error) = &waited {
            let _ = self.0.failure.set(error.to_string());
        } else if !pending.mapped.load(Ordering::Acquire) {
            let _ = self.0.failure.set("results cannot be read".to_owned());
        }
        let sound = self.0.failure.get().is_none();
        match sound.then(|| pending.staging.get_mapped_range(0..pending.bytes)) {
            Some(Ok(range)) => bytemuck::pod_collect_to_vec(&range),
            _ => vec![f32::NAN; pending.bytes as usize / 4],
        }
    }

    /// Checks that everything submitted so far has succeeded.
    ///
    /// # Errors
    /// The first failure of the driver, for example a lost device.
    pub(crate) fn check(&self) -> Result<(), SettingsError> {
        let Some(failure) = self.0.failure.get() else {
            return Ok(());
        };
        let message = format!("the GPU `{}` has failed: {failure}", self.0.name);
        Err(SettingsError::new(message).with_hint("use the CPU, or open the GPU again"))
    }
}

/// An image in flight.
#[derive(Debug)]
pub(crate) struct InFlight(Gpu);

impl Drop for InFlight {
    fn drop(&mut self) {
        self.0.0.flights[0].fetch_sub(1, Ordering::Relaxed);
    }
}

/// A pending read-back.
#[derive(Debug)]
pub(crate) struct Pending {
    staging: Pooled,
    bytes: u64,
    after: SubmissionIndex,
    mapped: Arc<AtomicBool>,
}

impl Pending {
    /// Requests the first `count` floats of a staging buffer, after a submission has written them.
    pub(crate) fn new(staging: Pooled, count: usize, after: SubmissionIndex) -> Self {
        let mapped = Arc::new(AtomicBool::new(false));
        let done = mapped.clone();
        let bytes = 4 * count as u64;
        staging.map_async(MapMode::Read, 0..bytes, move |result| {
            done.store(result.is_ok(), Ordering::Release);
        });
        Self {
            staging,
            bytes,
            after,
            mapped,
        }
    }
}

impl Drop for Pending {
    fn drop(&mut self) {
        // Also without a wait, because the buffer is reused.
        self.staging.unmap();
    }
}

/// Returns the value of a future that is complete at once, as those of native drivers are.
fn ready<T>(future: impl Future<Output = T>) -> Option<T> {
    match pin!(future).poll(&mut Context::from_waker(Waker::noop())) {
        Poll::Ready(value) => Some(value),
        Poll::Pending => None,
    }
}
