//! Smoothing kernels in three dimensions, of support radius H.

use super::lanes::SphLanes;
use serde::{Deserialize, Serialize};
use std::f32::consts::PI;

/// The smoothing kernel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SmoothingKernel {
    /// Wendland's C2 function: (1 − q)⁴ (1 + 4q). It prevents the pairing of particles (Dehnen and Aly 2012).
    #[default]
    WendlandC2,
    /// The cubic spline of Monaghan and Lattanzio (1985).
    CubicSpline,
}

/// A kernel's functions of q = r / H, without their constants.
pub(super) trait KernelShape: Sync {
    /// ∫ of the value over the ball of radius 1.
    const VOLUME: f32;
    /// Value; 0 for q ≥ 1.
    fn value<L: SphLanes>(q: L) -> L;
    /// −(dW/dq)/q, so that the gradient is −slope · x / H². Finite at q = 0; 0 for q ≥ 1.
    fn slope<L: SphLanes>(q: L) -> L;
}

pub(super) struct WendlandC2;

impl KernelShape for WendlandC2 {
    const VOLUME: f32 = 2.0 * PI / 21.0;

    #[inline(always)]
    fn value<L: SphLanes>(q: L) -> L {
        let t = (L::splat(1.0) - q).max(L::splat(0.0));
        let t2 = t * t;
        t2 * t2 * (L::splat(1.0) + L::splat(4.0) * q)
    }

    #[inline(always)]
    fn slope<L: SphLanes>(q: L) -> L {
        let t = (L::splat(1.0) - q).max(L::splat(0.0));
        L::splat(20.0) * t * t * t
    }
}

pub(super) struct CubicSpline;

impl KernelShape for CubicSpline {
    const VOLUME: f32 = PI / 16.0;

    #[inline(always)]
    fn value<L: SphLanes>(q: L) -> L {
        let zero = L::splat(0.0);
        let (t, s) = ((L::splat(1.0) - q).max(zero), (L::splat(0.5) - q).max(zero));
        t * t * t - L::splat(4.0) * s * s * s
    }

    #[inline(always)]
    fn slope<L: SphLanes>(q: L) -> L {
        let zero = L::splat(0.0);
        let (t, s) = ((L::splat(1.0) - q).max(zero), (L::splat(0.5) - q).max(zero));
        // 3t² − 12s² equals 12q − 9q² below one half; this division loses digits only at q = 0.
        (L::splat(3.0) * t * t - L::splat(12.0) * s * s) * q.max(L::splat(1e-3)).reciprocal()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sph::lanes::PortableLanes;

    fn one(f: fn(PortableLanes) -> PortableLanes, q: f32) -> f64 {
        f64::from(f(PortableLanes::splat(q)).0[3])
    }

    fn check<K: KernelShape>() {
        let n = 2000;
        let mut volume = 0.0;
        for i in 0..n {
            let q = (f64::from(i) + 0.5) / f64::from(n);
            volume +=
                one(K::value::<PortableLanes>, q as f32) * 4.0 * std::f64::consts::PI * q * q / f64::from(n);
            if q > 0.02 && q < 0.99 {
                let e = 2e-3;
                let slope = (one(K::value::<PortableLanes>, (q - e) as f32)
                    - one(K::value::<PortableLanes>, (q + e) as f32))
                    / (2.0 * e)
                    / q;
                assert!((one(K::slope::<PortableLanes>, q as f32) - slope).abs() < 2e-2, "{q}: {slope}");
            }
        }
        assert!((volume / f64::from(K::VOLUME) - 1.0).abs() < 1e-4, "{volume}");
        assert_eq!(one(K::value::<PortableLanes>, 1.5), 0.0);
        assert_eq!(one(K::slope::<PortableLanes>, 1.5), 0.0);
    }

    #[test]
    fn kernels_are_normalised_and_their_slopes_are_derivatives() {
        check::<WendlandC2>();
        check::<CubicSpline>();
    }
}
