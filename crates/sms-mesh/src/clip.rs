//! Cutting a set of triangles by a plane.

use glamx::DVec3;

/// Returns the triangles below and above a plane, cut where they cross it.
pub fn clip(triangles: &[[DVec3; 3]], n: DVec3, d: f64) -> (Vec<[DVec3; 3]>, Vec<[DVec3; 3]>) {
    let (mut below, mut above) = (Vec::new(), Vec::new());
    for t in triangles {
        let h = t.map(|p| p.dot(n) - d);
        if h.iter().all(|&h| h <= 0.0) {
            below.push(*t);
            continue;
        }
        if h.iter().all(|&h| h >= 0.0) {
            above.push(*t);
            continue;
        }
        let (mut low, mut high) = (Vec::with_capacity(4), Vec::with_capacity(4));
        for i in 0..3 {
            let j = (i + 1) % 3;
            if h[i] <= 0.0 {
                low.push(t[i]);
            }
            if h[i] >= 0.0 {
                high.push(t[i]);
            }
            if h[i] * h[j] < 0.0 {
                // Interpolate from the lower corner upwards, so that the neighbour across the edge gets the same point.
                let (a, b, ha, hb) =
                    if h[i] < 0.0 { (t[i], t[j], h[i], h[j]) } else { (t[j], t[i], h[j], h[i]) };
                let cut = a + (b - a) * (ha / (ha - hb));
                low.push(cut);
                high.push(cut);
            }
        }
        for (polygon, side) in [(low, &mut below), (high, &mut above)] {
            for k in 1..polygon.len().saturating_sub(1) {
                side.push([polygon[0], polygon[k], polygon[k + 1]]);
            }
        }
    }
    (below, above)
}
