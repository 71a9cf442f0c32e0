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
// A splat over more tiles than this, about, is visited by the whole workgroup, a row of tiles to a lane: a lane alone took
// 0.6 ms for a splat close to the camera.
const MANY_TILES = 32.0;
var<workgroup> counts: array<u32, 128>;
var<workgroup> first_slot: u32;
// Lanes whose splats are large, and the one that is being visited.
var<workgroup> large: array<u32, 128>;
var<workgroup> large_count: atomic<u32>;
var<workgroup> large_rows: vec2u;
var<workgroup> large_mean: vec2f;
var<workgroup> large_outline: vec4f;
// Its first slot, depth and Gaussian.
var<workgroup> large_key: vec3u;

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
    var mean = vec2f();
    var rows = vec2u();
    var is_large = false;
    if (seen && !blocked) {
        mean = records[4u * g].xy;
        if (filling) {
            span = spans[g];
            depth = bitcast<u32>(records[4u * g + 2u].w);
        }
        let edges = vec2f(mean.y - outline.y, mean.y + outline.y);
        let last_row = f32(u.size.w);
        rows.x = u32(clamp(floor(edges.x * 0.125), 0.0, last_row));
        rows.y = u32(clamp(floor(edges.y * 0.125) + 1.0, 0.0, last_row));
        let most_columns = min(0.25 * outline.x + 2.0, f32(u.size.z));
        is_large = f32(max(rows.y, rows.x) - rows.x) * most_columns > MANY_TILES;
    }
    if (lane == 0u) { atomicStore(&large_count, 0u); }
    workgroupBarrier();
    if (is_large) {
        large[atomicAdd(&large_count, 1u)] = lane;
    } else {
        for (var row = rows.x; row < rows.y; row++) {
            let columns = tile_columns(mean, outline, row);
            for (var column = columns.x; column < columns.y; column++) {
                enter(row * u.size.z + column, span.x + count, depth, g, filling);
                count++;
            }
        }
    }
    let larges = workgroupUniformLoad(&large_count);
    for (var i = 0u; i < larges; i++) {
        // In whatever order: where a splat's pairs go depends on the splat alone.
        let owner = large[i];
        if (lane == owner) {
            large_rows = rows;
            large_mean = mean;
            large_outline = outline;
            large_key = vec3u(span.x, depth, g);
        }
        let all_rows = workgroupUniformLoad(&large_rows);
        var entered = 0u;
        for (var first_row = all_rows.x; first_row < all_rows.y; first_row += GROUP) {
            let row = first_row + lane;
            var columns = vec2u();
            if (row < all_rows.y) { columns = tile_columns(large_mean, large_outline, row); }
            let own = max(columns.y, columns.x) - columns.x;
            add_up(lane, own);
            let slot = large_key.x + entered + counts[lane] - own;
            for (var k = 0u; k < own; k++) {
                enter(row * u.size.z + columns.x + k, slot + k, large_key.y, large_key.z, filling);
            }
            entered += counts[GROUP - 1u];
            workgroupBarrier();
        }
        if (lane == owner) { count = entered; }
        workgroupBarrier();
    }
    if (filling) { return; }
    // Slots: a sum over the workgroup's Gaussians, one atomic for all of them. Which workgroup gets which slots does not
    // matter to any result.
    add_up(lane, count);
    if (lane == GROUP - 1u) {
        first_slot = atomicAdd(&control[PAIRS], counts[lane]);
    }
    workgroupBarrier();
    if (g < u.counts.x) {
        spans[g] = vec2u(first_slot + counts[lane] - count, count);
    }
}

// Counts a pair of tile and splat, or fills it in.
fn enter(tile: u32, slot: u32, depth: u32, g: u32, filling: bool) {
    let position = atomicAdd(&tile_counts[tile], 1u);
    if (filling && position < u.counts.y) {
        keys[position] = vec2u(depth, g);
        pair_slots[position] = slot;
    }
}

// Sums of `own` over the lanes up to each, into `counts`.
fn add_up(lane: u32, own: u32) {
    counts[lane] = own;
    workgroupBarrier();
    for (var offset = 1u; offset < GROUP; offset *= 2u) {
        var before = 0u;
        if (lane >= offset) { before = counts[lane - offset]; }
        workgroupBarrier();
        counts[lane] += before;
        workgroupBarrier();
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
