//! [`GpuTrainer`]: the back end of the scan on a GPU.

use crate::gpu::{AdapterChoice, AdapterSummary, Gpu, GpuError};
use crate::kernels::{ComputeKernel, GAUSSIANS, Kernels};
use crate::maps::maps_of;
use crate::rows::ROW_VECTORS;
use crate::steps::{Dispatch, of_step, of_view, record, segment_groups, submit, timed};
use crate::store::{CONTROL_WORDS, OVERFLOWED, PAIRS, PAIRS_WANTED, STEPS_DONE, Store};
use crate::target::DeviceTarget;
use crate::uniforms::{STRIDE, Step};
use crate::work::{BATCH, Room, STATS, StepBuffers, bind};
use glamx::Vec3;
use rayon::prelude::*;
use sms_core::{Camera, Seed};
use sms_gaussians::parameters::{Parameters, Row, sigmoid};
use sms_gaussians::{
    FrameId, GaussianModel, LearningRates, LossTerms, RenderedMaps, Seedling, StepBatch, StepStats,
    TrainConfig, TrainFrame, TrainState, Trainer, TrainerError,
};

/// Greatest number of classes supported by the kernels.
pub const MAX_CLASSES: usize = 48;

/// Initial capacity in pairs of splat and tile per Gaussian.
const PAIRS_PER_GAUSSIAN: u32 = 12;
/// Number of steps recorded and submitted together.
const TOGETHER: usize = 8;
/// Greatest number of maps kept for reuse.
const SPARE_MAPS: usize = 16;
/// Least capacity in pairs.
const PAIRS_MIN: u32 = 1 << 14;

/// [`Trainer`] on a GPU: whole training steps run on the device, up to 64 per submission. Only the losses are read back
/// at the end.
///
/// State, settings and semantics are those of [`sms_gaussians::CpuTrainer`]; results differ by rounding. After a
/// failure of the device (see [`Trainer::failure`]) every call returns quickly with meaningless results.
pub struct GpuTrainer {
    gpu: Gpu,
    kernels: Kernels,
    config: TrainConfig,
    background: [f32; 3],
    store: Store,
    work: StepBuffers,
    targets: Vec<DeviceTarget>,
    /// Bind group of each target, `None` if outdated.
    views: Vec<Option<wgpu::BindGroup>>,
    /// Observed view for calls that only render.
    nothing: wgpu::Buffer,
    staging: wgpu::Buffer,
    /// Number of pairs needed by the last batches.
    pairs_wanted: u32,
    /// Pairs of the last step.
    last_pairs: u32,
    /// Maps for reuse.
    spare_maps: Vec<RenderedMaps>,
}

impl GpuTrainer {
    /// A trainer without Gaussians for `classes` classes, the background included; the classifier starts from
    /// `seed`, as in [`sms_gaussians::CpuTrainer::new`]. The kernels are not checked: see
    /// [`crate::checked_trainer`].
    ///
    /// # Errors
    /// [`GpuError`] if the adapter cannot be opened or cannot run the kernels.
    pub fn new(
        config: &TrainConfig,
        classes: usize,
        seed: Seed,
        choice: AdapterChoice,
    ) -> Result<Self, GpuError> {
        Self::with_kernels(config, classes, seed, choice, false)
    }

    /// Like [`GpuTrainer::new`], with guarded kernels for comparison or without guards.
    pub(crate) fn with_kernels(
        config: &TrainConfig,
        classes: usize,
        seed: Seed,
        choice: AdapterChoice,
        guarded: bool,
    ) -> Result<Self, GpuError> {
        let classes = classes.max(1);
        if classes > MAX_CLASSES {
            return Err(GpuError::TooManyClasses { classes, most: MAX_CLASSES });
        }
        let gpu = Gpu::open(choice)?;
        let kernels = Kernels::new(&gpu, classes, guarded);
        if let Some(reason) = gpu.failure() {
            return Err(GpuError::Unsuitable { name: gpu.summary.name.clone(), reason });
        }
        let store = Store::new(&gpu, classes);
        store.set_classifier(&gpu, &Parameters::new(classes, seed).classifier);
        let work = StepBuffers::new(&gpu, classes);
        let nothing = gpu.upload("nothing", &[], wgpu::BufferUsages::STORAGE);
        let staging = gpu.staging(4 * (CONTROL_WORDS + STATS * BATCH) as u64);
        Ok(Self {
            gpu,
            kernels,
            config: *config,
            background: [0.0; 3],
            store,
            work,
            targets: Vec::new(),
            views: Vec::new(),
            nothing,
            staging,
            pairs_wanted: PAIRS_MIN,
            last_pairs: 0,
            spare_maps: Vec::new(),
        })
    }

