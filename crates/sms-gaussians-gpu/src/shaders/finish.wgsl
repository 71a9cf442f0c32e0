// Ends a step: sums the workgroups' shares of the classifier's gradient and moves it, eight values to a workgroup; the
// last workgroups sum a term of the loss each into the step's row of statistics. All sums have a fixed order.

@group(0) @binding(0) var<storage, read> shares: array<f32>;
@group(0) @binding(1) var<storage, read> partials: array<f32>;
@group(0) @binding(2) var<storage, read_write> classifier: array<vec4f>;
// First moments, then second.
@group(0) @binding(3) var<storage, read_write> moments: array<vec4f>;
@group(0) @binding(4) var<storage, read> corrections: array<vec2f>;
@group(0) @binding(5) var<storage, read_write> control: array<u32>;
@group(0) @binding(6) var<storage, read_write> stats: array<f32>;

var<workgroup> sums: array<f32, 256>;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let segmented = (u.counts.w & SEGMENTED) != 0u;
    let overflowed = control[OVERFLOWED] != 0u;
    if (group.x < CLASSIFIER_GROUPS) {
        // Lane = 8·(which shares) + (which value).
        let value = 8u * group.x + lane % 8u;
        var sum = 0.0;
        if (segmented && !overflowed) {
            for (var i = lane / 8u; i < u.groups.z; i += 32u) { sum += shares[4u * CLASSIFIER_VECTORS * i + value]; }
        }
        sums[lane] = sum;
        workgroupBarrier();
        for (var half = 128u; half >= 8u; half /= 2u) {
            if (lane < half) { sums[lane] += sums[lane + half]; }
            workgroupBarrier();
        }
        let vector = 2u * group.x + lane;
        if (lane < 2u && segmented && !overflowed && vector < CLASSIFIER_VECTORS) {
            let g = vec4f(sums[4u * lane], sums[4u * lane + 1u], sums[4u * lane + 2u], sums[4u * lane + 3u]);
            if (all_finite(g)) {
                let taken = min(control[CLASSIFIER_STEPS] + 1u, CORRECTIONS - 1u);
                let moved = adam(
                    classifier[vector], moments[vector], moments[CLASSIFIER_VECTORS + vector], g,
                    vec4f(u.more_rates.z), corrections[taken],
                );
                classifier[vector] = moved.value;
                moments[vector] = moved.first;
                moments[CLASSIFIER_VECTORS + vector] = moved.second;
            }
        }
        return;
    }
    let blocks = u.groups.x * u.groups.y;
    let gaussian_groups = (u.counts.x + 127u) / 128u;
    let row = 8u * u.counts.z;
    let s = group.x - CLASSIFIER_GROUPS;
    var count = blocks;
    if (s == SUM_SSIM && u.other_weights.x == 0.0) { count = 0u; }
    if (s == SUM_SEGMENTATION) { count = select(0u, u.groups.z, segmented); }
    if (s > SUM_SEGMENTATION) { count = gaussian_groups; }
    var sum = 0.0;
    for (var i = lane; i < count; i += 256u) { sum += partials[s * u.groups.w + i]; }
    sums[lane] = sum;
    workgroupBarrier();
    for (var half = 128u; half > 0u; half /= 2u) {
        if (lane < half) { sums[lane] += sums[lane + half]; }
        workgroupBarrier();
    }
    if (lane == 0u) { stats[row + s] = sums[0]; }
    if (lane == 0u && s == 0u && !overflowed) {
        stats[row + SUMS] = f32(control[SEEN]);
        control[STEPS_DONE] += 1u;
        if (segmented) { control[CLASSIFIER_STEPS_NEXT] = control[CLASSIFIER_STEPS] + 1u; }
    }
}
