//! Adapters, the device, and transfers to and from it.

use std::sync::{Arc, Mutex, OnceLock, PoisonError, mpsc};
use wgpu::BufferUsages;

/// Errors of finding and opening a device.
#[derive(Debug, thiserror::Error)]
pub enum GpuError {
    /// There is no adapter, or none that is a GPU.
    #[error("no GPU was found{0}")]
    NoAdapter(String),
    /// The adapter named does not exist.
    #[error("there is no adapter {index} among {count}")]
    NoSuchAdapter {
        /// The requested index.
        index: usize,
        /// Number of adapters.
        count: usize,
    },
    /// The adapter cannot run the kernels.
    #[error("{name} cannot be used: {reason}")]
    Unsuitable {
        /// The adapter.
        name: String,
        /// The missing feature.
        reason: String,
    },
    /// The kernels disagree with the CPU.
    #[error("the results of {name} differ from the CPU's: {difference}")]
    SelfCheck {
        /// The adapter.
        name: String,
        /// The difference and its size.
        difference: String,
    },
    /// The scan has more classes than the kernels are made for.
    #[error("{classes} classes exceed the limit of the GPU's kernels, {most}")]
    TooManyClasses {
        /// Classes of the scan.
        classes: usize,
        /// The limit.
        most: usize,
    },
}

/// Which adapter to use.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum AdapterChoice {
    /// The first discrete GPU, else the first integrated or virtual one; never software on the CPU.
    #[default]
    Best,
    /// The adapter with this index in [`adapters`], software included.
    Index(usize),
}

/// One adapter of this machine.
#[derive(Debug, Clone, PartialEq)]
pub struct AdapterSummary {
    /// Its index, for [`AdapterChoice::Index`].
    pub index: usize,
    /// Its name, such as `NVIDIA H200`.
    pub name: String,
    /// Driver and its version.
    pub driver: String,
    /// Interface, such as `vulkan`.
    pub backend: String,
    /// Whether it computes on the CPU (Mesa's lavapipe): slower than the CPU's own kernels, good for tests.
    pub software: bool,
}

/// The only instance of this process: after a dozen instances, an NVIDIA driver reported no adapters any more.
fn instance() -> &'static wgpu::Instance {
    static INSTANCE: OnceLock<wgpu::Instance> = OnceLock::new();
    INSTANCE.get_or_init(|| {
        wgpu::Instance::new(wgpu::InstanceDescriptor {
            backends: wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12,
            ..wgpu::InstanceDescriptor::new_without_display_handle()
        })
    })
}

fn all_adapters() -> Vec<wgpu::Adapter> {
    pollster::block_on(instance().enumerate_adapters(wgpu::Backends::all()))
}

/// The adapters of this machine.
pub fn adapters() -> Vec<AdapterSummary> {
    all_adapters().iter().enumerate().map(|(index, adapter)| summary(index, adapter)).collect()
}

fn summary(index: usize, adapter: &wgpu::Adapter) -> AdapterSummary {
    let info = adapter.get_info();
    AdapterSummary {
        index,
        driver: format!("{} {}", info.driver, info.driver_info).trim().to_owned(),
        backend: info.backend.to_string(),
        software: info.device_type == wgpu::DeviceType::Cpu,
        name: info.name,
    }
}

/// The first failure of a device, if any.
type Failure = Arc<Mutex<Option<String>>>;

/// An open device.
pub(crate) struct Gpu {
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
    pub(crate) summary: AdapterSummary,
    pub(crate) limits: wgpu::Limits,
    /// Nanoseconds per unit of a timestamp, if the device has timestamps.
    pub(crate) timestamp_ns: Option<f32>,
    failure: Failure,
    /// Reused staging buffer: its pages are mapped once.
    reading: Mutex<Option<wgpu::Buffer>>,
}

fn note(failure: &Failure, text: String) {
    failure.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(text);
}

/// Largest number of storage buffers that a kernel binds, including the one of a frame.
const STORAGE_BUFFERS: u32 = 9;
/// Bytes of workgroup memory that the kernels use at most.
const WORKGROUP_BYTES: u32 = 32_768;

impl Gpu {
    pub(crate) fn open(choice: AdapterChoice) -> Result<Self, GpuError> {
        let adapters = all_adapters();
        let rank = |adapter: &wgpu::Adapter| match adapter.get_info().device_type {
            wgpu::DeviceType::DiscreteGpu => Some(0),
            wgpu::DeviceType::IntegratedGpu => Some(1),
            wgpu::DeviceType::VirtualGpu => Some(2),
            wgpu::DeviceType::Other | wgpu::DeviceType::Cpu => None,
        };
        let count = adapters.len();
        let index = match choice {
            AdapterChoice::Index(index) if index < count => index,
            AdapterChoice::Index(index) => return Err(GpuError::NoSuchAdapter { index, count }),
            AdapterChoice::Best => {
                let ranked = (0..count).filter_map(|i| rank(&adapters[i]).map(|rank| (rank, i)));
                let none = if count == 0 { "" } else { ", only software on the CPU" };
                ranked.min().ok_or_else(|| GpuError::NoAdapter(none.to_owned()))?.1
            }
        };
        Self::open_adapter(index, &adapters[index])
    }

