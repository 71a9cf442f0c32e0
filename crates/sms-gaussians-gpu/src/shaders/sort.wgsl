// Sorts each tile's pairs by depth, equal depths by Gaussian: the order in which they were filled in is that of a race.
// A bitonic network whose comparisons all put the smaller first, so that a length that is no power of two needs no
// padding. Short lists are sorted in workgroup memory, long ones where they lie.

@group(0) @binding(0) var<storage, read> offsets: array<u32>;
@group(0) @binding(1) var<storage, read_write> tile_counts: array<u32>;
// In: depth bits and Gaussian. Out: Gaussian and slot.
@group(0) @binding(2) var<storage, read_write> keys: array<vec2u>;
@group(0) @binding(3) var<storage, read_write> pair_slots: array<u32>;

const GROUP = 128u;
const SHORT = 1024u;
var<workgroup> local_keys: array<vec2u, 1024>;
var<workgroup> local_slots: array<u32, 1024>;
var<workgroup> length: u32;

fn after(a: vec2u, b: vec2u) -> bool {
    return a.x > b.x || (a.x == b.x && a.y > b.y);
}

// The two places that comparison `i` of a pass looks at: mirrored within blocks of `block` in the first pass of a
// stage, `distance` apart in the others.
fn places(i: u32, block: u32, distance: u32) -> vec2u {
    if (distance == 0u) {
        let half = block / 2u;
        let base = (i / half) * block;
        let within = i % half;
        return vec2u(base + within, base + block - 1u - within);
    }
    let low = (i / distance) * 2u * distance + i % distance;
    return vec2u(low, low + distance);
}

@compute @workgroup_size(128)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let tile = group.x + group.y * MAX_GROUPS;
    if (tile >= u.size.z * u.size.w) { return; }
    let first = offsets[tile];
    if (lane == 0u) {
        length = offsets[tile + 1u] - first;
        tile_counts[tile] = 0u;
    }
    let n = workgroupUniformLoad(&length);
    if (n <= SHORT) {
        for (var i = lane; i < n; i += GROUP) {
            local_keys[i] = keys[first + i];
            local_slots[i] = pair_slots[first + i];
        }
        workgroupBarrier();
        for (var block = 2u; block < 2u * n; block *= 2u) {
            var distance = 0u;
            loop {
                let comparisons = min(block / 2u * ((n + block - 1u) / block), n);
                for (var i = lane; i < comparisons; i += GROUP) {
                    let at = places(i, block, distance);
                    if (at.y < n) {
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
                }
                workgroupBarrier();
                distance = select(distance / 2u, block / 4u, distance == 0u);
                if (distance == 0u) { break; }
            }
        }
        for (var i = lane; i < n; i += GROUP) {
            keys[first + i] = vec2u(local_keys[i].y, local_slots[i]);
        }
        return;
    }
    for (var block = 2u; block < 2u * n; block *= 2u) {
        var distance = 0u;
        loop {
            let comparisons = block / 2u * ((n + block - 1u) / block);
            for (var i = lane; i < comparisons; i += GROUP) {
                let at = places(i, block, distance);
                if (at.y < n) {
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
            }
            storageBarrier();
            distance = select(distance / 2u, block / 4u, distance == 0u);
            if (distance == 0u) { break; }
        }
    }
    for (var i = lane; i < n; i += GROUP) {
        keys[first + i] = vec2u(keys[first + i].y, pair_slots[first + i]);
    }
}
