//! The state on the device: parameters, moments, step counts, classifier. It survives every resize.

use crate::gpu::Gpu;
use crate::kernels::{CORRECTIONS, classifier_vectors};
use crate::rows::{DEVICE_ROW, to_device, to_host};
use rayon::prelude::*;
use sms_gaussians::parameters::{ClassifierState, Parameters, Row, classifier_len};
use wgpu::BufferUsages;

/// Words of the control buffer; see `shaders/common.wgsl`.
pub(crate) const CONTROL_WORDS: usize = 12;
pub(crate) const PAIRS: usize = 1;
pub(crate) const OVERFLOWED: usize = 2;
pub(crate) const PAIRS_WANTED: usize = 3;
pub(crate) const STEPS_DONE: usize = 5;
const CLASSIFIER_STEPS: usize = 6;
const CLASSIFIER_STEPS_NEXT: usize = 7;

/// Bytes of one Gaussian's parameters.
pub(crate) const ROW_BYTES: u64 = 4 * DEVICE_ROW as u64;

pub(crate) struct Store {
    /// Number of Gaussians.
    pub(crate) count: usize,
    /// Capacity in Gaussians.
    pub(crate) capacity: usize,
    pub(crate) rows: wgpu::Buffer,
    /// For each Gaussian, first moments, then second.
    pub(crate) moments: wgpu::Buffer,
    pub(crate) steps: wgpu::Buffer,
    /// Targets of the next compaction: rows, moments, steps of the same capacity.
    spare: Option<[wgpu::Buffer; 3]>,
    pub(crate) classes: usize,
    pub(crate) classifier: wgpu::Buffer,
    /// First moments, then second.
    pub(crate) classifier_moments: wgpu::Buffer,
    pub(crate) corrections: wgpu::Buffer,
    pub(crate) control: wgpu::Buffer,
}

/// Adam's corrections 1/(1 − βᵗ) for t steps, computed as on the CPU.
fn corrections() -> Vec<[f32; 2]> {
    let of = |t: u32| [0.9f32, 0.999].map(|beta| 1.0 / (1.0 - beta.powi(t as i32)));
    let mut table: Vec<_> = (0..CORRECTIONS).map(of).collect();
    // Unused: step counts start at 1.
    table[0] = [1.0; 2];
    table
}

impl Store {
    pub(crate) fn new(gpu: &Gpu, classes: usize) -> Self {
        let bytes = 16 * u64::from(classifier_vectors(classes));
        let [rows, moments, steps] = Self::fresh(gpu, 0);
        Self {
            count: 0,
            capacity: 0,
            rows,
            moments,
            steps,
            spare: None,
            classes,
            classifier: gpu.buffer("classifier", bytes, BufferUsages::UNIFORM),
            classifier_moments: gpu.buffer("classifier moments", 2 * bytes, BufferUsages::empty()),
            corrections: gpu.upload(
                "corrections",
                bytemuck::cast_slice(&corrections()),
                BufferUsages::STORAGE,
            ),
            control: gpu.buffer("control", 4 * CONTROL_WORDS as u64, BufferUsages::empty()),
        }
    }

    /// Creates additional buffers for `capacity` Gaussians: rows, moments, steps.
    fn fresh(gpu: &Gpu, capacity: usize) -> [wgpu::Buffer; 3] {
        let n = capacity as u64;
        let none = BufferUsages::empty();
        [
            gpu.buffer("rows", n * ROW_BYTES, none),
            gpu.buffer("moments", 2 * n * ROW_BYTES, none),
            gpu.buffer("steps", 4 * n, none),
        ]
    }

    /// Returns buffers with the capacity of the present ones and undefined contents.
    pub(crate) fn take_spare(&mut self, gpu: &Gpu) -> [wgpu::Buffer; 3] {
        self.spare.take().unwrap_or_else(|| Self::fresh(gpu, self.capacity))
    }

    /// Replaces the present buffers by those of [`Store::take_spare`] with `count` Gaussians.
    pub(crate) fn replace(&mut self, [rows, moments, steps]: [wgpu::Buffer; 3], count: usize) {
        let rows = std::mem::replace(&mut self.rows, rows);
        let moments = std::mem::replace(&mut self.moments, moments);
        let steps = std::mem::replace(&mut self.steps, steps);
        self.spare = Some([rows, moments, steps]);
        self.count = count;
    }

    /// Grows to `capacity` Gaussians and keeps the present ones.
    pub(crate) fn reserve(&mut self, gpu: &Gpu, capacity: usize) {
        if capacity <= self.capacity {
            return;
        }
        let capacity = capacity.max(self.capacity + self.capacity / 2);
        self.spare = None;
        let [rows, moments, steps] = Self::fresh(gpu, capacity);
        let n = self.count as u64;
        if n > 0 {
            let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            encoder.copy_buffer_to_buffer(&self.rows, 0, &rows, 0, n * ROW_BYTES);
            encoder.copy_buffer_to_buffer(&self.moments, 0, &moments, 0, 2 * n * ROW_BYTES);
            encoder.copy_buffer_to_buffer(&self.steps, 0, &steps, 0, 4 * n);
            gpu.queue.submit([encoder.finish()]);
        }
        (self.rows, self.moments, self.steps, self.capacity) = (rows, moments, steps, capacity);
    }

