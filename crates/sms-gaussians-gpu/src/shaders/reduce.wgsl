// Sums the slots of each Gaussian in their order, eight lanes to a Gaussian, and counts the Gaussians that reached a
// pixel.

@group(0) @binding(0) var<storage, read> spans: array<vec2u>;
@group(0) @binding(1) var<storage, read> slots: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> sums: array<vec4f>;
@group(0) @binding(3) var<storage, read_write> control: array<atomic<u32>>;

var<workgroup> seen: atomic<u32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) id: vec3u, @builtin(local_invocation_index) lane: u32) {
    let g = id.x / 8u;
    let part = id.x % 8u;
    if (lane == 0u) { atomicStore(&seen, 0u); }
    workgroupBarrier();
    if (g < u.counts.x && atomicLoad(&control[OVERFLOWED]) == 0u) {
        let span = spans[g];
        if (span.y > 0u || part == 3u) {
            var sum = vec4f();
            for (var i = 0u; i < span.y; i++) { sum += slots[8u * (span.x + i) + part]; }
            sums[8u * g + part] = sum;
            if (part == 3u && sum.w > 0.0) { atomicAdd(&seen, 1u); }
        }
    }
    workgroupBarrier();
    if (lane == 0u) {
        let count = atomicLoad(&seen);
        if (count > 0u) { atomicAdd(&control[SEEN], count); }
    }
}
