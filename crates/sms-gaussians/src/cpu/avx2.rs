//! [`Lanes`] on AVX2 and FMA: two registers. Values of this type are made only below functions that enable both
//! features.
#![expect(unsafe_code, reason = "intrinsics; reached only through `by_simd`, which checks the CPU")]

use super::lanes::{Chunk, JOINED_FIRST, Lanes, ROUNDING, WIDTH, exp2_fraction};
use std::arch::x86_64::*;
use std::ops::{Add, Div, Mul, Sub};

/// Sixteen `f32` in two registers.
#[derive(Clone, Copy)]
pub(super) struct Avx2(__m256, __m256);

macro_rules! lanewise {
    ($trait:ident, $method:ident, $intrinsic:ident) => {
        impl $trait for Avx2 {
            type Output = Self;
            #[inline(always)]
            fn $method(self, b: Self) -> Self {
                // SAFETY: see the module.
                unsafe { Self($intrinsic(self.0, b.0), $intrinsic(self.1, b.1)) }
            }
        }
    };
}
lanewise!(Add, add, _mm256_add_ps);
lanewise!(Sub, sub, _mm256_sub_ps);
lanewise!(Mul, mul, _mm256_mul_ps);
lanewise!(Div, div, _mm256_div_ps);

// SAFETY of every block below: the CPU has AVX2 and FMA (see the module); a `Chunk` and two `__m256` are both sixteen
// `f32` of any value.
impl Lanes for Avx2 {
    type Mask = (__m256, __m256);
    const MANY_REGISTERS: bool = false;

    #[inline(always)]
    fn splat(x: f32) -> Self {
        let v = unsafe { _mm256_set1_ps(x) };
        Self(v, v)
    }

    #[inline(always)]
    fn load(from: &Chunk) -> Self {
        // Not the load intrinsic, which checks its pointer on every call with debug assertions.
        let [a, b] = unsafe { std::mem::transmute::<Chunk, [__m256; 2]>(*from) };
        Self(a, b)
    }

    #[inline(always)]
    fn store(self, to: &mut Chunk) {
        *to = unsafe { std::mem::transmute::<[__m256; 2], Chunk>([self.0, self.1]) };
    }

    #[inline(always)]
    fn joined(first: f32, second: f32) -> Self {
        const _: () = assert!(JOINED_FIRST == 10, "the blend below takes two lanes");
        unsafe {
            let (a, b) = (_mm256_set1_ps(first), _mm256_set1_ps(second));
            Self(a, _mm256_blend_ps::<0b1111_1100>(a, b))
        }
    }

    #[inline(always)]
    fn halves(first: f32, second: f32) -> Self {
        unsafe { Self(_mm256_set1_ps(first), _mm256_set1_ps(second)) }
    }

    #[inline(always)]
    fn mul_add(self, b: Self, c: Self) -> Self {
        unsafe { Self(_mm256_fmadd_ps(self.0, b.0, c.0), _mm256_fmadd_ps(self.1, b.1, c.1)) }
    }

    #[inline(always)]
    fn neg_mul_add(self, b: Self, c: Self) -> Self {
        unsafe { Self(_mm256_fnmadd_ps(self.0, b.0, c.0), _mm256_fnmadd_ps(self.1, b.1, c.1)) }
    }

    #[inline(always)]
    fn min(self, b: Self) -> Self {
        unsafe { Self(_mm256_min_ps(self.0, b.0), _mm256_min_ps(self.1, b.1)) }
    }

    #[inline(always)]
    fn max(self, b: Self) -> Self {
        unsafe { Self(_mm256_max_ps(self.0, b.0), _mm256_max_ps(self.1, b.1)) }
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        unsafe { Self(_mm256_sqrt_ps(self.0), _mm256_sqrt_ps(self.1)) }
    }

    #[inline(always)]
    fn abs(self) -> Self {
        unsafe {
            let sign = _mm256_set1_ps(-0.0);
            Self(_mm256_andnot_ps(sign, self.0), _mm256_andnot_ps(sign, self.1))
        }
    }

