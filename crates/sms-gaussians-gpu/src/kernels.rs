//! The compute pipelines, from the sources under `shaders/`.

use crate::gpu::Gpu;
use crate::rows::ROW_VECTORS;
use crate::unroll::unroll;
use crate::work::STATS;
use sms_gaussians::limits::{
    ALPHA_MAX, ALPHA_MIN, AREA_FLOOR, DEPTH_OPACITY_MIN, FAR, LOW_PASS, NEAR, SLOPE_LOW_PASS, SSIM_C1,
    SSIM_C2, TRANSMITTANCE_MIN, ssim_window,
};
use sms_gaussians::parameters::{LOGIT_LIMIT, SCALE_RANGE};
use std::fmt::Write;
use wgpu::BufferBindingType;

/// Workgroups in one dimension of a dispatch; more go into the second.
pub(crate) const MAX_GROUPS: u32 = 65_535;
/// Gaussians per workgroup of projection, visits and updates.
pub(crate) const GAUSSIANS: u32 = 128;
/// Workgroups that visit large splats, and how many of them share one splat.
pub(crate) const LARGE_GROUPS: [u32; 2] = [256, 4];
/// Side of the blocks of SSIM and the pixel losses.
pub(crate) const BLOCK: u32 = 16;
/// Pixels of a tile.
pub(crate) const TILE_PIXELS: u32 = 64;
/// Most workgroups of the segmentation.
pub(crate) const SEGMENT_GROUPS: u32 = 1024;
/// Length of the table of Adam's corrections; beyond it, both corrections are one.
pub(crate) const CORRECTIONS: u32 = 20_001;
/// Vectors of the flat classifier.
pub(crate) fn classifier_vectors(classes: usize) -> u32 {
    // Even, so that the last workgroup of the classifier's update also has eight values.
    sms_gaussians::parameters::classifier_len(classes).div_ceil(8) as u32 * 2
}

/// Number of parts of a tile's pixels for each block of the classifier's second layer, so that 64 lanes have work.
fn split_of(classes: usize) -> u32 {
    match classes.div_ceil(4) {
        1 => 8,
        2 => 4,
        3 | 4 => 2,
        _ => 1,
    }
}

/// A compute pipeline and the layout of its own buffers (group 0).
pub(crate) struct ComputeKernel {
    pub(crate) name: &'static str,
    pub(crate) pipeline: wgpu::ComputePipeline,
    pub(crate) layout: wgpu::BindGroupLayout,
}

/// All kernels, in the order of a step.
pub(crate) struct Kernels {
    /// Layout of group 1: the step's numbers at a dynamic offset, and the observed view.
    pub(crate) step_layout: wgpu::BindGroupLayout,
    pub(crate) project: ComputeKernel,
    pub(crate) visit: ComputeKernel,
    pub(crate) visit_large: ComputeKernel,
    pub(crate) place: ComputeKernel,
    pub(crate) sort: ComputeKernel,
    pub(crate) forward: ComputeKernel,
    pub(crate) ssim: ComputeKernel,
    pub(crate) loss: ComputeKernel,
    pub(crate) segment: ComputeKernel,
    pub(crate) backward: ComputeKernel,
    pub(crate) reduce: ComputeKernel,
    pub(crate) update: ComputeKernel,
    pub(crate) finish: ComputeKernel,
    pub(crate) maps: ComputeKernel,
    pub(crate) compact: ComputeKernel,
    pub(crate) places: ComputeKernel,
    /// Workgroups that end a step.
    pub(crate) finish_groups: u32,
}

/// Kind of a binding of group 0.
#[derive(Clone, Copy)]
enum Slot {
    Read,
    Write,
    Uniform,
}
use Slot::{Read as R, Uniform, Write as W};

