// The classifier on the blended affinities, cross-entropy and all gradients (paper, Section "Scan"; sms-gaussians,
// cpu/perceptron.rs). Each workgroup takes every so many tiles, one pixel per lane, and sums its share of the
// classifier's gradient in registers: 64 pixels of each tile pass through workgroup memory.

@group(0) @binding(0) var<storage, read> image: array<vec4f>;
@group(0) @binding(1) var<storage, read_write> gradient: array<vec4f>;
// w1 [32][16], b1 [32], w2 [classes][32], b2 [classes].
@group(0) @binding(2) var<uniform> classifier: array<vec4f, CLASSIFIER_VECTORS>;
// One row per workgroup, laid out like the classifier.
@group(0) @binding(3) var<storage, read_write> shares: array<f32>;
@group(0) @binding(4) var<storage, read_write> partials: array<f32>;
@group(0) @binding(5) var<storage, read> control: array<u32>;
@group(1) @binding(1) var<storage, read> observed: array<vec4u>;

const B1 = 128u;
const W2 = 136u;
const B2 = W2 + 8u * CLASSES;
// Vectors of a pixel's hidden layer, and of its classes.
const HIDDEN = 8u;
const CLASS_VECTORS = (CLASSES + 3u) / 4u;
// A lane sums 4 x 4 blocks of the layers' gradients over some of the pixels: few reads from workgroup memory for many
// products. Blocks of the second layer, parts of the pixels that each is split into, and blocks of a lane.
const BLOCKS2 = 8u * CLASS_VECTORS;
const SPLIT2 = SPLIT_OF_CLASSES;
const PARTS2 = (BLOCKS2 * SPLIT2 + 63u) / 64u;
// Pixel by pixel, one vector of padding against bank conflicts. First hidden and ∂L/∂logits, then affinity and
// ∂L/∂hidden.
const STRIDE = HIDDEN + max(CLASS_VECTORS, 8u) + 1u;
var<workgroup> staged: array<vec4f, 64u * STRIDE>;
var<workgroup> sums: array<f32, 64>;
var<workgroup> labelled: atomic<u32>;