    /// Returns the adapter in use.
    pub fn adapter(&self) -> &AdapterSummary {
        &self.gpu.summary
    }

    /// Returns the bytes of all buffers on the device: the state, the buffers of steps, and the observed views.
    pub fn device_bytes(&self) -> u64 {
        self.store.bytes() + self.work.bytes() + self.targets.iter().map(|t| t.words.size()).sum::<u64>()
    }

    /// Returns the pairs of splat and tile in the last step or rendered view, which determine most of a step's
    /// time.
    pub fn last_pairs(&self) -> u32 {
        self.last_pairs
    }

    /// Takes one step on `frame`, kernel by kernel, and returns each one's milliseconds in the order of a step;
    /// `None` without timestamps on the device.
    ///
    /// # Panics
    /// If the frame was not added.
    pub fn timed_step(&mut self, frame: FrameId) -> Option<Vec<(&'static str, f64)>> {
        self.prepare(&[frame]);
        let step = self.step_of(frame, &self.config.rates, 0);
        self.gpu.queue.write_buffer(&self.work.uniforms, 0, bytemuck::bytes_of(&step));
        let Self { gpu, kernels, work, store, views, .. } = self;
        let bindings = work.bindings(gpu, kernels, store);
        let times = timed(gpu, &of_step(kernels, bindings, &step), views[frame].as_ref()?);
        self.reset_flags();
        times
    }

    /// Prepares buffers and bind groups for steps on these frames.
    fn prepare(&mut self, frames: &[FrameId]) {
        let mut room = self.room_for_gaussians();
        for &frame in frames {
            let camera = &self.targets[frame].camera;
            room.tiles = room.tiles.max(camera.tiles());
            room.pixels = room.pixels.max(camera.pixels() as u32);
        }
        self.work.reserve(&self.gpu, self.store.classes, &room);
        for &frame in frames {
            if self.views[frame].is_none() {
                let view = self.work.bind_view(&self.gpu, &self.kernels, &self.targets[frame].words);
                self.views[frame] = Some(view);
            }
        }
    }

    fn room_for_gaussians(&mut self) -> Room {
        let gaussians = self.store.count as u32;
        if self.pairs_wanted >= PAIRS_MIN {
            self.pairs_wanted = self.pairs_wanted.max(gaussians.saturating_mul(PAIRS_PER_GAUSSIAN));
        }
        Room { gaussians, pairs: self.pairs_wanted, ..Room::default() }
    }

    /// Returns the uniforms of a step on `frame`, at `index` in its submission.
    fn step_of(&self, frame: FrameId, rates: &LearningRates, index: usize) -> Step {
        let target = &self.targets[frame];
        let config = TrainConfig { rates: *rates, ..self.config };
        self.completed(target.camera.trained(&config, &target.pixels), index)
    }

    fn completed(&self, mut step: Step, index: usize) -> Step {
        let [r, g, b] = self.background;
        step.background = [r, g, b, 0.0];
        step.counts[0] = self.store.count as u32;
        step.counts[1] = self.work.room.pairs;
        step.counts[2] = index as u32;
        step.groups[2] = segment_groups(&step);
        step.groups[3] = self.work.partial_stride;
        step
    }

    /// Submits steps, at most [`BATCH`], a few at a time so that the device starts while the rest is recorded.
    /// `None` after a failure.
    fn submit(&mut self, planned: &[PlannedStep]) -> Option<()> {
        let frames: Vec<FrameId> = planned.iter().map(|p| p.frame).collect();
        self.prepare(&frames);
        let steps: Vec<Step> =
            planned.iter().enumerate().map(|(i, p)| self.step_of(p.frame, &p.rates, i)).collect();
        let mut uniforms = vec![0u8; STRIDE as usize * steps.len()];
        for (to, step) in uniforms.chunks_exact_mut(STRIDE as usize).zip(&steps) {
            to[..size_of::<Step>()].copy_from_slice(bytemuck::bytes_of(step));
        }
        self.gpu.queue.write_buffer(&self.work.uniforms, 0, &uniforms);
        let Self { gpu, kernels, work, store, views, staging, .. } = self;
        let (control_bytes, stats_bytes) = result_bytes(steps.len());
        for first in (0..steps.len()).step_by(TOGETHER) {
            let end = (first + TOGETHER).min(steps.len());
            let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            {
                let bindings = work.bindings(gpu, kernels, store);
                let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
                for i in first..end {
                    let view = views[frames[i]].as_ref()?;
                    record(&mut pass, &of_step(kernels, bindings, &steps[i]), view, i);
                }
            }
            if end == steps.len() {
                encoder.copy_buffer_to_buffer(&store.control, 0, staging, 0, control_bytes);
                encoder.copy_buffer_to_buffer(&work.stats, 0, staging, control_bytes, stats_bytes);
            }
            gpu.queue.submit([encoder.finish()]);
        }
        Some(())
    }