fn entry(binding: u32, slot: Slot, dynamic: bool) -> wgpu::BindGroupLayoutEntry {
    let ty = match slot {
        Slot::Read => BufferBindingType::Storage { read_only: true },
        Slot::Write => BufferBindingType::Storage { read_only: false },
        Slot::Uniform => BufferBindingType::Uniform,
    };
    wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::COMPUTE,
        ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: dynamic, min_binding_size: None },
        count: None,
    }
}

/// Constants of the kernels, as WGSL.
fn constants(classes: usize) -> String {
    let mut text = String::new();
    let numbers = [
        ("TILE_PIXELS", TILE_PIXELS),
        ("SPLIT_OF_CLASSES", split_of(classes)),
        ("CLASSES", classes as u32),
        ("CLASSIFIER_VECTORS", classifier_vectors(classes)),
        ("CLASSIFIER_GROUPS", classifier_vectors(classes) / 2),
        ("ROW_VECTORS", ROW_VECTORS),
        ("MAX_GROUPS", MAX_GROUPS),
        ("CORRECTIONS", CORRECTIONS),
    ];
    for (name, value) in numbers {
        let _ = writeln!(text, "const {name} = {value}u;");
    }
    let numbers = [
        ("LOG2_ALPHA_MIN", f64::from(ALPHA_MIN).log2()),
        ("LOG2_ALPHA_MAX", f64::from(ALPHA_MAX).log2()),
        ("TRANSMITTANCE_MIN", f64::from(TRANSMITTANCE_MIN)),
        ("LOW_PASS", LOW_PASS),
        ("AREA_FLOOR", AREA_FLOOR),
        ("SLOPE_LOW_PASS", SLOPE_LOW_PASS),
        ("NEAR", NEAR),
        ("FAR", FAR),
        ("DEPTH_OPACITY_MIN", DEPTH_OPACITY_MIN),
        ("SSIM_C1", SSIM_C1),
        ("SSIM_C2", SSIM_C2),
        ("LOG_SCALE_MIN", f64::from(SCALE_RANGE.0.ln())),
        ("LOG_SCALE_MAX", f64::from(SCALE_RANGE.1.ln())),
        ("LOGIT_LIMIT", f64::from(LOGIT_LIMIT)),
    ];
    for (name, value) in numbers {
        let _ = writeln!(text, "const {name}: f32 = {:e};", value as f32);
    }
    let weights: Vec<String> = ssim_window().iter().map(|w| format!("{:e}", *w as f32)).collect();
    let _ = writeln!(text, "const WINDOW = array<f32, {}>({});", weights.len(), weights.join(", "));
    text
}

/// Compiles a module without guards around indices and loops.
#[allow(
    unsafe_code,
    reason = "guards cost 28 % of a step (segmentation 2.9 times as long): their counters keep loops from being unrolled"
)]
fn trusted_module(device: &wgpu::Device, descriptor: wgpu::ShaderModuleDescriptor<'_>) -> wgpu::ShaderModule {
    // SAFETY: no index comes from data. Kernels index with invocation numbers below the counts in `Step`, which the
    // host derives from the sizes of the bound buffers. They also index with pairs, slots and lists that kernels wrote
    // within the capacity in `Step::counts`. Loops end at such counts. Tests compare with the guarded form.
    unsafe { device.create_shader_module_trusted(descriptor, wgpu::ShaderRuntimeChecks::unchecked()) }
}

