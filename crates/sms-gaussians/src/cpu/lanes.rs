//! Eight `f32` at a time. The kernels are written once against [`Lanes`] and compiled twice: for the portable
//! [`Portable`], and inside functions that enable AVX2 and FMA for the type in `avx2.rs`.

use std::ops::{Add, Div, Mul, Sub};

/// Number of lanes.
pub(super) const WIDTH: usize = 8;

/// One vector's worth of memory.
pub(super) type Chunk = [f32; WIDTH];

/// Eight numbers with the operations that the kernels need. Masks are lanes with all bits set or none.
pub(super) trait Lanes:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self>
{
    /// The same number in every lane.
    fn splat(x: f32) -> Self;
    /// Reads eight numbers.
    fn load(from: &Chunk) -> Self;
    /// Writes eight numbers.
    fn store(self, to: &mut Chunk);
    /// `self · b + c`, rounded once where the hardware can.
    fn mul_add(self, b: Self, c: Self) -> Self;
    /// Smaller of both.
    fn min(self, b: Self) -> Self;
    /// Larger of both.
    fn max(self, b: Self) -> Self;
    /// Square root.
    fn sqrt(self) -> Self;
    /// Mask of `self ≥ b`; false where either is NaN.
    fn ge(self, b: Self) -> Self;
    /// Mask of `self > b`; false where either is NaN.
    fn gt(self, b: Self) -> Self;
    /// Bitwise and: keeps the lanes that a mask selects and zeroes the others.
    fn and(self, mask: Self) -> Self;
    /// Bitwise `self & !mask`.
    fn and_not(self, mask: Self) -> Self;
    /// Number of lanes whose sign bit is set: the selected ones of a mask.
    fn count(self) -> u32;
    /// Whether any lane of a mask is selected.
    fn any(self) -> bool;
    /// Sum of the lanes, always in the same order.
    fn sum(self) -> f32;
    /// `2^t` for `t` rounded by the magic-number trick; see [`Lanes::exp_nonpositive`].
    fn scale_by_power_of_two(self, shifted: Self) -> Self;
    /// Transposes eight vectors.
    fn transpose(rows: [Self; WIDTH]) -> [Self; WIDTH];

    /// `e^x` for `x ≤ 0`, relative error below 4e-7 down to x = −87; below that about 1e-38.
    #[inline(always)]
    fn exp_nonpositive(self) -> Self {
        // 2^t = 2^round(t) · 2^f; adding 1.5·2²³ leaves round(t) in the low mantissa bits.
        let magic = Self::splat(12_582_912.0);
        let t = (self * Self::splat(std::f32::consts::LOG2_E)).max(Self::splat(-126.0));
        let shifted = t + magic;
        let f = t - (shifted - magic);
        // Minimax polynomial of 2^f on [−½, ½].
        let p = f.mul_add(Self::splat(EXP2[5]), Self::splat(EXP2[4]));
        let p = p.mul_add(f, Self::splat(EXP2[3]));
        let p = p.mul_add(f, Self::splat(EXP2[2]));
        let p = p.mul_add(f, Self::splat(EXP2[1]));
        let p = p.mul_add(f, Self::splat(EXP2[0]));
        p.scale_by_power_of_two(shifted)
    }

    /// Sign of each lane: −1, 0 or 1; 0 for NaN.
    #[inline(always)]
    fn signum(self) -> Self {
        let (zero, one) = (Self::splat(0.0), Self::splat(1.0));
        one.and(self.gt(zero)) - one.and(zero.gt(self))
    }

    /// Absolute value.
    #[inline(always)]
    fn abs(self) -> Self {
        self.and_not(Self::splat(-0.0))
    }
}

/// Coefficients of the polynomial in [`Lanes::exp_nonpositive`], constant term first.
const EXP2: [f32; 6] = [1.0, 0.693_146_94, 0.240_221_2, 5.550_713e-2, 9.675_542e-3, 1.327_647_2e-3];

