// Sorts each tile's pairs by depth, equal depths by Gaussian: the order in which they were filled in is that of a race.
// Short lists by counting how many keys come before each, without a barrier; longer ones by a bitonic network, in
// workgroup memory or, the longest, where they lie. The network's comparisons all put the smaller first, so that a length
// that is no power of two needs no padding.

@group(0) @binding(0) var<storage, read> lists: array<vec2u>;
@group(0) @binding(1) var<storage, read_write> tile_counts: array<u32>;
// In: depth bits and Gaussian. Out: Gaussian and slot.
@group(0) @binding(2) var<storage, read_write> keys: array<vec2u>;
@group(0) @binding(3) var<storage, read_write> pair_slots: array<u32>;

const GROUP = 128u;
const COUNTED = 256u;
const SHORT = 1024u;
var<workgroup> local_keys: array<vec2u, 1024>;
var<workgroup> local_slots: array<u32, 1024>;
var<workgroup> list: vec2u;

fn after(a: vec2u, b: vec2u) -> bool {
    return a.x > b.x || (a.x == b.x && a.y > b.y);
}

// The two places that comparison `i` looks at, mirrored within blocks of 2^`block`: the first pass of a stage.
fn mirrored(i: u32, block: u32) -> vec2u {
    let half = (1u << block) >> 1u;
    let base = (i >> (block - 1u)) << block;
    let within = i & (half - 1u);
    return vec2u(base + within, base + 2u * half - 1u - within);
}

// The same 2^`distance` apart: the other passes.
fn apart(i: u32, distance: u32) -> vec2u {
    let step = 1u << distance;
    let low = ((i >> distance) << (distance + 1u)) | (i & (step - 1u));
    return vec2u(low, low + step);
}

fn compare_local(at: vec2u, n: u32) {
    if (at.y >= n) { return; }
    let a = local_keys[at.x];
    let b = local_keys[at.y];
    if (after(a, b)) {
        local_keys[at.x] = b;
        local_keys[at.y] = a;
        let slot = local_slots[at.x];
        local_slots[at.x] = local_slots[at.y];
        local_slots[at.y] = slot;
    }
}

fn compare_far(first: u32, at: vec2u, n: u32) {
    if (at.y >= n) { return; }
    let a = keys[first + at.x];
    let b = keys[first + at.y];
    if (after(a, b)) {
        keys[first + at.x] = b;
        keys[first + at.y] = a;
        let slot = pair_slots[first + at.x];
        pair_slots[first + at.x] = pair_slots[first + at.y];
        pair_slots[first + at.y] = slot;
    }
}

@compute @workgroup_size(128)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let tile = group.x + group.y * MAX_GROUPS;
    if (tile >= u.size.z * u.size.w) { return; }
    if (lane == 0u) {
        list = lists[tile];
        tile_counts[tile] = 0u;
    }
    let span = workgroupUniformLoad(&list);
    let first = span.x;
    let n = span.y;
    if (n <= COUNTED) {
        for (var i = lane; i < n; i += GROUP) { local_keys[i] = keys[first + i]; }
        workgroupBarrier();
        for (var i = lane; i < n; i += GROUP) {
            let key = local_keys[i];
            let slot = pair_slots[first + i];
            var rank = 0u;
            for (var j = 0u; j < n; j++) { rank += u32(after(key, local_keys[j])); }
            keys[first + rank] = vec2u(key.y, slot);
        }
        return;
    }
    if (n <= SHORT) {
        for (var i = lane; i < n; i += GROUP) {
            local_keys[i] = keys[first + i];
            local_slots[i] = pair_slots[first + i];
        }
        workgroupBarrier();
        for (var block = 1u; (1u << block) < 2u * n; block++) {
            let comparisons = (((n - 1u) >> block) + 1u) << (block - 1u);
            for (var i = lane; i < comparisons; i += GROUP) { compare_local(mirrored(i, block), n); }
            workgroupBarrier();
            for (var distance = block - 1u; distance > 0u; distance--) {
                for (var i = lane; i < comparisons; i += GROUP) { compare_local(apart(i, distance - 1u), n); }
                workgroupBarrier();
            }
        }
        for (var i = lane; i < n; i += GROUP) { keys[first + i] = vec2u(local_keys[i].y, local_slots[i]); }
        return;
    }
    for (var block = 1u; (1u << block) < 2u * n; block++) {
        let comparisons = (((n - 1u) >> block) + 1u) << (block - 1u);
        for (var i = lane; i < comparisons; i += GROUP) { compare_far(first, mirrored(i, block), n); }
        storageBarrier();
        for (var distance = block - 1u; distance > 0u; distance--) {
            for (var i = lane; i < comparisons; i += GROUP) { compare_far(first, apart(i, distance - 1u), n); }
            storageBarrier();
        }
    }
    for (var i = lane; i < n; i += GROUP) {
        keys[first + i] = vec2u(keys[first + i].y, pair_slots[first + i]);
    }
}
