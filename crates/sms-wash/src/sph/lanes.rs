//! Eight `f32` lanes. The sums over neighbours are written once against [`SphLanes`] and compiled twice: for plain
//! arrays and, inside functions that enable AVX2, for registers. Both give the same bits: lanes are independent, and
//! nothing is fused.

use std::ops::{Add, Mul, Sub};

/// Number of lanes.
pub(super) const WIDTH: usize = 8;

/// Eight numbers with the operations of the sums.
pub(super) trait SphLanes:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self>
{
    /// A number in every lane.
    fn splat(x: f32) -> Self;
    /// Eight numbers.
    fn load(from: &[f32; WIDTH]) -> Self;
    /// Larger of both.
    fn max(self, b: Self) -> Self;
    /// Smaller of both.
    fn min(self, b: Self) -> Self;
    /// Square root.
    fn sqrt(self) -> Self;
    /// 1/x.
    fn reciprocal(self) -> Self;
    /// The first `count` lanes; `other` in the rest.
    fn first(self, count: u32, other: Self) -> Self;
    /// Whether any lane is smaller than that of `b`.
    fn any_below(self, b: Self) -> bool;
    /// Sum of the lanes, always in the same order.
    fn sum(self) -> f32;

    /// Eight numbers of a slice from `start`.
    #[inline(always)]
    fn of(from: &[f32], start: usize) -> Self {
        Self::load(from[start..].first_chunk().expect("arrays are padded"))
    }
}

/// Portable implementation of [`SphLanes`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PortableLanes(pub(super) [f32; WIDTH]);

macro_rules! portable {
    ($trait:ident, $method:ident, $op:tt) => {
        impl $trait for PortableLanes {
            type Output = Self;
            #[inline(always)]
            fn $method(self, b: Self) -> Self {
                Self(std::array::from_fn(|i| self.0[i] $op b.0[i]))
            }
        }
    };
}
portable!(Add, add, +);
portable!(Sub, sub, -);
portable!(Mul, mul, *);

impl SphLanes for PortableLanes {
    #[inline(always)]
    fn splat(x: f32) -> Self {
        Self([x; WIDTH])
    }

    #[inline(always)]
    fn load(from: &[f32; WIDTH]) -> Self {
        Self(*from)
    }

    #[inline(always)]
    fn max(self, b: Self) -> Self {
        Self(std::array::from_fn(|i| if self.0[i] > b.0[i] { self.0[i] } else { b.0[i] }))
    }

    #[inline(always)]
    fn min(self, b: Self) -> Self {
        Self(std::array::from_fn(|i| if self.0[i] < b.0[i] { self.0[i] } else { b.0[i] }))
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(self.0.map(f32::sqrt))
    }

    #[inline(always)]
    fn reciprocal(self) -> Self {
        Self(self.0.map(|x| 1.0 / x))
    }

    #[inline(always)]
    fn first(self, count: u32, other: Self) -> Self {
        Self(std::array::from_fn(|i| if (i as u32) < count { self.0[i] } else { other.0[i] }))
    }

    #[inline(always)]
    fn any_below(self, b: Self) -> bool {
        (0..WIDTH).any(|i| self.0[i] < b.0[i])
    }

    #[inline(always)]
    fn sum(self) -> f32 {
        let [a, b, c, d, e, f, g, h] = self.0;
        ((a + e) + (c + g)) + ((b + f) + (d + h))
    }
}

#[cfg(target_arch = "x86_64")]
pub(super) use avx2::Avx2Lanes;

#[cfg(target_arch = "x86_64")]
mod avx2 {
    #![expect(unsafe_code, reason = "intrinsics; values are made only below functions that enable AVX2")]

    use super::{SphLanes, WIDTH};
    use std::arch::x86_64::*;
    use std::ops::{Add, Mul, Sub};

    /// Masks: a window of eight values that starts k before the middle begins with k ones.
    static WINDOW: [i32; 2 * WIDTH] = [-1, -1, -1, -1, -1, -1, -1, -1, 0, 0, 0, 0, 0, 0, 0, 0];

    /// AVX2 implementation of [`SphLanes`]. Values of this type are created only inside functions that enable AVX2.
    #[derive(Clone, Copy)]
    pub(in crate::sph) struct Avx2Lanes(__m256);