    #[inline(always)]
    fn reciprocal(self) -> Self {
        // Twelve bits, doubled by one step of Newton's method: y + y(1 − xy).
        let y = unsafe { Self(_mm256_rcp_ps(self.0), _mm256_rcp_ps(self.1)) };
        self.neg_mul_add(y, Self::splat(1.0)).mul_add(y, y)
    }

    #[inline(always)]
    fn ge(self, b: Self) -> Self::Mask {
        unsafe { (_mm256_cmp_ps::<_CMP_GE_OQ>(self.0, b.0), _mm256_cmp_ps::<_CMP_GE_OQ>(self.1, b.1)) }
    }

    #[inline(always)]
    fn gt(self, b: Self) -> Self::Mask {
        unsafe { (_mm256_cmp_ps::<_CMP_GT_OQ>(self.0, b.0), _mm256_cmp_ps::<_CMP_GT_OQ>(self.1, b.1)) }
    }

    #[inline(always)]
    fn both(a: Self::Mask, b: Self::Mask) -> Self::Mask {
        unsafe { (_mm256_and_ps(a.0, b.0), _mm256_and_ps(a.1, b.1)) }
    }

    #[inline(always)]
    fn mask(bits: u16) -> Self::Mask {
        unsafe {
            let lane = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
            let first = _mm256_and_si256(_mm256_set1_epi32(i32::from(bits)), lane);
            let second = _mm256_and_si256(_mm256_set1_epi32(i32::from(bits >> 8)), lane);
            let (first, second) = (_mm256_cmpeq_epi32(first, lane), _mm256_cmpeq_epi32(second, lane));
            (_mm256_castsi256_ps(first), _mm256_castsi256_ps(second))
        }
    }

    #[inline(always)]
    fn keep(self, mask: Self::Mask) -> Self {
        unsafe { Self(_mm256_and_ps(self.0, mask.0), _mm256_and_ps(self.1, mask.1)) }
    }

    #[inline(always)]
    fn or_where_not(self, mask: Self::Mask, b: Self) -> Self {
        unsafe { Self(_mm256_blendv_ps(b.0, self.0, mask.0), _mm256_blendv_ps(b.1, self.1, mask.1)) }
    }

    #[inline(always)]
    fn bits(mask: Self::Mask) -> u32 {
        unsafe { (_mm256_movemask_ps(mask.0) | _mm256_movemask_ps(mask.1) << 8) as u32 }
    }

    #[inline(always)]
    fn any(mask: Self::Mask) -> bool {
        unsafe { _mm256_movemask_ps(_mm256_or_ps(mask.0, mask.1)) != 0 }
    }

    #[inline(always)]
    fn sum(self) -> f32 {
        unsafe {
            let eight = _mm256_add_ps(self.0, self.1);
            let four = _mm_add_ps(_mm256_castps256_ps128(eight), _mm256_extractf128_ps::<1>(eight));
            let two = _mm_add_ps(four, _mm_movehl_ps(four, four));
            _mm_cvtss_f32(_mm_add_ss(two, _mm_shuffle_ps::<1>(two, two)))
        }
    }

    #[inline(always)]
    fn exp2(self) -> Self {
        let t = self.max(Self::splat(-126.0));
        let shifted = t + Self::splat(ROUNDING);
        let p = exp2_fraction(t - (shifted - Self::splat(ROUNDING)));
        unsafe {
            let exponent = _mm256_slli_epi32::<23>(_mm256_castps_si256(shifted.0));
            let first = _mm256_castsi256_ps(_mm256_add_epi32(_mm256_castps_si256(p.0), exponent));
            let exponent = _mm256_slli_epi32::<23>(_mm256_castps_si256(shifted.1));
            Self(first, _mm256_castsi256_ps(_mm256_add_epi32(_mm256_castps_si256(p.1), exponent)))
        }
    }

