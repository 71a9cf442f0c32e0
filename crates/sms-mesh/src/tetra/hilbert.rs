//! Insertion order for incremental constructions: biased random rounds, each along a Hilbert curve (BRIO; Amenta,
//! Choi and Rote, "Incremental constructions con BRIO", SoCG 2003).

use glamx::DVec3;

const BITS: u32 = 16;
const ROUNDS: u32 = 12;

/// Position along a Hilbert curve of order [`BITS`] (Skilling, "Programming the Hilbert curve", 2004).
fn hilbert_index(cell: [u32; 3]) -> u64 {
    let mut x = cell;
    for q in (1..BITS).rev().map(|bit| 1 << bit) {
        let low = q - 1;
        for i in 0..3 {
            if x[i] & q != 0 {
                x[0] ^= low;
            } else {
                let swap = (x[0] ^ x[i]) & low;
                x[0] ^= swap;
                x[i] ^= swap;
            }
        }
    }
    x[1] ^= x[0];
    x[2] ^= x[1];
    let mut flip = 0;
    for q in (1..BITS).map(|bit| 1 << bit) {
        if x[2] & q != 0 {
            flip ^= q - 1;
        }
    }
    for v in &mut x {
        *v ^= flip;
    }
    (0..BITS).rev().fold(0u64, |key, bit| x.iter().fold(key, |k, v| k << 1 | u64::from(v >> bit & 1)))
}

/// Mixes an index into 64 well-spread bits (SplitMix64 finaliser).
fn mix(index: u64) -> u64 {
    let mut z = index.wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    z = (z ^ z >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ z >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ z >> 31
}

/// Returns the indices of `points` in insertion order. The rounds depend only on the indices: the same points give the
/// same order on every machine.
pub(crate) fn insertion_order(points: &[DVec3]) -> Vec<u32> {
    let Some(bounds) = sms_core::Aabb::of_points(points.iter().copied()) else { return Vec::new() };
    let scale = f64::from((1u32 << BITS) - 1) / bounds.extents().max_element().max(f64::MIN_POSITIVE);
    let mut keyed: Vec<(u32, u64, u32)> = points
        .iter()
        .enumerate()
        .map(|(i, &p)| {
            // Each round is twice as large as the previous one.
            let round = ROUNDS - mix(i as u64).leading_zeros().min(ROUNDS);
            let cell = ((p - bounds.min) * scale).to_array().map(|v| v as u32);
            (round, hilbert_index(cell), i as u32)
        })
        .collect();
    keyed.sort_unstable();
    keyed.into_iter().map(|k| k.2).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_on_the_curve_are_neighbours_in_space() {
        let n = 8u32;
        let mut cells: Vec<[u32; 3]> =
            (0..n * n * n).map(|i| [i % n, i / n % n, i / n / n].map(|v| v << (BITS - 3))).collect();
        cells.sort_by_key(|&c| hilbert_index(c));
        for pair in cells.windows(2) {
            let step: u32 = (0..3).map(|k| pair[0][k].abs_diff(pair[1][k])).sum();
            assert_eq!(step, 1 << (BITS - 3));
        }
    }

    #[test]
    fn the_order_is_a_permutation() {
        let points: Vec<DVec3> =
            (0..1000).map(|i| DVec3::new((i % 7) as f64, (i % 11) as f64, 0.0)).collect();
        let mut order = insertion_order(&points);
        order.sort_unstable();
        assert!(order.iter().enumerate().all(|(i, &o)| i as u32 == o));
    }
}