fn bias2(k: u32) -> f32 { return classifier[B2 + k / 4u][k % 4u]; }

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    var d_w1: array<vec4f, 4>;
    var d_b1 = vec4f();
    var d_w2: array<vec4f, 4u * PARTS2>;
    var d_b2: array<vec4f, PARTS2>;
    for (var i = 0u; i < 4u; i++) { d_w1[i] = vec4f(); }
    for (var i = 0u; i < 4u * PARTS2; i++) { d_w2[i] = vec4f(); }
    for (var i = 0u; i < PARTS2; i++) { d_b2[i] = vec4f(); }
    // Block of the first layer: four hidden values by four of affinity, half of the pixels.
    let block1 = lane % 32u;
    let from1 = 32u * (lane / 32u);
    var loss = 0.0;
    let tiles = u.size.z * u.size.w;
    for (var tile = group.x; tile < tiles; tile += u.groups.z) {
        let pixel = tile_corner(tile) + vec2u(lane % TILE, lane / TILE);
        var label = 0xffffu;
        if (all(pixel < u.size.xy)) {
            label = observed[2u * (pixel.y * u.size.x + pixel.x) + 1u].w & 0xffffu;
        }
        if ((patches_taken(tile) >> (lane / 16u) & 1u) == 0u) { label = 0xffffu; }
        let used = label != 0xffffu;
        if (lane == 0u) { atomicStore(&labelled, 0u); }
        workgroupBarrier();
        if (used) { atomicStore(&labelled, 1u); }
        workgroupBarrier();
        let o = tile * 6u * TILE_PIXELS + lane + 2u * TILE_PIXELS;
        let any_used = workgroupUniformLoad(&labelled) != 0u;
        if (!any_used) {
            for (var q = 0u; q < 4u; q++) { gradient[o + q * TILE_PIXELS] = vec4f(); }
            continue;
        }
        var x: array<vec4f, 4>;
        for (var q = 0u; q < 4u; q++) { x[q] = image[o + q * TILE_PIXELS]; }
        var h: array<vec4f, 8>;
        for (var j = 0u; j < 8u; j++) {
            var v = classifier[B1 + j];
            for (var i = 0u; i < 4u; i++) {
                let w = 16u * j + 4u * i;
                v[i] += dot(classifier[w], x[0]) + dot(classifier[w + 1u], x[1])
                    + dot(classifier[w + 2u], x[2]) + dot(classifier[w + 3u], x[3]);
            }
            h[j] = max(v, vec4f(0.0));
        }
        var p: array<f32, 4u * CLASS_VECTORS>;
        var largest = -3.0e38;
        var own = 0.0;
        for (var k = 0u; k < CLASSES; k++) {
            var logit = bias2(k);
            for (var j = 0u; j < 8u; j++) { logit += dot(classifier[W2 + 8u * k + j], h[j]); }
            p[k] = logit;
            largest = max(largest, logit);
            own = select(own, logit, k == label);
        }
        var sum = 0.0;
        for (var k = 0u; k < CLASSES; k++) {
            p[k] = exp2((p[k] - largest) * LOG2_E);
            sum += p[k];
        }
        if (used) { loss += log2(sum) * LN_2 + largest - own; }
        let scale = select(0.0, u.pixel_weights.w, used);
        let factor = scale / sum;
        var dh: array<vec4f, 8>;
        for (var j = 0u; j < 8u; j++) { dh[j] = vec4f(); }
        for (var k = 0u; k < CLASSES; k++) {
            let d = p[k] * factor - select(0.0, scale, k == label);
            p[k] = d;
            for (var j = 0u; j < 8u; j++) { dh[j] += d * classifier[W2 + 8u * k + j]; }
        }
        for (var k = CLASSES; k < 4u * CLASS_VECTORS; k++) { p[k] = 0.0; }
        var dx0 = vec4f(); var dx1 = vec4f(); var dx2 = vec4f(); var dx3 = vec4f();
        for (var j = 0u; j < 8u; j++) {
            dh[j] = select(vec4f(0.0), dh[j], h[j] > vec4f(0.0));
            for (var i = 0u; i < 4u; i++) {
                let w = 16u * j + 4u * i;
                let d = dh[j][i];
                dx0 += d * classifier[w];
                dx1 += d * classifier[w + 1u];
                dx2 += d * classifier[w + 2u];
                dx3 += d * classifier[w + 3u];
            }
        }
        gradient[o] = dx0;
        gradient[o + TILE_PIXELS] = dx1;
        gradient[o + 2u * TILE_PIXELS] = dx2;
        gradient[o + 3u * TILE_PIXELS] = dx3;

        let mine = STRIDE * lane;
        for (var j = 0u; j < 8u; j++) { staged[mine + j] = h[j]; }
        for (var q = 0u; q < CLASS_VECTORS; q++) {
            staged[mine + HIDDEN + q] = vec4f(p[4u * q], p[4u * q + 1u], p[4u * q + 2u], p[4u * q + 3u]);
        }
        workgroupBarrier();
        for (var part = 0u; part < PARTS2; part++) {
            let e = lane + 64u * part;
            if (e < BLOCKS2 * SPLIT2) {
                let block = e % BLOCKS2;
                let from2 = (e / BLOCKS2) * (64u / SPLIT2);
                for (var px = from2; px < from2 + 64u / SPLIT2; px++) {
                    let d = staged[px * STRIDE + HIDDEN + block / 8u];
                    let v = staged[px * STRIDE + block % 8u];
                    for (var r = 0u; r < 4u; r++) { d_w2[4u * part + r] += d[r] * v; }
                    d_b2[part] += d;
                }
            }
        }
        workgroupBarrier();
        for (var q = 0u; q < 4u; q++) { staged[mine + q] = x[q]; }
        for (var j = 0u; j < 8u; j++) { staged[mine + HIDDEN + j] = dh[j]; }
        workgroupBarrier();
        for (var px = from1; px < from1 + 32u; px++) {
            let d = staged[px * STRIDE + HIDDEN + block1 / 4u];
            let v = staged[px * STRIDE + block1 % 4u];
            for (var r = 0u; r < 4u; r++) { d_w1[r] += d[r] * v; }
            d_b1 += d;
        }
        workgroupBarrier();
    }
    // The parts of the pixels together, in their order, by the lanes that hold the first.
    let share = 4u * CLASSIFIER_VECTORS * group.x;
    for (var r = 0u; r < 4u; r++) { staged[5u * lane + r] = d_w1[r]; }
    staged[5u * lane + 4u] = d_b1;
    workgroupBarrier();
    if (lane < 32u) {
        for (var r = 0u; r < 4u; r++) {
            write_share(share + 16u * (4u * (lane / 4u) + r) + 4u * (lane % 4u), d_w1[r] + staged[5u * (lane + 32u) + r]);
        }
        if (lane % 4u == 0u) { write_share(share + 4u * B1 + lane, d_b1 + staged[5u * (lane + 32u) + 4u]); }
    }
    for (var part = 0u; part < PARTS2; part++) {
        workgroupBarrier();
        for (var r = 0u; r < 4u; r++) { staged[5u * lane + r] = d_w2[4u * part + r]; }
        staged[5u * lane + 4u] = d_b2[part];
        workgroupBarrier();
        let e = lane + 64u * part;
        // Only undivided blocks come in several parts.
        if (e < BLOCKS2 * SPLIT2 && (SPLIT2 == 1u || lane < BLOCKS2)) {
            let k = 4u * (e / 8u);
            for (var r = 0u; r < 4u; r++) {
                var sum = d_w2[4u * part + r];
                for (var s = 1u; s < SPLIT2; s++) { sum += staged[5u * (lane + s * BLOCKS2) + r]; }
                if (k + r < CLASSES) { write_share(share + 4u * W2 + 32u * (k + r) + 4u * (e % 8u), sum); }
            }
            if (e % 8u == 0u) {
                var sum = d_b2[part];
                for (var s = 1u; s < SPLIT2; s++) { sum += staged[5u * (lane + s * BLOCKS2) + 4u]; }
                for (var r = 0u; r < 4u; r++) {
                    if (k + r < CLASSES) { shares[share + 4u * B2 + k + r] = sum[r]; }
                }
            }
        }
    }
    sums[lane] = loss;
    workgroupBarrier();
    for (var half = 32u; half > 0u; half /= 2u) {
        if (lane < half) { sums[lane] += sums[lane + half]; }
        workgroupBarrier();
    }
    if (lane == 0u) { partials[SUM_SEGMENTATION * u.groups.w + group.x] = sums[0]; }
}