    fn open_adapter(index: usize, adapter: &wgpu::Adapter) -> Result<Self, GpuError> {
        let summary = summary(index, adapter);
        let unsuitable = |reason: String| GpuError::Unsuitable { name: summary.name.clone(), reason };
        let limits = adapter.limits();
        if limits.max_storage_buffers_per_shader_stage < STORAGE_BUFFERS {
            return Err(unsuitable(format!(
                "it binds {} buffers at once, but {STORAGE_BUFFERS} are needed",
                limits.max_storage_buffers_per_shader_stage
            )));
        }
        if limits.max_compute_workgroup_storage_size < WORKGROUP_BYTES {
            return Err(unsuitable("it has too little workgroup memory".to_owned()));
        }
        let features = adapter.features() & wgpu::Features::TIMESTAMP_QUERY;
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("sms"),
            required_features: features,
            required_limits: limits.clone(),
            ..Default::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|error| unsuitable(error.to_string()))?;
        let failure = Failure::default();
        let lost = failure.clone();
        device.set_device_lost_callback(move |reason, text| {
            note(&lost, format!("the device was lost ({reason:?}) {text}").trim().to_owned());
        });
        let uncaptured = failure.clone();
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| note(&uncaptured, error.to_string())));
        let timestamp_ns =
            features.contains(wgpu::Features::TIMESTAMP_QUERY).then(|| queue.get_timestamp_period());
        Ok(Self { device, queue, summary, limits, timestamp_ns, failure, reading: Mutex::default() })
    }

    /// Returns the first failure, if any. The contents of the device are invalid afterwards.
    pub(crate) fn failure(&self) -> Option<String> {
        self.failure.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub(crate) fn fail(&self, text: String) {
        note(&self.failure, text);
    }

    fn create(&self, label: &str, size: u64, usage: BufferUsages) -> wgpu::Buffer {
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size,
            usage,
            mapped_at_creation: false,
        })
    }

    /// A zeroed buffer of at least `bytes`, for kernels and copies.
    pub(crate) fn buffer(&self, label: &str, bytes: u64, more: BufferUsages) -> wgpu::Buffer {
        let size = bytes.next_multiple_of(16).max(16);
        if size > self.limits.max_storage_buffer_binding_size.min(self.limits.max_buffer_size) {
            self.fail(format!("{label} needs {size} bytes, more than the device binds at once"));
            return self.buffer(label, 16, more);
        }
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC | BufferUsages::COPY_DST | more;
        self.create(label, size, usage)
    }

    /// A buffer that kernels only read.
    pub(crate) fn upload(&self, label: &str, contents: &[u8], usage: BufferUsages) -> wgpu::Buffer {
        let buffer = self.create(label, (contents.len() as u64).max(16), usage | BufferUsages::COPY_DST);
        self.queue.write_buffer(&buffer, 0, contents);
        buffer
    }

    /// A buffer that the host reads.
    pub(crate) fn staging(&self, bytes: u64) -> wgpu::Buffer {
        let size = bytes.next_multiple_of(16).max(16);
        self.create("staging", size, BufferUsages::MAP_READ | BufferUsages::COPY_DST)
    }

    /// Applies `see` to the first `bytes` of a staging buffer once all submitted work is done; `None` after a
    /// failure.
    pub(crate) fn read_staging<T>(
        &self,
        staging: &wgpu::Buffer,
        bytes: u64,
        see: impl FnOnce(&[u8]) -> T,
    ) -> Option<T> {
        let (sender, receiver) = mpsc::channel();
        staging.map_async(wgpu::MapMode::Read, ..bytes, move |result| {
            let _ = sender.send(result.is_ok());
        });
        if let Err(error) = self.device.poll(wgpu::PollType::wait_indefinitely()) {
            self.fail(error.to_string());
            return None;
        }
        if !receiver.recv().unwrap_or(false) || self.failure().is_some() {
            self.fail("results could not be read back".to_owned());
            return None;
        }
        let seen = see(&staging.get_mapped_range(..bytes).ok()?);
        staging.unmap();
        Some(seen)
    }

    /// Applies `see` to the first `bytes` (a multiple of four) of each buffer without copying them, because a copy of
    /// the state takes as long as several steps. `None` after a failure.
    pub(crate) fn read_with<T, const N: usize>(
        &self,
        parts: [(&wgpu::Buffer, u64); N],
        see: impl FnOnce([&[u8]; N]) -> T,
    ) -> Option<T> {
        let total: u64 = parts.iter().map(|(_, bytes)| bytes).sum();
        let mut kept = self.reading.lock().unwrap_or_else(PoisonError::into_inner);
        if kept.as_ref().is_none_or(|buffer| buffer.size() < total) {
            *kept = Some(self.staging(total + total / 4));
        }
        let staging = kept.as_ref()?;
        let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let mut at = 0;
        for (buffer, bytes) in parts.iter().filter(|(_, bytes)| *bytes > 0) {
            encoder.copy_buffer_to_buffer(buffer, 0, staging, at, *bytes);
            at += bytes;
        }
        self.queue.submit([encoder.finish()]);
        self.read_staging(staging, total, |all| {
            let mut rest = all;
            see(parts.map(|(_, bytes)| {
                let (part, after) = rest.split_at(bytes as usize);
                rest = after;
                part
            }))
        })
    }
}
