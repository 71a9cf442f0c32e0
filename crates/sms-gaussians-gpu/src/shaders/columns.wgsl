// Shared by `visit` and `visit_large`: their buffers, and the tiles that an ellipse meets.

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
// Gaussians that are left to `visit_large`, in whatever order; control[LARGE] of them.
@group(0) @binding(8) var<storage, read_write> large: array<u32>;

const GROUP = 128u;

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

// Rows of tiles between the ellipse's extreme rows: first, and one past the last.
fn tile_rows(mean: vec2f, outline: vec4f) -> vec2u {
    let edges = vec2f(mean.y - outline.y, mean.y + outline.y);
    let last_row = f32(u.size.w);
    let first = u32(clamp(floor(edges.x * 0.125), 0.0, last_row));
    let end = u32(clamp(floor(edges.y * 0.125) + 1.0, 0.0, last_row));
    return vec2u(first, max(first, end));
}
