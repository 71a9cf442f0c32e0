// Visits the tiles that each splat's ellipse meets: once to count them, once to fill the tiles' lists. One pipeline does
// both, so that rounding cannot make the two disagree. Splats over many tiles are left to `visit_large`.

// A splat over more tiles than this, about, is large: a lane alone took 0.6 ms for one close to the camera.
const MANY_TILES = 32.0;
var<workgroup> counts: array<u32, 128>;
var<workgroup> first_slot: u32;

@compute @workgroup_size(128)
fn main(@builtin(global_invocation_id) id: vec3u, @builtin(local_invocation_index) lane: u32) {
    let g = id.x;
    let filling = mode.x == 1u;
    var outline = vec4f(-1.0);
    if (g < u.counts.x) { outline = outlines[g]; }
    var count = 0u;
    var is_large = false;
    // After an overflow there are no lists to fill.
    if (outline.x >= 0.0 && !(filling && atomicLoad(&control[PAIRS]) > u.counts.y)) {
        let mean = records[4u * g].xy;
        let rows = tile_rows(mean, outline);
        let most_columns = min(0.25 * outline.x + 2.0, f32(u.size.z));
        is_large = f32(rows.y - rows.x) * most_columns > MANY_TILES;
        if (is_large) {
            if (!filling) { large[atomicAdd(&control[LARGE], 1u)] = g; }
        } else {
            var span = vec2u(0u);
            var depth = 0u;
            if (filling) {
                span = spans[g];
                depth = bitcast<u32>(records[4u * g + 2u].w);
            }
            for (var row = rows.x; row < rows.y; row++) {
                let columns = tile_columns(mean, outline, row);
                for (var column = columns.x; column < columns.y; column++) {
                    let position = atomicAdd(&tile_counts[row * u.size.z + column], 1u);
                    if (filling && position < u.counts.y) {
                        keys[position] = vec2u(depth, g);
                        pair_slots[position] = span.x + count;
                    }
                    count++;
                }
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
    // A large one's is written later.
    if (g < u.counts.x && !is_large) {
        spans[g] = vec2u(first_slot + counts[lane] - count, count);
    }
}
