//! [`Lanes`] on AVX-512 (F, BW, DQ, VL). Values of this type are made only below functions that enable them.
#![expect(unsafe_code, reason = "intrinsics; reached only through `by_simd`, which checks the CPU")]

use super::lanes::{Chunk, JOINED_FIRST, Lanes, WIDTH, exp2_fraction};
use std::arch::x86_64::*;
use std::ops::{Add, Div, Mul, Sub};

/// Sixteen `f32` in one register.
#[derive(Clone, Copy)]
pub(super) struct Avx512(__m512);

macro_rules! lanewise {
    ($trait:ident, $method:ident, $intrinsic:ident) => {
        impl $trait for Avx512 {
            type Output = Self;
            #[inline(always)]
            fn $method(self, b: Self) -> Self {
                // SAFETY: see the module.
                Self(unsafe { $intrinsic(self.0, b.0) })
            }
        }
    };
}
lanewise!(Add, add, _mm512_add_ps);
lanewise!(Sub, sub, _mm512_sub_ps);
lanewise!(Mul, mul, _mm512_mul_ps);
lanewise!(Div, div, _mm512_div_ps);

// SAFETY of every block below: the CPU has AVX-512 F, BW, DQ and VL (see the module); a `Chunk` and a `__m512` are both
// sixteen `f32` of any value.
impl Lanes for Avx512 {
    type Mask = __mmask16;
    const MANY_REGISTERS: bool = true;

    #[inline(always)]
    fn splat(x: f32) -> Self {
        Self(unsafe { _mm512_set1_ps(x) })
    }

    #[inline(always)]
    fn load(from: &Chunk) -> Self {
        // Not the load intrinsic, which checks its pointer on every call with debug assertions.
        Self(unsafe { std::mem::transmute::<Chunk, __m512>(*from) })
    }

    #[inline(always)]
    fn store(self, to: &mut Chunk) {
        *to = unsafe { std::mem::transmute::<__m512, Chunk>(self.0) };
    }

    #[inline(always)]
    fn joined(first: f32, second: f32) -> Self {
        const SECOND: __mmask16 = !0 << JOINED_FIRST;
        Self(unsafe { _mm512_mask_blend_ps(SECOND, _mm512_set1_ps(first), _mm512_set1_ps(second)) })
    }

    #[inline(always)]
    fn halves(first: f32, second: f32) -> Self {
        Self(unsafe { _mm512_mask_blend_ps(0xFF00, _mm512_set1_ps(first), _mm512_set1_ps(second)) })
    }

    #[inline(always)]
    fn mul_add(self, b: Self, c: Self) -> Self {
        Self(unsafe { _mm512_fmadd_ps(self.0, b.0, c.0) })
    }

    #[inline(always)]
    fn neg_mul_add(self, b: Self, c: Self) -> Self {
        Self(unsafe { _mm512_fnmadd_ps(self.0, b.0, c.0) })
    }

    #[inline(always)]
    fn min(self, b: Self) -> Self {
        Self(unsafe { _mm512_min_ps(self.0, b.0) })
    }

    #[inline(always)]
    fn max(self, b: Self) -> Self {
        Self(unsafe { _mm512_max_ps(self.0, b.0) })
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        Self(unsafe { _mm512_sqrt_ps(self.0) })
    }

    #[inline(always)]
    fn abs(self) -> Self {
        Self(unsafe { _mm512_abs_ps(self.0) })
    }

    #[inline(always)]
    fn reciprocal(self) -> Self {
        // Fourteen bits, doubled by one step of Newton's method: y + y(1 − xy).
        let y = Self(unsafe { _mm512_rcp14_ps(self.0) });
        self.neg_mul_add(y, Self::splat(1.0)).mul_add(y, y)
    }

    #[inline(always)]
    fn ge(self, b: Self) -> Self::Mask {
        unsafe { _mm512_cmp_ps_mask::<_CMP_GE_OQ>(self.0, b.0) }
    }

    #[inline(always)]
    fn gt(self, b: Self) -> Self::Mask {
        unsafe { _mm512_cmp_ps_mask::<_CMP_GT_OQ>(self.0, b.0) }
    }

    #[inline(always)]
    fn both(a: Self::Mask, b: Self::Mask) -> Self::Mask {
        a & b
    }

    #[inline(always)]
    fn mask(bits: u16) -> Self::Mask {
        bits
    }