    /// Waits for the last submission, adds its terms to the sums and returns the number of steps taken: fewer if
    /// the capacity in pairs was too small; it is then increased. `None` after a failure.
    fn collect(&mut self, planned: &[PlannedStep], sums: &mut [LossTerms]) -> Option<usize> {
        let (control_bytes, stats_bytes) = result_bytes(planned.len());
        let (control, stats): (Vec<u32>, Vec<f32>) =
            self.gpu.read_staging(&self.staging, control_bytes + stats_bytes, |bytes| {
                let (control, stats) = bytes.split_at(control_bytes as usize);
                (bytemuck::pod_collect_to_vec(control), bytemuck::pod_collect_to_vec(stats))
            })?;
        let done = (control[STEPS_DONE] as usize).min(planned.len());
        for (planned, stats) in planned.iter().zip(stats.chunks_exact(STATS)).take(done) {
            if let Some(batch) = planned.batch {
                sums[batch].add(&self.terms(planned.frame, stats), 1.0);
            }
        }
        self.after(&control);
        Some(done)
    }

    /// Grows the buffers that were too small, and clears the control buffer's flags.
    fn after(&mut self, control: &[u32]) {
        self.last_pairs = control[PAIRS];
        if control[OVERFLOWED] != 0 {
            let wanted = control[PAIRS_WANTED];
            self.pairs_wanted = self.pairs_wanted.max(wanted.saturating_add(wanted / 4));
        }
        self.reset_flags();
    }

    /// Clears everything except the classifier's steps, which come last.
    fn reset_flags(&self) {
        self.gpu.queue.write_buffer(&self.store.control, 0, &[0; 4 * (STEPS_DONE + 1)]);
    }

    /// The terms of a step from its sums.
    fn terms(&self, frame: FrameId, sums: &[f32]) -> LossTerms {
        let target = &self.targets[frame];
        let used = &target.pixels;
        let mean = |sum: f32, count: usize| if count > 0 { sum / count as f32 } else { 0.0 };
        let step = target.camera.trained(&self.config, used);
        let similarity = mean(sums[3], 3 * target.camera.pixels());
        LossTerms {
            color_l1: mean(sums[0], 3 * used.colored),
            // The CPU computes this term even without weight; here it would cost two kernels.
            dssim: if step.other_weights[0] != 0.0 { 1.0 - similarity } else { 0.0 },
            depth: mean(sums[1], used.deep),
            normal: mean(sums[2], used.oriented),
            segmentation: mean(sums[4], used.labelled) / step.other_weights[3],
            isotropic: sums[5] / sums[7].max(1.0),
            flat: sums[6] / sums[7].max(1.0),
            total: 0.0,
        }
        .with_total(&self.config.weights)
    }

    /// Renders once; `Some(None)` if the capacity in pairs was too small, which is then increased; `None` after a
    /// failure.
    fn try_render(&mut self, camera: &Step) -> Option<Option<RenderedMaps>> {
        let mut room = self.room_for_gaussians();
        (room.tiles, room.shown) = (camera.tiles(), camera.pixels() as u32);
        self.work.reserve(&self.gpu, self.store.classes, &room);
        let step = self.completed(*camera, 0);
        self.gpu.queue.write_buffer(&self.work.uniforms, 0, bytemuck::bytes_of(&step));
        let view = self.work.bind_view(&self.gpu, &self.kernels, &self.nothing);
        let Self { gpu, kernels, work, store, spare_maps, .. } = self;
        submit(gpu, &of_view(kernels, work.bindings(gpu, kernels, store), &step), &view);
        let parts = [(&store.control, 4 * CONTROL_WORDS as u64), (work.maps(), 36 * camera.pixels() as u64)];
        let (control, maps) = gpu.read_with(parts, |[control, maps]| {
            let control: Vec<u32> = bytemuck::pod_collect_to_vec(control);
            let maps = (control[OVERFLOWED] == 0).then(|| {
                let spare = spare_maps.pop().unwrap_or_default();
                maps_of(bytemuck::cast_slice(maps), camera.size[0] as usize, spare)
            });
            (control, maps)
        })?;
        self.after(&control);
        Some(maps)
    }