    /// Appends Gaussians with zeroed moments; the capacity must suffice.
    pub(crate) fn append(&mut self, gpu: &Gpu, rows: &[Row]) {
        let words: Vec<_> = rows.par_iter().map(to_device).collect();
        let (at, n) = (self.count as u64, rows.len() as u64);
        gpu.queue.write_buffer(&self.rows, at * ROW_BYTES, bytemuck::cast_slice(&words));
        let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encoder.clear_buffer(&self.moments, 2 * at * ROW_BYTES, Some(2 * n * ROW_BYTES));
        encoder.clear_buffer(&self.steps, 4 * at, Some(4 * n));
        gpu.queue.submit([encoder.finish()]);
        self.count += rows.len();
    }

    /// Replaces everything.
    pub(crate) fn set(&mut self, gpu: &Gpu, parameters: &Parameters) {
        self.count = 0;
        self.reserve(gpu, parameters.rows.len());
        let rows: Vec<_> = parameters.rows.par_iter().map(to_device).collect();
        let both = parameters.first.par_iter().zip(&parameters.second);
        let moments: Vec<_> = both.map(|(first, second)| [to_device(first), to_device(second)]).collect();
        gpu.queue.write_buffer(&self.rows, 0, bytemuck::cast_slice(&rows));
        gpu.queue.write_buffer(&self.moments, 0, bytemuck::cast_slice(&moments));
        gpu.queue.write_buffer(&self.steps, 0, bytemuck::cast_slice(&parameters.steps));
        self.count = parameters.rows.len();
        self.set_classifier(gpu, &parameters.classifier);
    }

    /// Replaces the classifier, and clears the flags of earlier steps.
    pub(crate) fn set_classifier(&self, gpu: &Gpu, state: &ClassifierState) {
        let length = 4 * classifier_vectors(self.classes) as usize;
        let padded = |values: &[f32]| {
            let mut values = values.to_vec();
            values.resize(length, 0.0);
            values
        };
        gpu.queue.write_buffer(&self.classifier, 0, bytemuck::cast_slice(&padded(&state.values)));
        let moments = [padded(&state.first), padded(&state.second)].concat();
        gpu.queue.write_buffer(&self.classifier_moments, 0, bytemuck::cast_slice(&moments));
        let mut control = [0; CONTROL_WORDS];
        (control[CLASSIFIER_STEPS], control[CLASSIFIER_STEPS_NEXT]) = (state.steps, state.steps);
        gpu.queue.write_buffer(&self.control, 0, bytemuck::cast_slice(&control));
    }

    /// The whole state; `None` after a failure.
    pub(crate) fn read(&self, gpu: &Gpu) -> Option<Parameters> {
        let n = self.count as u64;
        let classifier = self.classifier.size();
        let parts = [
            (&self.rows, n * ROW_BYTES),
            (&self.moments, 2 * n * ROW_BYTES),
            (&self.steps, 4 * n),
            (&self.classifier, classifier),
            (&self.classifier_moments, 2 * classifier),
            (&self.control, 4 * CONTROL_WORDS as u64),
        ];
        gpu.read_with(parts, |[rows, moments, steps, values, value_moments, control]| {
            let length = classifier_len(self.classes);
            let padded = 4 * classifier_vectors(self.classes) as usize;
            let rows: &[[f32; DEVICE_ROW]] = bytemuck::cast_slice(rows);
            let moments: &[[[f32; DEVICE_ROW]; 2]] = bytemuck::cast_slice(moments);
            let (values, value_moments): (&[f32], &[f32]) =
                (bytemuck::cast_slice(values), bytemuck::cast_slice(value_moments));
            let control: &[u32] = bytemuck::cast_slice(control);
            Parameters {
                rows: rows.par_iter().map(to_host).collect(),
                first: moments.par_iter().map(|[first, _]| to_host(first)).collect(),
                second: moments.par_iter().map(|[_, second]| to_host(second)).collect(),
                steps: bytemuck::cast_slice(steps).to_vec(),
                classifier: ClassifierState {
                    classes: self.classes,
                    values: values[..length].to_vec(),
                    first: value_moments[..length].to_vec(),
                    second: value_moments[padded..padded + length].to_vec(),
                    steps: control[CLASSIFIER_STEPS_NEXT],
                },
            }
        })
    }

    /// Bytes on the device.
    pub(crate) fn bytes(&self) -> u64 {
        let buffers = [
            &self.rows,
            &self.moments,
            &self.steps,
            &self.classifier,
            &self.classifier_moments,
            &self.corrections,
            &self.control,
        ];
        buffers.into_iter().chain(self.spare.iter().flatten()).map(|b| b.size()).sum()
    }
}
