// The classifier on the blended affinities, cross-entropy and all gradients (paper, Section "Scan"; sms-gaussians,
// cpu/perceptron.rs). Each workgroup takes every so many tiles, one pixel per lane, and sums its share of the
// classifier's gradient in registers: 64 pixels of each tile pass through workgroup memory.

@group(0) @binding(0) var<storage, read> image: array<vec4f>;
@group(0) @binding(1) var<storage, read_write> gradient: array<vec4f>;
// w1 [32][16], b1 [32], w2 [classes][32], b2 [classes].
@group(0) @binding(2) var<storage, read> stored: array<vec4f>;
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
// The constant cache serves fewer reads than workgroup memory.
var<workgroup> classifier: array<vec4f, CLASSIFIER_VECTORS>;
// Pixel by pixel, one vector of padding against bank conflicts. First hidden and ∂L/∂logits, then affinity and
// ∂L/∂hidden.
const STRIDE = HIDDEN + max(CLASS_VECTORS, 8u) + 1u;
var<workgroup> staged: array<vec4f, 64u * STRIDE>;
var<workgroup> sums: array<f32, 64>;
var<workgroup> labelled: atomic<u32>;

// A row of the first layer with the affinity; a row of the second with the hidden layer.
fn row1(at: u32, x0: vec4f, x1: vec4f, x2: vec4f, x3: vec4f) -> f32 {
    return dot(classifier[at], x0) + dot(classifier[at + 1u], x1) + dot(classifier[at + 2u], x2)
        + dot(classifier[at + 3u], x3);
}

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    //unroll r 4
    var d_w1_$r = vec4f();
    //end
    var d_b1 = vec4f();
    //unroll part PARTS2
    //unroll r 4
    var d_w2_$part_$r = vec4f();
    //end
    var d_b2_$part = vec4f();
    //end
    // Block of the first layer: four hidden values by four of affinity, half of the pixels.
    let block1 = lane % 32u;
    let from1 = 32u * (lane / 32u);
    for (var i = lane; i < CLASSIFIER_VECTORS; i += 64u) { classifier[i] = stored[i]; }
    workgroupBarrier();
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
            //unroll q 4
            gradient[o + $qu * TILE_PIXELS] = vec4f();
            //end
            continue;
        }
        let mine = STRIDE * lane;
        //unroll q 4
        let x$q = image[o + $qu * TILE_PIXELS];
        //end
        //unroll j 8
        let h$j = max(classifier[B1 + $ju] + vec4f(
            row1(16u * $ju, x0, x1, x2, x3),
            row1(16u * $ju + 4u, x0, x1, x2, x3),
            row1(16u * $ju + 8u, x0, x1, x2, x3),
            row1(16u * $ju + 12u, x0, x1, x2, x3),
        ), vec4f(0.0));
        staged[mine + $ju] = h$j;
        //end
        var largest = -3.0e38;
        var own = 0.0;
        //unroll k CLASSES
        var p$k = classifier[B2 + $ku / 4u][$ku % 4u];
        //unroll j 8
        p$k += dot(classifier[W2 + 8u * $ku + $ju], h$j);
        //end
        largest = max(largest, p$k);
        own = select(own, p$k, $ku == label);
        //end
        var sum = 0.0;
        //unroll k CLASSES
        p$k = exp2((p$k - largest) * LOG2_E);
        sum += p$k;
        //end
        if (used) { loss += log2(sum) * LN_2 + largest - own; }
        let scale = select(0.0, u.pixel_weights.w, used);
        let factor = scale / sum;
        //unroll j 8
        var dh$j = vec4f();
        //end
        //unroll k PADDED
        staged[mine + HIDDEN + $ku / 4u][$ku % 4u] = 0.0;
        //end
        //unroll k CLASSES
        p$k = p$k * factor - select(0.0, scale, $ku == label);
        staged[mine + HIDDEN + $ku / 4u][$ku % 4u] = p$k;
        //unroll j 8
        dh$j += p$k * classifier[W2 + 8u * $ku + $ju];
        //end
        //end
        //unroll q 4
        var dx$q = vec4f();
        //end
        //unroll j 8
        dh$j = select(vec4f(0.0), dh$j, h$j > vec4f(0.0));
        //unroll q 4
        dx$q += dh$j.x * classifier[16u * $ju + $qu] + dh$j.y * classifier[16u * $ju + 4u + $qu]
            + dh$j.z * classifier[16u * $ju + 8u + $qu] + dh$j.w * classifier[16u * $ju + 12u + $qu];
        //end
        //end
        //unroll q 4
        gradient[o + $qu * TILE_PIXELS] = dx$q;
        //end
        workgroupBarrier();
        //unroll part PARTS2
        {
            let e = lane + 64u * $partu;
            if (e < BLOCKS2 * SPLIT2) {
                let block = e % BLOCKS2;
                let from2 = (e / BLOCKS2) * (64u / SPLIT2);
                for (var px = from2; px < from2 + 64u / SPLIT2; px++) {
                    let d = staged[px * STRIDE + HIDDEN + block / 8u];
                    let v = staged[px * STRIDE + block % 8u];
                    d_w2_$part_0 += d.x * v;
                    d_w2_$part_1 += d.y * v;
                    d_w2_$part_2 += d.z * v;
                    d_w2_$part_3 += d.w * v;
                    d_b2_$part += d;
                }
            }
        }
        //end
        workgroupBarrier();
        //unroll q 4
        staged[mine + $qu] = x$q;
        //end
        //unroll j 8
        staged[mine + HIDDEN + $ju] = dh$j;
        //end
        workgroupBarrier();
        for (var px = from1; px < from1 + 32u; px++) {
            let d = staged[px * STRIDE + HIDDEN + block1 / 4u];
            let v = staged[px * STRIDE + block1 % 4u];
            d_w1_0 += d.x * v;
            d_w1_1 += d.y * v;
            d_w1_2 += d.z * v;
            d_w1_3 += d.w * v;
            d_b1 += d;
        }
        workgroupBarrier();
    }
    // The parts of the pixels together, in their order, by the lanes that hold the first.
    let share = 4u * CLASSIFIER_VECTORS * group.x;
    //unroll r 4
    staged[5u * lane + $ru] = d_w1_$r;
    //end
    staged[5u * lane + 4u] = d_b1;
    workgroupBarrier();
    if (lane < 32u) {
        let at = share + 64u * (lane / 4u) + 4u * (lane % 4u);
        //unroll r 4
        write_share(at + 16u * $ru, d_w1_$r + staged[5u * (lane + 32u) + $ru]);
        //end
        if (lane % 4u == 0u) { write_share(share + 4u * B1 + lane, d_b1 + staged[5u * (lane + 32u) + 4u]); }
    }
    //unroll part PARTS2
    workgroupBarrier();
    //unroll r 4
    staged[5u * lane + $ru] = d_w2_$part_$r;
    //end
    staged[5u * lane + 4u] = d_b2_$part;
    workgroupBarrier();
    // Only where a lane has one block are blocks split.
    if (lane + 64u * $partu < BLOCKS2 && (SPLIT2 == 1u || lane < BLOCKS2)) {
        let block = lane + 64u * $partu;
        let k = 4u * (block / 8u);
        for (var r = 0u; r < 5u; r++) {
            var sum = vec4f();
            for (var s = 0u; s < SPLIT2; s++) { sum += staged[5u * (lane + s * BLOCKS2) + r]; }
            if (r < 4u && k + r < CLASSES) {
                write_share(share + 4u * W2 + 32u * (k + r) + 4u * (block % 8u), sum);
            }
            if (r == 4u && block % 8u == 0u) {
                for (var i = 0u; i < 4u; i++) {
                    if (k + i < CLASSES) { shares[share + 4u * B2 + k + i] = sum[i]; }
                }
            }
        }
    }
    //end
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
