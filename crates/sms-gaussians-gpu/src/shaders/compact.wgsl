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
    let to = id.x / 8u;
    let part = id.x % 8u;
    if (to >= u.counts.x) { return; }
    let from_row = kept[to];
    new_rows[8u * to + part] = rows[8u * from_row + part];
    new_moments[16u * to + part] = moments[16u * from_row + part];
    new_moments[16u * to + 8u + part] = moments[16u * from_row + 8u + part];
    if (part == 0u) { new_steps[to] = steps[from_row]; }
}
