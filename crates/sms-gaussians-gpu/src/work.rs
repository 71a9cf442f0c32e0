//! Buffers that hold no data between steps, and the bindings of the kernels.

use crate::gpu::Gpu;
use crate::kernels::{
    ComputeKernel, GAUSSIANS, Kernels, MAX_GROUPS, SEGMENT_GROUPS, TILE_PIXELS, classifier_vectors,
};
use crate::store::Store;
use crate::uniforms::{STRIDE, Step};
use wgpu::BufferUsages;

/// Most steps of one submission.
pub(crate) const BATCH: usize = 64;
/// Numbers of a step in the statistics: seven sums and the Gaussians in view.
pub(crate) const STATS: usize = 8;

/// Below this number of Gaussians, memory is not scarce.
const FEW: u32 = 100_000;

/// Capacities of the buffers.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Room {
    pub(crate) gaussians: u32,
    pub(crate) tiles: u32,
    pub(crate) pixels: u32,
    pub(crate) pairs: u32,
    /// Pixels of rendered maps.
    pub(crate) shown: u32,
}

pub(crate) struct StepBuffers {
    pub(crate) room: Room,
    pub(crate) uniforms: wgpu::Buffer,
    pub(crate) stats: wgpu::Buffer,
    /// Length of a section of the partial sums.
    pub(crate) partial_stride: u32,
    buffers: Buffers,
    modes: [wgpu::Buffer; 2],
    bindings: Option<Bindings>,
}

struct Buffers {
    records: wgpu::Buffer,
    outlines: wgpu::Buffer,
    spans: wgpu::Buffer,
    large: wgpu::Buffer,
    sums: wgpu::Buffer,
    tile_counts: wgpu::Buffer,
    lists: wgpu::Buffer,
    used: wgpu::Buffer,
    image: wgpu::Buffer,
    gradient: wgpu::Buffer,
    derivatives: wgpu::Buffer,
    partials: wgpu::Buffer,
    shares: wgpu::Buffer,
    keys: wgpu::Buffer,
    pair_slots: wgpu::Buffer,
    slots: wgpu::Buffer,
    maps: wgpu::Buffer,
    /// Bytes of all of them.
    bytes: u64,
}

/// Bind groups of the kernels, in the order of [`Kernels`].
pub(crate) struct Bindings {
    pub(crate) project: wgpu::BindGroup,
    pub(crate) count: wgpu::BindGroup,
    pub(crate) fill: wgpu::BindGroup,
    pub(crate) count_large: wgpu::BindGroup,
    pub(crate) fill_large: wgpu::BindGroup,
    pub(crate) place: wgpu::BindGroup,
    pub(crate) sort: wgpu::BindGroup,
    pub(crate) forward: wgpu::BindGroup,
    pub(crate) ssim: wgpu::BindGroup,
    pub(crate) loss: wgpu::BindGroup,
    pub(crate) segment: wgpu::BindGroup,
    pub(crate) backward: wgpu::BindGroup,
    pub(crate) reduce: wgpu::BindGroup,
    pub(crate) update: wgpu::BindGroup,
    pub(crate) finish: wgpu::BindGroup,
    pub(crate) maps: wgpu::BindGroup,
}

impl Buffers {
    fn new(gpu: &Gpu, room: &Room, classes: usize, partial_stride: u32) -> Self {
        let [n, tiles, pixels, pairs, shown] =
            [room.gaussians, room.tiles, room.pixels, room.pairs, room.shown].map(u64::from);
        let mut bytes = 0;
        let mut buffer = |label, size| {
            let buffer = gpu.buffer(label, size, BufferUsages::empty());
            bytes += buffer.size();
            buffer
        };
        let of_tiles = 6 * 16 * u64::from(TILE_PIXELS) * tiles;
        Self {
            records: buffer("records", 64 * n),
            outlines: buffer("outlines", 16 * n),
            spans: buffer("spans", 8 * n),
            large: buffer("large", 4 * n),
            sums: buffer("sums", 128 * n),
            tile_counts: buffer("tile counts", 4 * tiles),
            lists: buffer("lists", 8 * tiles),
            used: buffer("used", 4 * tiles),
            image: buffer("image", of_tiles),
            gradient: buffer("gradient", of_tiles),
            derivatives: buffer("derivatives", 48 * pixels),
            partials: buffer("partials", 4 * 7 * u64::from(partial_stride)),
            shares: buffer("shares", 16 * u64::from(classifier_vectors(classes) * SEGMENT_GROUPS)),
            keys: buffer("keys", 8 * pairs),
            pair_slots: buffer("pair slots", 4 * pairs),
            slots: buffer("slots", 128 * pairs),
            maps: buffer("maps", 36 * shown),
            bytes,
        }
    }

    fn visit<'a>(&'a self, control: &'a wgpu::Buffer, mode: &'a wgpu::Buffer) -> [&'a wgpu::Buffer; 9] {
        [
            &self.records,
            &self.outlines,
            &self.spans,
            &self.tile_counts,
            &self.keys,
            &self.pair_slots,
            control,
            mode,
            &self.large,
        ]
    }
}

/// Entries of a section of the partial sums: blocks of 16×16 pixels, workgroups of Gaussians or of the segmentation.
fn partial_stride(room: &Room) -> u32 {
    // Blocks never outnumber tiles.
    room.tiles.max(room.gaussians.div_ceil(GAUSSIANS)).max(SEGMENT_GROUPS)
}