/// Plain arrays; the compiler vectorises them for the baseline instruction set.
#[derive(Clone, Copy)]
pub(super) struct Portable(Chunk);

macro_rules! lanewise {
    ($trait:ident, $method:ident, $op:tt) => {
        impl $trait for Portable {
            type Output = Self;
            #[inline(always)]
            fn $method(self, b: Self) -> Self {
                let mut r = self.0;
                for i in 0..WIDTH {
                    r[i] = self.0[i] $op b.0[i];
                }
                Self(r)
            }
        }
    };
}
lanewise!(Add, add, +);
lanewise!(Sub, sub, -);
lanewise!(Mul, mul, *);
lanewise!(Div, div, /);

#[inline(always)]
fn mask(selected: bool) -> f32 {
    f32::from_bits(if selected { u32::MAX } else { 0 })
}

impl Lanes for Portable {
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
    fn mul_add(self, b: Self, c: Self) -> Self {
        // Not `f32::mul_add`: without the instruction that is a library call.
        self * b + c
    }

    #[inline(always)]
    fn min(self, b: Self) -> Self {
        let mut r = self.0;
        for i in 0..WIDTH {
            r[i] = if self.0[i] < b.0[i] { self.0[i] } else { b.0[i] };
        }
        Self(r)
    }

    #[inline(always)]
    fn max(self, b: Self) -> Self {
        let mut r = self.0;
        for i in 0..WIDTH {
            r[i] = if self.0[i] > b.0[i] { self.0[i] } else { b.0[i] };
        }
        Self(r)
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        let mut r = self.0;
        for i in 0..WIDTH {
            r[i] = self.0[i].sqrt();
        }
        Self(r)
    }

    #[inline(always)]
    fn ge(self, b: Self) -> Self {
        let mut r = self.0;
        for i in 0..WIDTH {
            r[i] = mask(self.0[i] >= b.0[i]);
        }
        Self(r)
    }

    #[inline(always)]
    fn gt(self, b: Self) -> Self {
        let mut r = self.0;
        for i in 0..WIDTH {
            r[i] = mask(self.0[i] > b.0[i]);
        }
        Self(r)
    }

    #[inline(always)]
    fn and(self, mask: Self) -> Self {
        let mut r = self.0;
        for i in 0..WIDTH {
            r[i] = f32::from_bits(self.0[i].to_bits() & mask.0[i].to_bits());
        }
        Self(r)
    }

    #[inline(always)]
    fn and_not(self, mask: Self) -> Self {
        let mut r = self.0;
        for i in 0..WIDTH {
            r[i] = f32::from_bits(self.0[i].to_bits() & !mask.0[i].to_bits());
        }
        Self(r)
    }

    #[inline(always)]
    fn count(self) -> u32 {
        let mut n = 0;
        for i in 0..WIDTH {
            n += self.0[i].to_bits() >> 31;
        }
        n
    }

    #[inline(always)]
    fn any(self) -> bool {
        self.count() > 0
    }

    #[inline(always)]
    fn sum(self) -> f32 {
        let v = self.0;
        let four = [v[0] + v[4], v[1] + v[5], v[2] + v[6], v[3] + v[7]];
        (four[0] + four[2]) + (four[1] + four[3])
    }

    #[inline(always)]
    fn scale_by_power_of_two(self, shifted: Self) -> Self {
        let mut r = self.0;
        for i in 0..WIDTH {
            r[i] = f32::from_bits(self.0[i].to_bits().wrapping_add(shifted.0[i].to_bits() << 23));
        }
        Self(r)
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

/// Which compiled form of the kernels to use. Other than the portable one, a value is proof that the CPU has it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Simd {
    avx2: bool,
}

impl Simd {
    /// The best form that this CPU can run.
    pub(super) fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        let avx2 = std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma");
        #[cfg(not(target_arch = "x86_64"))]
        let avx2 = false;
        Self { avx2 }
    }

