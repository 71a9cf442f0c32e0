// Shared by every kernel. Host constants stand in front of this text: TILE_PIXELS, LANES, CLASSES, LOG2_ALPHA_MIN, ...

alias vec2f = vec2<f32>;
alias vec3f = vec3<f32>;
alias vec4f = vec4<f32>;
alias vec2u = vec2<u32>;
alias vec3u = vec3<u32>;
alias vec4u = vec4<u32>;

// Inputs of a step besides the buffers; see `uniforms.rs`, which has the same fields in the same order.
struct Step {
    // Rotation from the world to the camera row by row, translation in w.
    camera: array<vec4f, 3>,
    // Focal lengths and principal point, pixels.
    intrinsics: vec4f,
    // Limits of x/z and y/z in the linearisation: low, high, low, high.
    limits: vec4f,
    // Width and height in pixels, columns and rows of tiles.
    size: vec4u,
    // Gaussians, room for pairs, index of the step in its batch, flags.
    counts: vec4u,
    // Columns and rows of 16 x 16 blocks, workgroups of the segmentation, length of a section of the partial sums.
    groups: vec4u,
    // Weight of one colour value, one depth, one normal value, one label.
    pixel_weights: vec4f,
    // Scale of the gradient of SSIM, weight of the isotropic term, of the flatness term, sampled share of the patches.
    other_weights: vec4f,
    // Colour behind all Gaussians.
    background: vec4f,
    // Learning rates: position, rotation, log-scale, opacity.
    rates: vec4f,
    // Learning rates: colour, affinity, classifier, view-dependent colour.
    more_rates: vec4f,
    // Share of the step out of the plane of a disc, and three unused numbers.
    off_plane: vec4f,
}

@group(1) @binding(0) var<uniform> u: Step;

const SEGMENTED = 1u;
const FLATTENING = 2u;
const DEPTH_NORMALIZED = 4u;
const DEPTH_DETACHED = 8u;

// Words of the control buffer.
const LIST_COUNTER = 0u;
const PAIRS = 1u;
const OVERFLOWED = 2u;
const PAIRS_WANTED = 3u;
const SEEN = 4u;
const STEPS_DONE = 5u;
const CLASSIFIER_STEPS = 6u;
const CLASSIFIER_STEPS_NEXT = 7u;
const LARGE = 8u;

// Sections of the partial sums.
const SUM_COLOR = 0u;
const SUM_DEPTH = 1u;
const SUM_NORMAL = 2u;
const SUM_SSIM = 3u;
const SUM_SEGMENTATION = 4u;
const SUM_ISOTROPIC = 5u;
const SUM_FLAT = 6u;
const SUMS = 7u;

const LN_2 = 0.6931471805599453;
const LOG2_E = 1.4426950408889634;
const TILE = 8u;

// Whether a number is neither infinite nor NaN.
fn is_finite(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x7f800000u) != 0x7f800000u;
}

fn all_finite(v: vec4f) -> bool {
    return is_finite(v.x) && is_finite(v.y) && is_finite(v.z) && is_finite(v.w);
}

// First pixel of a tile.
fn tile_corner(tile: u32) -> vec2u {
    return TILE * vec2u(tile % u.size.z, tile / u.size.z);
}

// Where a pixel of the image lies in buffers ordered by tiles, for the first of `channels` vectors per pixel.
fn tiled(p: vec2u, channels: u32) -> u32 {
    let tile = (p.y / TILE) * u.size.z + p.x / TILE;
    return tile * channels * TILE_PIXELS + (p.y % TILE) * TILE + p.x % TILE;
}
