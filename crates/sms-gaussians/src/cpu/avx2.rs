//! [`Lanes`] on AVX2 and FMA. Values of this type are made only below functions that enable both features.
#![expect(unsafe_code, reason = "intrinsics; reached only through `by_simd`, which checks the CPU")]

use super::lanes::{Chunk, Lanes, WIDTH};
use std::arch::x86_64::*;
use std::ops::{Add, Div, Mul, Sub};

/// Eight `f32` in one register.
#[derive(Clone, Copy)]
pub(super) struct Avx2(__m256);

macro_rules! lanewise {
    ($trait:ident, $method:ident, $intrinsic:ident) => {
        impl $trait for Avx2 {
            type Output = Self;
            #[inline(always)]
            fn $method(self, b: Self) -> Self {
                // SAFETY: see the module.
                Self(unsafe { $intrinsic(self.0, b.0) })
            }
        }
    };
}
lanewise!(Add, add, _mm256_add_ps);
lanewise!(Sub, sub, _mm256_sub_ps);
lanewise!(Mul, mul, _mm256_mul_ps);
lanewise!(Div, div, _mm256_div_ps);

// SAFETY of every block below: the CPU has AVX2 and FMA (see the module); a `Chunk` and a `__m256` are both eight
// `f32` of any value.
impl Lanes for Avx2 {
    #[inline(always)]
    fn splat(x: f32) -> Self {
        Self(unsafe { _mm256_set1_ps(x) })
    }

    #[inline(always)]
    fn load(from: &Chunk) -> Self {
        // Not the load intrinsic: with debug assertions on it checks its pointer every time.
        Self(unsafe { std::mem::transmute::<Chunk, __m256>(*from) })
    }

    #[inline(always)]
    fn store(self, to: &mut Chunk) {
        *to = unsafe { std::mem::transmute::<__m256, Chunk>(self.0) };
    }

    #[inline(always)]
    fn mul_add(self, b: Self, c: Self) -> Self {
        Self(unsafe { _mm256_fmadd_ps(self.0, b.0, c.0) })
    }

    #[inline(always)]
    fn min(self, b: Self) -> Self {
        Self(unsafe { _mm256_min_ps(self.0, b.0) })
    }

    #[inline(always)]
    fn max(self, b: Self) -> Self {
        Self(unsafe { _mm256_max_ps(self.0, b.0) })
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(unsafe { _mm256_sqrt_ps(self.0) })
    }

    #[inline(always)]
    fn ge(self, b: Self) -> Self {
        Self(unsafe { _mm256_cmp_ps::<_CMP_GE_OQ>(self.0, b.0) })
    }

    #[inline(always)]
    fn gt(self, b: Self) -> Self {
        Self(unsafe { _mm256_cmp_ps::<_CMP_GT_OQ>(self.0, b.0) })
    }

    #[inline(always)]
    fn and(self, mask: Self) -> Self {
        Self(unsafe { _mm256_and_ps(self.0, mask.0) })
    }

    #[inline(always)]
    fn and_not(self, mask: Self) -> Self {
        Self(unsafe { _mm256_andnot_ps(mask.0, self.0) })
    }

    #[inline(always)]
    fn count(self) -> u32 {
        unsafe { _mm256_movemask_ps(self.0) }.count_ones()
    }

    #[inline(always)]
    fn any(self) -> bool {
        unsafe { _mm256_movemask_ps(self.0) != 0 }
    }

    #[inline(always)]
    fn sum(self) -> f32 {
        unsafe {
            let four = _mm_add_ps(_mm256_castps256_ps128(self.0), _mm256_extractf128_ps::<1>(self.0));
            let two = _mm_add_ps(four, _mm_movehl_ps(four, four));
            _mm_cvtss_f32(_mm_add_ss(two, _mm_shuffle_ps::<1>(two, two)))
        }
    }

    #[inline(always)]
    fn scale_by_power_of_two(self, shifted: Self) -> Self {
        unsafe {
            let exponent = _mm256_slli_epi32::<23>(_mm256_castps_si256(shifted.0));
            Self(_mm256_castsi256_ps(_mm256_add_epi32(_mm256_castps_si256(self.0), exponent)))
        }
    }

    #[inline(always)]
    fn transpose(rows: [Self; WIDTH]) -> [Self; WIDTH] {
        unsafe {
            let [a, b, c, d, e, f, g, h] = rows.map(|r| r.0);
            let (ab0, ab1) = (_mm256_unpacklo_ps(a, b), _mm256_unpackhi_ps(a, b));
            let (cd0, cd1) = (_mm256_unpacklo_ps(c, d), _mm256_unpackhi_ps(c, d));
            let (ef0, ef1) = (_mm256_unpacklo_ps(e, f), _mm256_unpackhi_ps(e, f));
            let (gh0, gh1) = (_mm256_unpacklo_ps(g, h), _mm256_unpackhi_ps(g, h));
            let (p0, p1) = (_mm256_shuffle_ps::<0x44>(ab0, cd0), _mm256_shuffle_ps::<0xEE>(ab0, cd0));
            let (p2, p3) = (_mm256_shuffle_ps::<0x44>(ab1, cd1), _mm256_shuffle_ps::<0xEE>(ab1, cd1));
            let (q0, q1) = (_mm256_shuffle_ps::<0x44>(ef0, gh0), _mm256_shuffle_ps::<0xEE>(ef0, gh0));
            let (q2, q3) = (_mm256_shuffle_ps::<0x44>(ef1, gh1), _mm256_shuffle_ps::<0xEE>(ef1, gh1));
            [
                Self(_mm256_permute2f128_ps::<0x20>(p0, q0)),
                Self(_mm256_permute2f128_ps::<0x20>(p1, q1)),
                Self(_mm256_permute2f128_ps::<0x20>(p2, q2)),
                Self(_mm256_permute2f128_ps::<0x20>(p3, q3)),
                Self(_mm256_permute2f128_ps::<0x31>(p0, q0)),
                Self(_mm256_permute2f128_ps::<0x31>(p1, q1)),
                Self(_mm256_permute2f128_ps::<0x31>(p2, q2)),
                Self(_mm256_permute2f128_ps::<0x31>(p3, q3)),
            ]
        }
    }
}
