//! [`Lanes`] on plain arrays; the compiler vectorises them for the baseline instruction set.

use super::lanes::{Chunk, JOINED_FIRST, Lanes, ROUNDING, WIDTH, exp2_fraction};
use std::ops::{Add, Div, Mul, Sub};

/// Sixteen `f32` in memory.
#[derive(Clone, Copy)]
pub(super) struct Portable(Chunk);

impl Portable {
    #[inline(always)]
    fn from_fn(f: impl Fn(usize) -> f32) -> Self {
        let mut r = [0.0; WIDTH];
        for i in 0..WIDTH {
            r[i] = f(i);
        }
        Self(r)
    }

    #[inline(always)]
    fn mask_from_fn(f: impl Fn(usize) -> bool) -> [u32; WIDTH] {
        let mut r = [0; WIDTH];
        for i in 0..WIDTH {
            r[i] = if f(i) { u32::MAX } else { 0 };
        }
        r
    }
}

macro_rules! lanewise {
    ($trait:ident, $method:ident, $op:tt) => {
        impl $trait for Portable {
            type Output = Self;
            #[inline(always)]
            fn $method(self, b: Self) -> Self {
                Self::from_fn(|i| self.0[i] $op b.0[i])
            }
        }
    };
}
lanewise!(Add, add, +);
lanewise!(Sub, sub, -);
lanewise!(Mul, mul, *);
lanewise!(Div, div, /);

impl Lanes for Portable {
    type Mask = [u32; WIDTH];
    const MANY_REGISTERS: bool = false;

    #[inline(always)]
    fn splat(x: f32) -> Self {
        Self([x; WIDTH])
    }

    #[inline(always)]
    fn load(from: &Chunk) -> Self {
        Self(*from)
    }

    #[inline(always)]
    fn store(self, to: &mut Chunk) {
        *to = self.0;
    }

    #[inline(always)]
    fn joined(first: f32, second: f32) -> Self {
        Self::from_fn(|i| if i < JOINED_FIRST { first } else { second })
    }

    #[inline(always)]
    fn halves(first: f32, second: f32) -> Self {
        Self::from_fn(|i| if i < WIDTH / 2 { first } else { second })
    }

    #[inline(always)]
    fn mul_add(self, b: Self, c: Self) -> Self {
        // Not `f32::mul_add`, which is a library call without the instruction.
        self * b + c
    }

    #[inline(always)]
    fn neg_mul_add(self, b: Self, c: Self) -> Self {
        c - self * b
    }

    #[inline(always)]
    fn min(self, b: Self) -> Self {
        Self::from_fn(|i| if self.0[i] < b.0[i] { self.0[i] } else { b.0[i] })
    }

    #[inline(always)]
    fn max(self, b: Self) -> Self {
        Self::from_fn(|i| if self.0[i] > b.0[i] { self.0[i] } else { b.0[i] })
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        Self::from_fn(|i| self.0[i].sqrt())
    }

    #[inline(always)]
    fn abs(self) -> Self {
        Self::from_fn(|i| self.0[i].abs())
    }

    #[inline(always)]
    fn reciprocal(self) -> Self {
        Self::splat(1.0) / self
    }

    #[inline(always)]
    fn ge(self, b: Self) -> Self::Mask {
        Self::mask_from_fn(|i| self.0[i] >= b.0[i])
    }

    #[inline(always)]
    fn gt(self, b: Self) -> Self::Mask {
        Self::mask_from_fn(|i| self.0[i] > b.0[i])
    }

    #[inline(always)]
    fn both(a: Self::Mask, b: Self::Mask) -> Self::Mask {
        Self::mask_from_fn(|i| a[i] & b[i] != 0)
    }

    #[inline(always)]
    fn mask(bits: u16) -> Self::Mask {
        Self::mask_from_fn(|i| bits >> i & 1 != 0)
    }

    #[inline(always)]
    fn keep(self, mask: Self::Mask) -> Self {
        Self::from_fn(|i| f32::from_bits(self.0[i].to_bits() & mask[i]))
    }

    #[inline(always)]
    fn or_where_not(self, mask: Self::Mask, b: Self) -> Self {
        Self::from_fn(|i| f32::from_bits(self.0[i].to_bits() & mask[i] | b.0[i].to_bits() & !mask[i]))
    }

    #[inline(always)]
    fn bits(mask: Self::Mask) -> u32 {
        let mut bits = 0;
        for i in 0..WIDTH {
            bits |= (mask[i] & 1) << i;
        }
        bits
    }

    #[inline(always)]
    fn sum(self) -> f32 {
        let eight: [f32; 8] = std::array::from_fn(|i| self.0[i] + self.0[i + 8]);
        let four: [f32; 4] = std::array::from_fn(|i| eight[i] + eight[i + 4]);
        (four[0] + four[2]) + (four[1] + four[3])
    }

    #[inline(always)]
    fn exp2(self) -> Self {
        let t = self.max(Self::splat(-126.0));
        let shifted = t + Self::splat(ROUNDING);
        let p = exp2_fraction(t - (shifted - Self::splat(ROUNDING)));
        Self::from_fn(|i| f32::from_bits(p.0[i].to_bits().wrapping_add(shifted.0[i].to_bits() << 23)))
    }

    #[inline(always)]
    fn exponent_and_mantissa(self) -> (Self, Self) {
        let exponent = Self::from_fn(|i| ((self.0[i].to_bits() >> 23) as i32 - 127) as f32);
        let one = 1.0f32.to_bits();
        (exponent, Self::from_fn(|i| f32::from_bits(self.0[i].to_bits() & 0x7F_FFFF | one)))
    }

    #[inline(always)]
    fn pack(first: Self, end: Self) -> [u32; WIDTH] {
        std::array::from_fn(|i| first.0[i] as i32 as u32 | (end.0[i] as i32 as u32) << 16)
    }

    #[inline(always)]
    fn truncate(self) -> Self {
        Self::from_fn(|i| self.0[i] as i32 as f32)
    }

    #[inline(always)]
    fn transpose(rows: [Self; WIDTH]) -> [Self; WIDTH] {
        let mut r = rows;
        for i in 0..WIDTH {
            for j in 0..WIDTH {
                r[j].0[i] = rows[i].0[j];
            }
        }
        r
    }
}