    macro_rules! lanewise {
        ($trait:ident, $method:ident, $intrinsic:ident) => {
            impl $trait for Avx2Lanes {
                type Output = Self;
                #[inline(always)]
                fn $method(self, b: Self) -> Self {
                    // SAFETY: see the type.
                    Self(unsafe { $intrinsic(self.0, b.0) })
                }
            }
        };
    }
    lanewise!(Add, add, _mm256_add_ps);
    lanewise!(Sub, sub, _mm256_sub_ps);
    lanewise!(Mul, mul, _mm256_mul_ps);

    // SAFETY of all blocks: see the type.
    impl SphLanes for Avx2Lanes {
        #[inline(always)]
        fn splat(x: f32) -> Self {
            Self(unsafe { _mm256_set1_ps(x) })
        }

        #[inline(always)]
        fn load(from: &[f32; WIDTH]) -> Self {
            // Not the load intrinsic, which checks its pointer every time with debug assertions.
            Self(unsafe { std::mem::transmute::<[f32; WIDTH], __m256>(*from) })
        }

        #[inline(always)]
        fn max(self, b: Self) -> Self {
            Self(unsafe { _mm256_max_ps(self.0, b.0) })
        }

        #[inline(always)]
        fn min(self, b: Self) -> Self {
            Self(unsafe { _mm256_min_ps(self.0, b.0) })
        }

        #[inline(always)]
        fn sqrt(self) -> Self {
            Self(unsafe { _mm256_sqrt_ps(self.0) })
        }

        #[inline(always)]
        fn reciprocal(self) -> Self {
            Self(unsafe { _mm256_div_ps(_mm256_set1_ps(1.0), self.0) })
        }

        #[inline(always)]
        fn first(self, count: u32, other: Self) -> Self {
            let window = WIDTH - (count as usize).min(WIDTH);
            let mask: &[i32; WIDTH] = WINDOW[window..].first_chunk().expect("it is twice as long");
            unsafe {
                let mask = std::mem::transmute::<[i32; WIDTH], __m256>(*mask);
                Self(_mm256_blendv_ps(other.0, self.0, mask))
            }
        }

        #[inline(always)]
        fn any_below(self, b: Self) -> bool {
            unsafe { _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LT_OQ>(self.0, b.0)) != 0 }
        }

        #[inline(always)]
        fn sum(self) -> f32 {
            unsafe {
                let four = _mm_add_ps(_mm256_castps256_ps128(self.0), _mm256_extractf128_ps::<1>(self.0));
                let two = _mm_add_ps(four, _mm_movehl_ps(four, four));
                _mm_cvtss_f32(_mm_add_ss(two, _mm_movehdup_ps(two)))
            }
        }
    }
}

#[cfg(all(test, target_arch = "x86_64"))]
mod tests {
    use super::*;

    #[inline(always)]
    fn everything<L: SphLanes>(a: &[f32; WIDTH], b: &[f32; WIDTH]) -> Vec<u32> {
        let (x, y) = (L::load(a), L::of(b, 0));
        let mut all = vec![x + y, x - y, x * y, x.max(y), x.min(y), y.sqrt(), x.reciprocal()];
        all.extend((0..=9).map(|count| x.first(count, y)));
        let weights = L::load(&[1.0, 3.0, 7.0, 11.0, 17.0, 23.0, 31.0, 41.0]);
        let mut bits: Vec<u32> = all.iter().map(|v| (*v * weights).sum().to_bits()).collect();
        bits.push(u32::from(x.any_below(y)));
        bits.push(u32::from(y.any_below(x)));
        bits.push(u32::from(x.any_below(x)));
        bits
    }

    #[target_feature(enable = "avx2")]
    fn with_registers(a: &[f32; WIDTH], b: &[f32; WIDTH]) -> Vec<u32> {
        everything::<Avx2Lanes>(a, b)
    }

    #[test]
    fn registers_and_arrays_give_the_same_bits() {
        if !std::arch::is_x86_feature_detected!("avx2") {
            println!("skipped: no AVX2");
            return;
        }
        let a = [0.1, -2.5, 3.7, 0.33, 1e-3, 9.0, -0.7, 5.1];
        let b = [1.7, 0.5, 2.2, 8.1, 0.9, 4.4, 1e-4, 6.3];
        #[expect(unsafe_code, reason = "the feature was just checked")]
        // SAFETY: the processor has AVX2.
        let registers = unsafe { with_registers(&a, &b) };
        assert_eq!(registers, everything::<PortableLanes>(&a, &b));
    }
}
