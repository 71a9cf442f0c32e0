// Copies the Gaussians that are kept, in their order.

@group(0) @binding(0) var<storage, read> kept: array<u32>;
@group(0) @binding(1) var<storage, read> rows: array<vec4f>;
@group(0) @binding(2) var<storage, read> moments: array<vec4f>;
@group(0) @binding(3) var<storage, read> steps: array<u32>;
@group(0) @binding(4) var<storage, read_write> new_rows: array<vec4f>;
@group(0) @binding(5) var<storage, read_write> new_moments: array<vec4f>;
@group(0) @binding(6) var<storage, read_write> new_steps: array<u32>;

@compute @workgroup_size(256)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let to = id.x / ROW_VECTORS;
    let part = id.x % ROW_VECTORS;
    if (to >= u.counts.x) { return; }
    let from_row = kept[to];
    new_rows[ROW_VECTORS * to + part] = rows[ROW_VECTORS * from_row + part];
    let first = 2u * ROW_VECTORS * to + part;
    let from_first = 2u * ROW_VECTORS * from_row + part;
    new_moments[first] = moments[from_first];
    new_moments[first + ROW_VECTORS] = moments[from_first + ROW_VECTORS];
    if (part == 0u) { new_steps[to] = steps[from_row]; }
}
