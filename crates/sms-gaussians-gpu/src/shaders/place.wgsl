// Gives each tile's list its place among the pairs. Which tile gets which place does not matter to any result, so a sum
// over each workgroup's tiles and one atomic are enough.

// In: pairs of each tile. Out: where its first pair goes.
@group(0) @binding(0) var<storage, read_write> tile_counts: array<u32>;
// Of each tile: its first pair and how many it has.
@group(0) @binding(1) var<storage, read_write> lists: array<vec2u>;
@group(0) @binding(2) var<storage, read_write> control: array<atomic<u32>>;

const GROUP = 256u;
var<workgroup> sums: array<u32, 256>;
var<workgroup> first_pair: u32;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) id: vec3u, @builtin(local_invocation_index) lane: u32) {
    let tile = id.x;
    let exists = tile < u.size.z * u.size.w;
    var count = 0u;
    if (exists) { count = tile_counts[tile]; }
    sums[lane] = count;
    workgroupBarrier();
    for (var offset = 1u; offset < GROUP; offset *= 2u) {
        var before = 0u;
        if (lane >= offset) { before = sums[lane - offset]; }
        workgroupBarrier();
        sums[lane] += before;
        workgroupBarrier();
    }
    if (lane == GROUP - 1u) { first_pair = atomicAdd(&control[LIST_COUNTER], sums[lane]); }
    workgroupBarrier();
    // With too little room all lists are empty, and this step and those behind it change nothing.
    let wanted = atomicLoad(&control[PAIRS]);
    let overflow = wanted > u.counts.y;
    if (exists) {
        let start = first_pair + sums[lane] - count;
        lists[tile] = select(vec2u(start, count), vec2u(0u), overflow);
        tile_counts[tile] = start;
    }
    if (id.x == 0u) {
        atomicMax(&control[PAIRS_WANTED], wanted);
        if (overflow) { atomicStore(&control[OVERFLOWED], 1u); }
    }
}