    /// Runs a kernel over the present Gaussians, outside of any step.
    fn run_over(&self, kernel: &ComputeKernel, buffers: &[&wgpu::Buffer], count: u32, groups: u32) {
        let Self { gpu, kernels, work, nothing, .. } = self;
        let buffers = &bind(gpu, kernel, buffers);
        let view = work.bind_view(gpu, kernels, nothing);
        let step = Step { counts: [count, 0, 0, 0], ..Step::default() };
        gpu.queue.write_buffer(&work.uniforms, 0, bytemuck::bytes_of(&step));
        submit(gpu, &[Dispatch { name: kernel.name, kernel, buffers, groups: [groups, 1] }], &view);
    }

    /// Applies `see` to the position and the logit of the opacity of each Gaussian; to zeros after a failure.
    fn map_places<T: Send>(&self, see: impl Fn(&[f32; 4]) -> T + Sync) -> Vec<T> {
        let count = self.store.count;
        if count == 0 {
            return Vec::new();
        }
        let places = self.gpu.buffer("places", 16 * count as u64, wgpu::BufferUsages::empty());
        let groups = (count as u32).div_ceil(GAUSSIANS);
        self.run_over(&self.kernels.places, &[&self.store.rows, &places], count as u32, groups);
        let all = self.gpu.read_with([(&places, 16 * count as u64)], |[places]| {
            bytemuck::cast_slice(places).par_iter().with_min_len(4096).map(&see).collect()
        });
        all.unwrap_or_else(|| (0..count).map(|_| see(&[0.0; 4])).collect())
    }

    /// The whole state; zeros after a failure.
    fn parameters(&self) -> Parameters {
        self.store.read(&self.gpu).unwrap_or_else(|| {
            let rows = vec![Row::ZERO; self.store.count];
            Parameters {
                first: rows.clone(),
                second: rows.clone(),
                steps: vec![0; rows.len()],
                rows,
                ..Parameters::new(self.store.classes, Seed(0))
            }
        })
    }
}

/// Returns the bytes to read back: the control buffer and the statistics of some steps.
fn result_bytes(steps: usize) -> (u64, u64) {
    (4 * CONTROL_WORDS as u64, 4 * (STATS * steps) as u64)
}

struct PlannedStep {
    frame: FrameId,
    rates: LearningRates,
    /// The batch that reports its losses, if any.
    batch: Option<usize>,
}

impl Trainer for GpuTrainer {
    /// # Panics
    /// If a buffer of the frame has another size than the camera's image.
    fn add_frame(&mut self, frame: TrainFrame) -> FrameId {
        self.targets.push(DeviceTarget::new(&self.gpu, &frame, self.store.classes));
        self.views.push(None);
        self.targets.len() - 1
    }

    fn len(&self) -> usize {
        self.store.count
    }

    fn insert(&mut self, seedlings: &[Seedling]) {
        let mut parameters = Parameters::default();
        parameters.insert(seedlings);
        if parameters.rows.is_empty() {
            return;
        }
        self.store.reserve(&self.gpu, self.store.count + parameters.rows.len());
        self.store.append(&self.gpu, &parameters.rows);
        self.work.forget_bindings();
    }

    fn retain(&mut self, mask: &[bool]) {
        assert_eq!(mask.len(), self.store.count, "one entry per Gaussian");
        let kept: Vec<u32> = (0..mask.len() as u32).filter(|&i| mask[i as usize]).collect();
        if kept.len() == mask.len() {
            return;
        }
        let kept_in = self.store.take_spare(&self.gpu);
        if !kept.is_empty() {
            let indices = self.gpu.upload("kept", bytemuck::cast_slice(&kept), wgpu::BufferUsages::STORAGE);
            let (store, [rows, moments, steps]) = (&self.store, &kept_in);
            let from = [&indices, &store.rows, &store.moments, &store.steps, rows, moments, steps];
            let count = kept.len() as u32;
            self.run_over(&self.kernels.compact, &from, count, (ROW_VECTORS * count).div_ceil(256));
        }
        self.store.replace(kept_in, kept.len());
        self.work.forget_bindings();
    }

    /// # Panics
    /// If a frame was not added.
    fn steps(&mut self, frames: &[FrameId]) -> StepStats {
        let batch = StepBatch { rates: self.config.rates, own: frames.to_vec(), replayed: Vec::new() };
        self.batches(&[batch], &|| None).0.pop().unwrap_or_default()
    }

