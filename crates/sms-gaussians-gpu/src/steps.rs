//! Dispatches of a step or a rendered view, and their recording.

use crate::gpu::Gpu;
use crate::kernels::{BLOCK, ComputeKernel, GAUSSIANS, Kernels, LARGE_GROUPS, SEGMENT_GROUPS};
use crate::uniforms::{STRIDE, Step};
use crate::work::{Bindings, spread};

pub(crate) struct Dispatch<'a> {
    pub(crate) name: &'static str,
    pub(crate) kernel: &'a ComputeKernel,
    pub(crate) buffers: &'a wgpu::BindGroup,
    pub(crate) groups: [u32; 2],
}

/// Workgroups of the segmentation of a view.
pub(crate) fn segment_groups(step: &Step) -> u32 {
    step.tiles().clamp(1, SEGMENT_GROUPS)
}

/// Projection and lists, shared by training and rendering.
fn listed<'a>(kernels: &'a Kernels, b: &'a Bindings, step: &Step) -> Vec<Dispatch<'a>> {
    let gaussians = [step.counts[0].div_ceil(GAUSSIANS), 1];
    let tiles = spread(step.tiles());
    let dispatch = |name, kernel, buffers, groups| Dispatch { name, kernel, buffers, groups };
    // Projection also clears the counters, so it always runs.
    let projected = [gaussians[0].max(1), 1];
    vec![
        dispatch("project", &kernels.project, &b.project, projected),
        dispatch("count", &kernels.visit, &b.count, gaussians),
        dispatch("count_large", &kernels.visit_large, &b.count_large, LARGE_GROUPS),
        dispatch("place", &kernels.place, &b.place, [step.tiles().div_ceil(256), 1]),
        dispatch("fill", &kernels.visit, &b.fill, gaussians),
        dispatch("fill_large", &kernels.visit_large, &b.fill_large, LARGE_GROUPS),
        dispatch("sort", &kernels.sort, &b.sort, tiles),
        dispatch("forward", &kernels.forward, &b.forward, tiles),
    ]
}

/// The dispatches of a training step.
pub(crate) fn of_step<'a>(kernels: &'a Kernels, b: &'a Bindings, step: &Step) -> Vec<Dispatch<'a>> {
    let gaussians = [step.counts[0].div_ceil(GAUSSIANS), 1];
    let blocks = [step.size[0].div_ceil(BLOCK), step.size[1].div_ceil(BLOCK)];
    let dispatch = |name, kernel, buffers, groups| Dispatch { name, kernel, buffers, groups };
    let mut all = listed(kernels, b, step);
    if step.other_weights[0] != 0.0 {
        all.push(dispatch("ssim", &kernels.ssim, &b.ssim, blocks));
    }
    all.push(dispatch("loss", &kernels.loss, &b.loss, blocks));
    if step.segmented() {
        all.push(dispatch("segment", &kernels.segment, &b.segment, [segment_groups(step), 1]));
    }
    all.push(dispatch("backward", &kernels.backward, &b.backward, spread(step.tiles())));
    all.push(dispatch("reduce", &kernels.reduce, &b.reduce, [(8 * step.counts[0]).div_ceil(256), 1]));
    all.push(dispatch("update", &kernels.update, &b.update, gaussians));
    all.push(dispatch("finish", &kernels.finish, &b.finish, [kernels.finish_groups, 1]));
    all
}

/// The dispatches of a rendered view.
pub(crate) fn of_view<'a>(kernels: &'a Kernels, b: &'a Bindings, step: &Step) -> Vec<Dispatch<'a>> {
    let mut all = listed(kernels, b, step);
    all.push(Dispatch {
        name: "maps",
        kernel: &kernels.maps,
        buffers: &b.maps,
        groups: spread(step.tiles()),
    });
    all
}

/// Records the dispatches of a step with its index in the batch.
pub(crate) fn record(
    pass: &mut wgpu::ComputePass<'_>,
    dispatches: &[Dispatch<'_>],
    view: &wgpu::BindGroup,
    index: usize,
) {
    pass.set_bind_group(1, view, &[(STRIDE * index as u64) as u32]);
    for d in dispatches.iter().filter(|d| d.groups[0] > 0) {
        pass.set_pipeline(&d.kernel.pipeline);
        pass.set_bind_group(0, d.buffers, &[]);
        pass.dispatch_workgroups(d.groups[0], d.groups[1], 1);
    }
}

/// Submits dispatches outside of a batch.
pub(crate) fn submit(gpu: &Gpu, dispatches: &[Dispatch<'_>], view: &wgpu::BindGroup) {
    let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    record(&mut encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default()), dispatches, view, 0);
    gpu.queue.submit([encoder.finish()]);
}

/// Runs dispatches one by one, each between two timestamps, and returns their times in milliseconds; `None` if the
/// device has no timestamps or failed.
pub(crate) fn timed(
    gpu: &Gpu,
    dispatches: &[Dispatch<'_>],
    view: &wgpu::BindGroup,
) -> Option<Vec<(&'static str, f64)>> {
    let unit_ms = f64::from(gpu.timestamp_ns?) * 1e-6;
    let count = 2 * dispatches.len() as u32;
    let queries = gpu.device.create_query_set(&wgpu::QuerySetDescriptor {
        label: Some("kernel times"),
        ty: wgpu::QueryType::Timestamp,
        count,
    });
    let bytes = 8 * u64::from(count);
    let resolved = gpu.buffer("kernel times", bytes, wgpu::BufferUsages::QUERY_RESOLVE);
    let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    for (i, dispatch) in dispatches.iter().enumerate() {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some(dispatch.name),
            timestamp_writes: Some(wgpu::ComputePassTimestampWrites {
                query_set: &queries,
                beginning_of_pass_write_index: Some(2 * i as u32),
                end_of_pass_write_index: Some(2 * i as u32 + 1),
            }),
        });
        record(&mut pass, std::slice::from_ref(dispatch), view, 0);
    }
    encoder.resolve_query_set(&queries, 0..count, &resolved, 0);
    gpu.queue.submit([encoder.finish()]);
    let ticks: Vec<u64> =
        gpu.read_with([(&resolved, bytes)], |[ticks]| bytemuck::pod_collect_to_vec(ticks))?;
    let times = ticks.chunks_exact(2).map(|t| t[1].saturating_sub(t[0]) as f64 * unit_ms);
    Some(dispatches.iter().map(|d| d.name).zip(times).collect())
}