    #[inline(always)]
    fn exponent_and_mantissa(self) -> (Self, Self) {
        unsafe {
            let bias = _mm256_set1_epi32(127);
            let first = _mm256_sub_epi32(_mm256_srli_epi32::<23>(_mm256_castps_si256(self.0)), bias);
            let second = _mm256_sub_epi32(_mm256_srli_epi32::<23>(_mm256_castps_si256(self.1)), bias);
            let (one, bits) = (_mm256_set1_ps(1.0), _mm256_castsi256_ps(_mm256_set1_epi32(0x7F_FFFF)));
            let mantissa = Self(
                _mm256_or_ps(_mm256_and_ps(self.0, bits), one),
                _mm256_or_ps(_mm256_and_ps(self.1, bits), one),
            );
            (Self(_mm256_cvtepi32_ps(first), _mm256_cvtepi32_ps(second)), mantissa)
        }
    }

    #[inline(always)]
    fn pack(first: Self, end: Self) -> [u32; WIDTH] {
        unsafe {
            let end0 = _mm256_slli_epi32::<16>(_mm256_cvttps_epi32(end.0));
            let end1 = _mm256_slli_epi32::<16>(_mm256_cvttps_epi32(end.1));
            std::mem::transmute::<[__m256i; 2], [u32; WIDTH]>([
                _mm256_or_si256(_mm256_cvttps_epi32(first.0), end0),
                _mm256_or_si256(_mm256_cvttps_epi32(first.1), end1),
            ])
        }
    }

    #[inline(always)]
    fn truncate(self) -> Self {
        const TO_ZERO: i32 = _MM_FROUND_TO_ZERO | _MM_FROUND_NO_EXC;
        unsafe { Self(_mm256_round_ps::<TO_ZERO>(self.0), _mm256_round_ps::<TO_ZERO>(self.1)) }
    }

    #[inline(always)]
    fn transpose(rows: [Self; WIDTH]) -> [Self; WIDTH] {
        let mut blocks = [[rows[0].0; 8]; 4];
        for i in 0..8 {
            blocks[0][i] = rows[i].0;
            blocks[1][i] = rows[i + 8].0;
            blocks[2][i] = rows[i].1;
            blocks[3][i] = rows[i + 8].1;
        }
        let [a, b, c, d] = blocks;
        let (a, b, c, d) = (transpose_eight(a), transpose_eight(b), transpose_eight(c), transpose_eight(d));
        let mut out = rows;
        for j in 0..8 {
            out[j] = Self(a[j], b[j]);
            out[j + 8] = Self(c[j], d[j]);
        }
        out
    }
}

#[inline(always)]
fn transpose_eight([a, b, c, d, e, f, g, h]: [__m256; 8]) -> [__m256; 8] {
    unsafe {
        let (ab0, ab1) = (_mm256_unpacklo_ps(a, b), _mm256_unpackhi_ps(a, b));
        let (cd0, cd1) = (_mm256_unpacklo_ps(c, d), _mm256_unpackhi_ps(c, d));
        let (ef0, ef1) = (_mm256_unpacklo_ps(e, f), _mm256_unpackhi_ps(e, f));
        let (gh0, gh1) = (_mm256_unpacklo_ps(g, h), _mm256_unpackhi_ps(g, h));
        let (p0, p1) = (_mm256_shuffle_ps::<0x44>(ab0, cd0), _mm256_shuffle_ps::<0xEE>(ab0, cd0));
        let (p2, p3) = (_mm256_shuffle_ps::<0x44>(ab1, cd1), _mm256_shuffle_ps::<0xEE>(ab1, cd1));
        let (q0, q1) = (_mm256_shuffle_ps::<0x44>(ef0, gh0), _mm256_shuffle_ps::<0xEE>(ef0, gh0));
        let (q2, q3) = (_mm256_shuffle_ps::<0x44>(ef1, gh1), _mm256_shuffle_ps::<0xEE>(ef1, gh1));
        [
            _mm256_permute2f128_ps::<0x20>(p0, q0),
            _mm256_permute2f128_ps::<0x20>(p1, q1),
            _mm256_permute2f128_ps::<0x20>(p2, q2),
            _mm256_permute2f128_ps::<0x20>(p3, q3),
            _mm256_permute2f128_ps::<0x31>(p0, q0),
            _mm256_permute2f128_ps::<0x31>(p1, q1),
            _mm256_permute2f128_ps::<0x31>(p2, q2),
            _mm256_permute2f128_ps::<0x31>(p3, q3),
        ]
    }
}