    /// The portable form.
    pub(super) fn portable() -> Self {
        Self { avx2: false }
    }

    /// Whether AVX2 and FMA are there.
    pub(super) fn avx2(self) -> bool {
        self.avx2
    }
}

/// Makes a function that runs a kernel, generic over [`Lanes`], in the form that its first argument names.
macro_rules! by_simd {
    ($(#[$doc:meta])* fn $name:ident = $kernel:ident($($arg:ident: $type:ty),* $(,)?) $(-> $result:ty)?) => {
        $(#[$doc])*
        pub(super) fn $name(simd: $crate::cpu::lanes::Simd, $($arg: $type),*) $(-> $result)? {
            #[cfg(target_arch = "x86_64")]
            if simd.avx2() {
                #[target_feature(enable = "avx2,fma")]
                fn wide($($arg: $type),*) $(-> $result)? {
                    $kernel::<$crate::cpu::avx2::Avx2>($($arg),*)
                }
                #[expect(unsafe_code, reason = "a `Simd` with AVX2 exists only where the CPU was found to have it")]
                // SAFETY: as above.
                return unsafe { wide($($arg),*) };
            }
            $kernel::<$crate::cpu::lanes::Portable>($($arg),*)
        }
    };
}
pub(super) use by_simd;

#[cfg(test)]
mod tests {
    use super::*;

    fn check_exp<L: Lanes>() {
        let mut worst = 0.0f64;
        for i in 0..200_000 {
            let x = -87.0 * (f64::from(i) / 200_000.0);
            let mut out = [0.0; WIDTH];
            L::splat(x as f32).exp_nonpositive().store(&mut out);
            let exact = f64::from(x as f32).exp();
            worst = worst.max((f64::from(out[3]) / exact - 1.0).abs());
        }
        // The argument reduction x·log₂e in f32 costs up to |x|·6e-8 beside the polynomial's 2e-7.
        assert!(worst < 6e-6, "{worst}");
        let mut near = 0.0f64;
        for i in 0..20_000 {
            let x = -5.6 * (f64::from(i) / 20_000.0);
            let mut out = [0.0; WIDTH];
            L::splat(x as f32).exp_nonpositive().store(&mut out);
            near = near.max((f64::from(out[0]) / f64::from(x as f32).exp() - 1.0).abs());
        }
        println!("exp: largest relative error {worst:.2e}, for alpha's range {near:.2e}");
        assert!(near < 1e-6, "{near}");
    }

    fn check_shuffles<L: Lanes>() {
        let mut rows = [L::splat(0.0); WIDTH];
        for (i, row) in rows.iter_mut().enumerate() {
            let values: Chunk = std::array::from_fn(|j| (10 * i + j) as f32);
            *row = L::load(&values);
            assert_eq!(row.sum(), values.iter().sum::<f32>());
        }
        for (j, column) in L::transpose(rows).into_iter().enumerate() {
            let mut out = [0.0; WIDTH];
            column.store(&mut out);
            assert_eq!(out, std::array::from_fn(|i| (10 * i + j) as f32));
        }
        let v = L::load(&[-2.0, 0.0, 3.0, f32::NAN, 1.0, -0.0, f32::INFINITY, 5.0]);
        assert_eq!(v.gt(L::splat(0.0)).count(), 4);
        assert_eq!(v.ge(L::splat(0.0)).count(), 6);
        assert!(v.gt(L::splat(4.0)).any() && !L::splat(f32::NAN).gt(v).any());
        let mut sign = [9.0; WIDTH];
        v.signum().store(&mut sign);
        assert_eq!(sign, [-1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 1.0]);
    }

    fn check<L: Lanes>() {
        check_exp::<L>();
        check_shuffles::<L>();
    }

    by_simd! { fn check_by = check() }

    #[test]
    fn exponential_and_shuffles_are_right_in_every_form() {
        check_by(Simd::portable());
        check_by(Simd::detect());
    }
}