    #[inline(always)]
    fn keep(self, mask: Self::Mask) -> Self {
        Self(unsafe { _mm512_maskz_mov_ps(mask, self.0) })
    }

    #[inline(always)]
    fn or_where_not(self, mask: Self::Mask, b: Self) -> Self {
        Self(unsafe { _mm512_mask_blend_ps(mask, b.0, self.0) })
    }

    #[inline(always)]
    fn bits(mask: Self::Mask) -> u32 {
        u32::from(mask)
    }

    #[inline(always)]
    fn sum(self) -> f32 {
        unsafe {
            let eight = _mm256_add_ps(_mm512_castps512_ps256(self.0), _mm512_extractf32x8_ps::<1>(self.0));
            let four = _mm_add_ps(_mm256_castps256_ps128(eight), _mm256_extractf128_ps::<1>(eight));
            let two = _mm_add_ps(four, _mm_movehl_ps(four, four));
            _mm_cvtss_f32(_mm_add_ss(two, _mm_shuffle_ps::<1>(two, two)))
        }
    }

    #[inline(always)]
    fn exp2(self) -> Self {
        // The remainder of x after rounding to a whole number.
        let fraction = Self(unsafe { _mm512_reduce_ps::<0>(self.0) });
        Self(unsafe { _mm512_scalef_ps(exp2_fraction(fraction).0, (self - fraction).0) })
    }

    #[inline(always)]
    fn exponent_and_mantissa(self) -> (Self, Self) {
        unsafe {
            let mantissa = _mm512_getmant_ps::<_MM_MANT_NORM_1_2, _MM_MANT_SIGN_SRC>(self.0);
            (Self(_mm512_getexp_ps(self.0)), Self(mantissa))
        }
    }

    #[inline(always)]
    fn pack(first: Self, end: Self) -> [u32; WIDTH] {
        unsafe {
            let end = _mm512_slli_epi32::<16>(_mm512_cvttps_epi32(end.0));
            std::mem::transmute::<__m512i, [u32; WIDTH]>(_mm512_or_si512(_mm512_cvttps_epi32(first.0), end))
        }
    }

    #[inline(always)]
    fn truncate(self) -> Self {
        const TO_ZERO: i32 = _MM_FROUND_TO_ZERO | _MM_FROUND_NO_EXC;
        Self(unsafe { _mm512_roundscale_ps::<TO_ZERO>(self.0) })
    }

    #[inline(always)]
    fn transpose(rows: [Self; WIDTH]) -> [Self; WIDTH] {
        unsafe {
            let mut pairs = [_mm512_setzero_ps(); WIDTH];
            for i in 0..8 {
                let (a, b) = (rows[2 * i].0, rows[2 * i + 1].0);
                pairs[2 * i] = _mm512_unpacklo_ps(a, b);
                pairs[2 * i + 1] = _mm512_unpackhi_ps(a, b);
            }
            // fours[4i + k] holds, in each quarter q, column 4q + k of rows 4i to 4i + 3.
            let mut fours = pairs;
            for i in 0..4 {
                let [a, b, c, d] = [pairs[4 * i], pairs[4 * i + 1], pairs[4 * i + 2], pairs[4 * i + 3]];
                fours[4 * i] = _mm512_shuffle_ps::<0x44>(a, c);
                fours[4 * i + 1] = _mm512_shuffle_ps::<0xEE>(a, c);
                fours[4 * i + 2] = _mm512_shuffle_ps::<0x44>(b, d);
                fours[4 * i + 3] = _mm512_shuffle_ps::<0xEE>(b, d);
            }
            let mut out = rows;
            for k in 0..4 {
                let [a, b, c, d] = [fours[k], fours[4 + k], fours[8 + k], fours[12 + k]];
                let (even0, even1) = (_mm512_shuffle_f32x4::<0x88>(a, b), _mm512_shuffle_f32x4::<0x88>(c, d));
                let (odd0, odd1) = (_mm512_shuffle_f32x4::<0xDD>(a, b), _mm512_shuffle_f32x4::<0xDD>(c, d));
                out[k] = Self(_mm512_shuffle_f32x4::<0x88>(even0, even1));
                out[8 + k] = Self(_mm512_shuffle_f32x4::<0xDD>(even0, even1));
                out[4 + k] = Self(_mm512_shuffle_f32x4::<0x88>(odd0, odd1));
                out[12 + k] = Self(_mm512_shuffle_f32x4::<0xDD>(odd0, odd1));
            }
            out
        }
    }
}
