// Visits the tiles that each splat's ellipse meets: once to count them, once to fill the tiles' lists. One pipeline does
// both, so that rounding cannot make the two disagree.

@group(0) @binding(0) var<storage, read> records: array<vec4f>;
@group(0) @binding(1) var<storage, read> outlines: array<vec4f>;
// Per Gaussian: its first slot and how many it has.
@group(0) @binding(2) var<storage, read_write> spans: array<vec2u>;
// While counting: pairs of each tile; while filling: where its next pair goes.
@group(0) @binding(3) var<storage, read_write> tile_counts: array<atomic<u32>>;
// Depth bits and Gaussian of each pair, and its slot.
@group(0) @binding(4) var<storage, read_write> keys: array<vec2u>;
@group(0) @binding(5) var<storage, read_write> pair_slots: array<u32>;
@group(0) @binding(6) var<storage, read_write> control: array<atomic<u32>>;
// 0 to count, 1 to fill.
@group(0) @binding(7) var<uniform> mode: vec4u;

const GROUP = 128u;
var<workgroup> counts: array<u32, 128>;
var<workgroup> first_slot: u32;

@compute @workgroup_size(128)
fn main(@builtin(global_invocation_id) id: vec3u, @builtin(local_invocation_index) lane: u32) {
    let g = id.x;
    let filling = mode.x == 1u;
    var outline = vec4f(-1.0);
    if (g < u.counts.x) { outline = outlines[g]; }
    let seen = outline.x >= 0.0;
    var count = 0u;
    var span = vec2u(0u);
    var depth = 0u;
    // After an overflow there are no lists to fill.
    let blocked = filling && atomicLoad(&control[PAIRS]) > u.counts.y;
    if (seen && !blocked) {
        let mean = records[4u * g].xy;
        if (filling) {
            span = spans[g];
            depth = bitcast<u32>(records[4u * g + 2u].w);
        }
        let rows = vec2f(mean.y - outline.y, mean.y + outline.y);
        let last_row = f32(u.size.w);
        let top = u32(clamp(floor(rows.x * 0.125), 0.0, last_row));
        let bottom = u32(clamp(floor(rows.y * 0.125) + 1.0, 0.0, last_row));
        for (var row = top; row < bottom; row++) {
            let columns = tile_columns(mean, outline, row);
            for (var column = columns.x; column < columns.y; column++) {
                let tile = row * u.size.z + column;
                let position = atomicAdd(&tile_counts[tile], 1u);
                if (filling && position < u.counts.y) {
                    keys[position] = vec2u(depth, g);
                    pair_slots[position] = span.x + count;
                }
                count++;
            }
        }
    }
    if (filling) { return; }
    // Slots: a sum over the workgroup's Gaussians, one atomic for all of them. Which workgroup gets which slots does not
    // matter to any result.
    counts[lane] = count;
    workgroupBarrier();
    for (var offset = 1u; offset < GROUP; offset *= 2u) {
        var before = 0u;
        if (lane >= offset) { before = counts[lane - offset]; }
        workgroupBarrier();
        counts[lane] += before;
        workgroupBarrier();
    }
    if (lane == GROUP - 1u) {
        first_slot = atomicAdd(&control[PAIRS], counts[lane]);
    }
    workgroupBarrier();
    if (g < u.counts.x) {
        spans[g] = vec2u(first_slot + counts[lane] - count, count);
    }
}

// Columns of tiles in which the ellipse meets the pixel centres of a row of tiles: first, and one past the last.
fn tile_columns(mean: vec2f, outline: vec4f, row: u32) -> vec2u {
    let half_x = outline.x;
    let half_y = outline.y;
    let half_row = outline.z;
    let slant = outline.w;
    // First and last row of pixel centres relative to the splat's centre, a little generous.
    let low = f32(row * TILE) + 0.5 - mean.y - 0.01;
    let high = low + 7.02;
    if (low > half_y || high < -half_y) { return vec2u(0u); }
    let from_y = max(low, -half_y);
    let to_y = min(high, half_y);
    // x = slant·y ± half_row·√(1 − (y/half_y)²) is extreme at the ellipse's own extreme row, or at the end of the
    // interval nearest to it.
    let extreme = slant * half_y * half_y / half_x;
    let y_left = clamp(-extreme, from_y, to_y);
    let y_right = clamp(extreme, from_y, to_y);
    let left_part = y_left / half_y;
    let right_part = y_right / half_y;
    let left = max(slant * y_left - half_row * sqrt(max(1.0 - left_part * left_part, 0.0)), -half_x);
    let right = min(slant * y_right + half_row * sqrt(max(1.0 - right_part * right_part, 0.0)), half_x);
    let slack = half_x * 1e-4 + 0.01;
    let columns = f32(u.size.z);
    let first = clamp((mean.x + left - slack - 7.5) * 0.125 + 1.0, 0.0, columns);
    let end = clamp((mean.x + right + slack - 0.5) * 0.125 + 1.0, 0.0, columns);
    return vec2u(u32(first), u32(end));
}
