// Copies each Gaussian's position and logit of its opacity, which the schedule asks for more often than for all else.

@group(0) @binding(0) var<storage, read> rows: array<vec4f>;
@group(0) @binding(1) var<storage, read_write> places: array<vec4f>;

@compute @workgroup_size(128)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (id.x < u.counts.x) { places[id.x] = rows[ROW_VECTORS * id.x]; }
}
