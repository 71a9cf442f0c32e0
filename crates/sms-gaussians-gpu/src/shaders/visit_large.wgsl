// `visit` for the splats over many tiles: several workgroups to a splat, and its pairs distributed over their lanes.
// They are few but crowd together, since they come from where the camera was close: a workgroup that took its own one
// after the other needed 0.2 ms.

// The splat that is being visited: Gaussian, first slot, depth.
var<workgroup> number: u32;
var<workgroup> key: vec3u;
var<workgroup> mean: vec2f;
var<workgroup> outline: vec4f;
var<workgroup> rows: vec2u;
// Of a row of tiles: its first column, and the pairs up to its end.
var<workgroup> first_column: array<u32, 128>;
var<workgroup> counts: array<u32, 128>;

@compute @workgroup_size(128)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let filling = mode.x == 1u;
    if (lane == 0u) {
        // After an overflow there are no lists to fill.
        let blocked = filling && atomicLoad(&control[PAIRS]) > u.counts.y;
        number = select(atomicLoad(&control[LARGE]), 0u, blocked);
    }
    let splats = workgroupUniformLoad(&number);
    for (var i = group.x; i < splats; i += groups.x) {
        if (lane == 0u) {
            let g = large[i];
            mean = records[4u * g].xy;
            outline = outlines[g];
            rows = tile_rows(mean, outline);
            key = vec3u(g, 0u, 0u);
            if (filling) { key = vec3u(g, spans[g].x, bitcast<u32>(records[4u * g + 2u].w)); }
        }
        let all_rows = workgroupUniformLoad(&rows);
        var entered = 0u;
        for (var first_row = all_rows.x; first_row < all_rows.y; first_row += GROUP) {
            let row = first_row + lane;
            var columns = vec2u();
            if (row < all_rows.y) { columns = tile_columns(mean, outline, row); }
            first_column[lane] = columns.x;
            counts[lane] = max(columns.y, columns.x) - columns.x;
            workgroupBarrier();
            for (var offset = 1u; offset < GROUP; offset *= 2u) {
                var before = 0u;
                if (lane >= offset) { before = counts[lane - offset]; }
                workgroupBarrier();
                counts[lane] += before;
                workgroupBarrier();
            }
            let pairs = counts[GROUP - 1u];
            for (var p = group.y * GROUP + lane; p < pairs; p += groups.y * GROUP) {
                // The first row whose end is beyond this pair.
                var at = 0u;
                for (var half = GROUP / 2u; half > 0u; half /= 2u) {
                    if (counts[at + half - 1u] <= p) { at += half; }
                }
                var before = 0u;
                if (at > 0u) { before = counts[at - 1u]; }
                let tile = (first_row + at) * u.size.z + first_column[at] + p - before;
                let position = atomicAdd(&tile_counts[tile], 1u);
                if (filling && position < u.counts.y) {
                    keys[position] = vec2u(key.z, key.x);
                    // Slots are in the order of rows and columns.
                    pair_slots[position] = key.y + entered + p;
                }
            }
            entered += pairs;
            workgroupBarrier();
        }
        if (!filling && group.y == 0u && lane == 0u) {
            spans[key.x] = vec2u(atomicAdd(&control[PAIRS], entered), entered);
        }
        workgroupBarrier();
    }
}