fn write_share(at: u32, v: vec4f) {
    for (var i = 0u; i < 4u; i++) { shares[at + i] = v[i]; }
}

// Products of 64-bit numbers, low word first.
fn wide_product(a: vec2u, b: vec2u) -> vec2u {
    let a0 = a.x & 0xffffu; let a1 = a.x >> 16u;
    let b0 = b.x & 0xffffu; let b1 = b.x >> 16u;
    let low = a0 * b0;
    let mid1 = a1 * b0 + (low >> 16u);
    let mid2 = a0 * b1 + (mid1 & 0xffffu);
    let high = a1 * b1 + (mid1 >> 16u) + (mid2 >> 16u);
    return vec2u((mid2 << 16u) | (low & 0xffffu), high + a.x * b.y + a.y * b.x);
}

fn mixed(z: vec2u, shift: u32) -> vec2u {
    return z ^ vec2u((z.x >> shift) | (z.y << (32u - shift)), z.y >> shift);
}

// Bits of the patches, two rows each, that this step's term takes of a tile: systematic sampling with the mixer of
// SplitMix64 (Steele et al. 2014), as the CPU's.
fn patches_taken(tile: u32) -> u32 {
    let share = u.other_weights.w;
    if (share >= 1.0) { return 15u; }
    var z = wide_product(vec2u(tile + 1u, control[CLASSIFIER_STEPS]), vec2u(0x7F4A7C15u, 0x9E3779B9u));
    z = wide_product(mixed(z, 30u), vec2u(0x1CE4E5B9u, 0xBF58476Du));
    z = wide_product(mixed(z, 27u), vec2u(0x133111EBu, 0x94D049BBu));
    z = mixed(z, 31u);
    let start = f32(z.y >> 8u) / 16777216.0;
    var bits = 0u;
    for (var k = 0u; k < 4u; k++) {
        if (floor(start + share * f32(k + 1u)) > floor(start + share * f32(k))) { bits |= 1u << ((z.x + k) % 4u); }
    }
    return bits;
}