impl Kernels {
    /// Compiles all kernels for a number of classes; `guarded` guards every index and every loop against overruns.
    pub(crate) fn new(gpu: &Gpu, classes: usize, guarded: bool) -> Self {
        let step_layout = gpu.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("step"),
            entries: &[entry(0, Slot::Uniform, true), entry(1, Slot::Read, false)],
        });
        let constants = constants(classes);
        let class_vectors = classes.div_ceil(4);
        let counts = [
            ("CLASSES", classes),
            ("PADDED", 4 * class_vectors),
            ("PARTS2", (8 * class_vectors * split_of(classes) as usize).div_ceil(64)),
        ];
        let kernel = |name: &'static str, slots: &[Slot], sources: &[&str]| {
            let common = include_str!("shaders/common.wgsl");
            let text = [&[constants.as_str(), common][..], sources].concat().join("\n");
            let descriptor = wgpu::ShaderModuleDescriptor {
                label: Some(name),
                source: wgpu::ShaderSource::Wgsl(unroll(&text, &counts).into()),
            };
            let module = if guarded {
                gpu.device.create_shader_module(descriptor)
            } else {
                trusted_module(&gpu.device, descriptor)
            };
            let entries: Vec<_> =
                slots.iter().enumerate().map(|(i, slot)| entry(i as u32, *slot, false)).collect();
            let layout = gpu.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some(name),
                entries: &entries,
            });
            let pipeline_layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some(name),
                bind_group_layouts: &[Some(&layout), Some(&step_layout)],
                immediate_size: 0,
            });
            let pipeline = gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(name),
                layout: Some(&pipeline_layout),
                module: &module,
                entry_point: Some("main"),
                // Every kernel writes its memory before reading it.
                compilation_options: wgpu::PipelineCompilationOptions {
                    zero_initialize_workgroup_memory: false,
                    ..Default::default()
                },
                cache: None,
            });
            ComputeKernel { name, pipeline, layout }
        };
        let gaussian = include_str!("shaders/gaussian.wgsl");
        let alpha = include_str!("shaders/alpha.wgsl");
        let adam = include_str!("shaders/adam.wgsl");
        let harmonics = include_str!("shaders/harmonics.wgsl");
        let columns = include_str!("shaders/columns.wgsl");
        let visited = [R, R, W, W, W, W, W, Uniform, W];
        Self {
            project: kernel(
                "project",
                &[R, W, W, W],
                &[gaussian, harmonics, include_str!("shaders/project.wgsl")],
            ),
            visit: kernel("visit", &visited, &[columns, include_str!("shaders/visit.wgsl")]),
            visit_large: kernel(
                "visit large",
                &visited,
                &[columns, include_str!("shaders/visit_large.wgsl")],
            ),
            place: kernel("place", &[W, W, W], &[include_str!("shaders/place.wgsl")]),
            sort: kernel("sort", &[R, W, W, W], &[include_str!("shaders/sort.wgsl")]),
            forward: kernel("forward", &[R, R, R, R, W, W], &[alpha, include_str!("shaders/forward.wgsl")]),
            ssim: kernel("ssim", &[R, W, W], &[include_str!("shaders/ssim.wgsl")]),
            loss: kernel("loss", &[R, R, W, W], &[include_str!("shaders/loss.wgsl")]),
            segment: kernel("segment", &[R, W, R, W, W, R], &[include_str!("shaders/segment.wgsl")]),
            backward: kernel(
                "backward",
                &[R, R, R, R, R, R, R, W],
                &[alpha, include_str!("shaders/backward.wgsl")],
            ),
            reduce: kernel("reduce", &[R, R, W, W], &[include_str!("shaders/reduce.wgsl")]),
            update: kernel(
                "update",
                &[W, W, W, R, R, W, R],
                &[gaussian, harmonics, adam, include_str!("shaders/update.wgsl")],
            ),
            finish: kernel("finish", &[R, R, W, W, R, W, W], &[adam, include_str!("shaders/finish.wgsl")]),
            maps: kernel("maps", &[R, R, R, R, R, Uniform, W], &[alpha, include_str!("shaders/maps.wgsl")]),
            compact: kernel("compact", &[R, R, R, R, W, W, W], &[include_str!("shaders/compact.wgsl")]),
            places: kernel("places", &[R, W], &[include_str!("shaders/places.wgsl")]),
            finish_groups: classifier_vectors(classes) / 2 + STATS as u32 - 1,
            step_layout,
        }
    }
}