impl StepBuffers {
    pub(crate) fn new(gpu: &Gpu, classes: usize) -> Self {
        let room = Room::default();
        let mode = |m: u32| gpu.upload("mode", bytemuck::cast_slice(&[m, 0, 0, 0]), BufferUsages::UNIFORM);
        let stride = partial_stride(&room);
        Self {
            room,
            uniforms: gpu.buffer("steps", STRIDE * BATCH as u64, BufferUsages::UNIFORM),
            stats: gpu.buffer("statistics", 4 * (STATS * BATCH) as u64, BufferUsages::empty()),
            partial_stride: stride,
            buffers: Buffers::new(gpu, &room, classes, stride),
            modes: [mode(0), mode(1)],
            bindings: None,
        }
    }

    /// Grows the buffers as needed; growing loses their contents.
    pub(crate) fn reserve(&mut self, gpu: &Gpu, classes: usize, wanted: &Room) {
        let (a, b) = (self.room, wanted);
        // Gaussians and pairs grow gradually; while they are few, by half, since all buffers are recreated.
        let more = if b.gaussians < FEW { 2 } else { 4 };
        let grown = |has: u32, wants: u32| if wants > has { wants.saturating_add(wants / more) } else { has };
        let room = Room {
            gaussians: grown(a.gaussians, b.gaussians),
            tiles: a.tiles.max(b.tiles),
            pixels: a.pixels.max(b.pixels),
            pairs: grown(a.pairs, b.pairs),
            shown: a.shown.max(b.shown),
        };
        if room == self.room {
            return;
        }
        self.partial_stride = partial_stride(&room);
        self.buffers = Buffers::new(gpu, &room, classes, self.partial_stride);
        self.room = room;
        self.forget_bindings();
    }

    /// Must be called when a buffer of the store was replaced.
    pub(crate) fn forget_bindings(&mut self) {
        self.bindings = None;
    }

    pub(crate) fn bindings(&mut self, gpu: &Gpu, kernels: &Kernels, store: &Store) -> &Bindings {
        let Self { bindings, buffers: b, modes: [counting, filling], stats, .. } = self;
        let Store { rows, moments, steps, classifier, classifier_moments, corrections, control, .. } = store;
        let bind = |kernel, buffers: &[&wgpu::Buffer]| bind(gpu, kernel, buffers);
        bindings.get_or_insert_with(|| Bindings {
            project: bind(&kernels.project, &[rows, &b.records, &b.outlines, control]),
            count: bind(&kernels.visit, &b.visit(control, counting)),
            fill: bind(&kernels.visit, &b.visit(control, filling)),
            count_large: bind(&kernels.visit_large, &b.visit(control, counting)),
            fill_large: bind(&kernels.visit_large, &b.visit(control, filling)),
            place: bind(&kernels.place, &[&b.tile_counts, &b.lists, control]),
            sort: bind(&kernels.sort, &[&b.lists, &b.tile_counts, &b.keys, &b.pair_slots]),
            forward: bind(&kernels.forward, &[rows, &b.records, &b.lists, &b.keys, &b.image, &b.used]),
            ssim: bind(&kernels.ssim, &[&b.image, &b.derivatives, &b.partials]),
            loss: bind(&kernels.loss, &[&b.image, &b.derivatives, &b.gradient, &b.partials]),
            segment: bind(
                &kernels.segment,
                &[&b.image, &b.gradient, classifier, &b.shares, &b.partials, control],
            ),
            backward: bind(
                &kernels.backward,
                &[rows, &b.records, &b.lists, &b.keys, &b.used, &b.image, &b.gradient, &b.slots],
            ),
            reduce: bind(&kernels.reduce, &[&b.spans, &b.slots, &b.sums, control]),
            update: bind(
                &kernels.update,
                &[rows, moments, steps, &b.sums, corrections, &b.partials, control],
            ),
            finish: bind(
                &kernels.finish,
                &[&b.shares, &b.partials, classifier, classifier_moments, corrections, control, stats],
            ),
            maps: bind(
                &kernels.maps,
                &[&b.records, &b.lists, &b.keys, &b.used, &b.image, classifier, &b.maps],
            ),
        })
    }

    /// The rendered maps.
    pub(crate) fn maps(&self) -> &wgpu::Buffer {
        &self.buffers.maps
    }

    /// Bytes on the device.
    pub(crate) fn bytes(&self) -> u64 {
        self.buffers.bytes + self.uniforms.size() + self.stats.size()
    }

    /// Returns the bind group of a view: the uniforms of the steps and the observations.
    pub(crate) fn bind_view(&self, gpu: &Gpu, kernels: &Kernels, observed: &wgpu::Buffer) -> wgpu::BindGroup {
        let window = wgpu::BufferBinding {
            buffer: &self.uniforms,
            offset: 0,
            size: std::num::NonZero::new(size_of::<Step>() as u64),
        };
        gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("view"),
            layout: &kernels.step_layout,
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: wgpu::BindingResource::Buffer(window) },
                wgpu::BindGroupEntry { binding: 1, resource: observed.as_entire_binding() },
            ],
        })
    }
}

/// Binds buffers to a kernel in order.
pub(crate) fn bind(gpu: &Gpu, kernel: &ComputeKernel, buffers: &[&wgpu::Buffer]) -> wgpu::BindGroup {
    let resources = buffers.iter().map(|b| b.as_entire_binding()).enumerate();
    let entries: Vec<_> =
        resources.map(|(i, resource)| wgpu::BindGroupEntry { binding: i as u32, resource }).collect();
    gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some(kernel.name),
        layout: &kernel.layout,
        entries: &entries,
    })
}

/// Returns the dimensions of a dispatch of `groups` workgroups. The kernel numbers them x + y·[`MAX_GROUPS`].
pub(crate) fn spread(groups: u32) -> [u32; 2] {
    if groups <= MAX_GROUPS { [groups, 1] } else { [MAX_GROUPS, groups.div_ceil(MAX_GROUPS)] }
}