    /// # Panics
    /// If a frame was not added.
    fn batches(
        &mut self,
        batches: &[StepBatch],
        next: &dyn Fn() -> Option<TrainFrame>,
    ) -> (Vec<StepStats>, Option<FrameId>) {
        let mut planned = Vec::new();
        for (i, batch) in batches.iter().enumerate() {
            let rates = batch.rates;
            self.config.rates = rates;
            let own = batch.own.iter().map(|&frame| (frame, Some(i)));
            let all = own.chain(batch.replayed.iter().map(|&frame| (frame, None)));
            // Views without pixels are skipped.
            let shown = all.filter(|(frame, _)| self.targets[*frame].camera.pixels() > 0);
            planned.extend(shown.map(|(frame, batch)| PlannedStep { frame, rates, batch }));
        }
        let mut sums = vec![LossTerms::default(); batches.len()];
        let (mut next, mut added) = (Some(next), None);
        let mut rest = &planned[..];
        while !rest.is_empty() && self.gpu.failure().is_none() {
            let some = &rest[..rest.len().min(BATCH)];
            if self.submit(some).is_none() {
                break;
            }
            if let Some(make) = next.take() {
                added = make().map(|frame| self.add_frame(frame));
            }
            let Some(done) = self.collect(some, &mut sums) else { break };
            rest = &rest[done..];
        }
        if let Some(make) = next.take() {
            added = make().map(|frame| self.add_frame(frame));
        }
        let left = |i: usize| rest.iter().filter(|p| p.batch == Some(i)).count();
        let stats = |(i, (batch, sum)): (usize, (&StepBatch, &LossTerms))| {
            let mut stats = StepStats { steps: (batch.own.len() - left(i)) as u32, ..StepStats::default() };
            stats.loss.add(sum, 1.0 / batch.own.len().max(1) as f32);
            stats
        };
        (batches.iter().zip(&sums).enumerate().map(stats).collect(), added)
    }

    fn set_background(&mut self, rgb: [f32; 3]) {
        self.background = rgb.map(|v| if v.is_finite() { v.clamp(0.0, 1.0) } else { 0.0 });
    }

    fn set_rates(&mut self, rates: &LearningRates) {
        self.config.rates = *rates;
    }

    fn render(&mut self, camera: &Camera) -> RenderedMaps {
        let step = Step::of_camera(camera);
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        if width * height > 0 {
            while let Some(rendered) = self.try_render(&step) {
                if let Some(maps) = rendered {
                    return maps;
                }
            }
        }
        let mut blank = RenderedMaps::default();
        blank.resize(width, height);
        blank
    }

    fn recycle(&mut self, maps: RenderedMaps) {
        if self.spare_maps.len() < SPARE_MAPS {
            self.spare_maps.push(maps);
        }
    }

    fn opacities(&self) -> Vec<f32> {
        self.map_places(|place| sigmoid(place[3]))
    }

    fn positions_w(&self) -> Vec<Vec3> {
        self.map_places(|place| Vec3::from_slice(&place[..3]))
    }

    fn places(&self) -> (Vec<Vec3>, Vec<f32>) {
        self.map_places(|place| (Vec3::from_slice(&place[..3]), sigmoid(place[3]))).into_iter().unzip()
    }

    fn model(&self) -> GaussianModel {
        GaussianModel { background: self.background, ..self.parameters().model() }
    }

    fn snapshot(&self) -> TrainState {
        self.parameters().encode()
    }

    fn restore(&mut self, state: &TrainState) -> Result<(), TrainerError> {
        let parameters = Parameters::decode_for(self.store.classes, state)?;
        self.store.set(&self.gpu, &parameters);
        self.work.forget_bindings();
        Ok(())
    }

    fn edit(&mut self, change: &mut dyn FnMut(&mut Parameters)) -> Result<(), TrainerError> {
        let mut parameters = self.parameters();
        change(&mut parameters);
        if !parameters.is_finite() {
            return Err(TrainerError::not_finite());
        }
        self.store.set(&self.gpu, &parameters);
        self.work.forget_bindings();
        Ok(())
    }

    fn failure(&self) -> Option<String> {
        let name = &self.gpu.summary.name;
        self.gpu.failure().map(|reason| format!("{name}: {reason}"))
    }
}

#[cfg(test)]
impl GpuTrainer {
    /// Destroys the device, as a fault or an unplugged GPU would.
    pub(crate) fn lose_device(&self) {
        self.gpu.device.destroy();
    }

    /// Restarts with this capacity in pairs, to test its growth.
    pub(crate) fn shrink_pairs(&mut self, pairs: u32) {
        self.work = StepBuffers::new(&self.gpu, self.store.classes);
        self.views.iter_mut().for_each(|view| *view = None);
        self.pairs_wanted = pairs;
    }

    /// Returns the capacity in pairs of splat and tile.
    pub(crate) fn pairs(&self) -> u32 {
        self.work.room.pairs
    }
}
