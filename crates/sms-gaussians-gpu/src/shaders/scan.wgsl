// Where each tile's list starts: an exclusive sum over the tiles' counts, by one workgroup.

@group(0) @binding(0) var<storage, read_write> tile_counts: array<u32>;
@group(0) @binding(1) var<storage, read_write> offsets: array<u32>;
@group(0) @binding(2) var<storage, read_write> control: array<u32>;

const GROUP = 256u;
var<workgroup> sums: array<u32, 256>;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) lane: u32) {
    let tiles = u.size.z * u.size.w;
    let share = (tiles + GROUP - 1u) / GROUP;
    let first = min(lane * share, tiles);
    let end = min(first + share, tiles);
    var sum = 0u;
    for (var i = first; i < end; i++) { sum += tile_counts[i]; }
    sums[lane] = sum;
    workgroupBarrier();
    for (var offset = 1u; offset < GROUP; offset *= 2u) {
        var before = 0u;
        if (lane >= offset) { before = sums[lane - offset]; }
        workgroupBarrier();
        sums[lane] += before;
        workgroupBarrier();
    }
    let total = sums[GROUP - 1u];
    // With too little room all lists are empty, and this step and those behind it change nothing.
    let overflow = total > u.counts.y || control[OVERFLOWED] != 0u;
    var start = sums[lane] - sum;
    for (var i = first; i < end; i++) {
        let count = tile_counts[i];
        offsets[i] = select(start, 0u, overflow);
        tile_counts[i] = start;
        start += count;
    }
    workgroupBarrier();
    if (lane == 0u) {
        offsets[tiles] = select(total, 0u, overflow);
        control[PAIRS] = total;
        control[PAIR_COUNTER] = 0u;
        control[PAIRS_WANTED] = max(control[PAIRS_WANTED], total);
        if (overflow) { control[OVERFLOWED] = 1u; }
        control[SEEN] = 0u;
        control[CLASSIFIER_STEPS] = control[CLASSIFIER_STEPS_NEXT];
    }
}
