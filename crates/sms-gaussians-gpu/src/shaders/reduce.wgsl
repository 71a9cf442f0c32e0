// Sums the slots of each Gaussian in their order, eight lanes to a Gaussian, and counts the Gaussians that reached a
// pixel. Those with many slots are summed by the whole workgroup, in an order that depends on their number alone.

@group(0) @binding(0) var<storage, read> spans: array<vec2u>;
@group(0) @binding(1) var<storage, read> slots: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> sums: array<vec4f>;
@group(0) @binding(3) var<storage, read_write> control: array<atomic<u32>>;

const LANES = 256u;
// Slots that eight lanes sum at most.
const MANY = 32u;
var<workgroup> seen: atomic<u32>;
var<workgroup> long: array<u32, 32>;
var<workgroup> long_count: atomic<u32>;
var<workgroup> parts: array<vec4f, 256>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) id: vec3u, @builtin(local_invocation_index) lane: u32) {
    let g = id.x / 8u;
    let part = id.x % 8u;
    if (lane == 0u) {
        atomicStore(&seen, 0u);
        atomicStore(&long_count, 0u);
    }
    workgroupBarrier();
    if (g < u.counts.x && atomicLoad(&control[OVERFLOWED]) == 0u) {
        let span = spans[g];
        if (span.y > MANY) {
            if (part == 0u) { long[atomicAdd(&long_count, 1u)] = g; }
        } else if (span.y > 0u || part == 3u) {
            var sum = vec4f();
            for (var i = 0u; i < span.y; i++) { sum += slots[8u * (span.x + i) + part]; }
            sums[8u * g + part] = sum;
            if (part == 3u && sum.w > 0.0) { atomicAdd(&seen, 1u); }
        }
    }
    let longs = workgroupUniformLoad(&long_count);
    for (var k = 0u; k < longs; k++) {
        let owner = long[k];
        let span = spans[owner];
        var sum = vec4f();
        for (var i = lane / 8u; i < span.y; i += LANES / 8u) { sum += slots[8u * (span.x + i) + lane % 8u]; }
        parts[lane] = sum;
        workgroupBarrier();
        for (var half = LANES / 2u; half >= 8u; half /= 2u) {
            if (lane < half) { parts[lane] += parts[lane + half]; }
            workgroupBarrier();
        }
        if (lane < 8u) { sums[8u * owner + lane] = parts[lane]; }
        if (lane == 3u && parts[3].w > 0.0) { atomicAdd(&seen, 1u); }
        workgroupBarrier();
    }
    workgroupBarrier();
    if (lane == 0u) {
        let count = atomicLoad(&seen);
        if (count > 0u) { atomicAdd(&control[SEEN], count); }
    }
}
