//! Sixteen `f32` at a time. The kernels are written once against [`Lanes`] and compiled three times: for the plain
//! arrays of `portable`, and inside functions that enable AVX2 with FMA or AVX-512 for the types in `avx2` and
//! `avx512`.

use std::ops::{Add, Div, Mul, Sub};

/// Number of lanes.
pub(super) const WIDTH: usize = 16;

/// One vector's worth of memory.
pub(super) type Chunk = [f32; WIDTH];

/// All zeros.
pub(super) const NONE: Chunk = [0.0; WIDTH];

/// Lanes of [`Lanes::joined`] that hold its first number.
pub(super) const JOINED_FIRST: usize = 10;

/// Sixteen numbers with the operations that the kernels need.
pub(super) trait Lanes:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self>
{
    /// One truth value per lane.
    type Mask: Copy;
    /// Whether a kernel may keep more than twenty values in registers, rather than six.
    const MANY_REGISTERS: bool;

    /// The same number in every lane.
    fn splat(x: f32) -> Self;
    /// Reads sixteen numbers.
    fn load(from: &Chunk) -> Self;
    /// Writes sixteen numbers.
    fn store(self, to: &mut Chunk);
    /// `first` in the first [`JOINED_FIRST`] lanes, `second` in the others.
    fn joined(first: f32, second: f32) -> Self;
    /// `first` in the first eight lanes, `second` in the others.
    fn halves(first: f32, second: f32) -> Self;
    /// `self · b + c`, rounded once where the hardware can.
    fn mul_add(self, b: Self, c: Self) -> Self;
    /// `c − self · b`, rounded once where the hardware can.
    fn neg_mul_add(self, b: Self, c: Self) -> Self;
    /// Smaller of both; `b` where either is NaN.
    fn min(self, b: Self) -> Self;
    /// Larger of both; `b` where either is NaN.
    fn max(self, b: Self) -> Self;
    /// Square root.
    fn sqrt(self) -> Self;
    /// Absolute value.
    fn abs(self) -> Self;
    /// 1/x for normal x, relative error below 3e-7.
    fn reciprocal(self) -> Self;
    /// Where `self ≥ b`; not where either is NaN.
    fn ge(self, b: Self) -> Self::Mask;
    /// Where `self > b`; not where either is NaN.
    fn gt(self, b: Self) -> Self::Mask;
    /// Where both masks are set.
    fn both(a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// The mask with lane i set where bit i is set.
    fn mask(bits: u16) -> Self::Mask;
    /// Keeps the lanes of a mask and zeroes the others.
    fn keep(self, mask: Self::Mask) -> Self;
    /// Returns `self` where the mask is set, and `b` elsewhere.
    fn or_where_not(self, mask: Self::Mask, b: Self) -> Self;
    /// A mask as bits, lane 0 lowest.
    fn bits(mask: Self::Mask) -> u32;
    /// Sum of the lanes, always in the same order.
    fn sum(self) -> f32;
    /// 2^x for −126 ≤ x ≤ 126, relative error below 4e-7; smaller x give at most 2^−126.
    fn exp2(self) -> Self;
    /// Returns ⌊log₂ x⌋ of positive normal x, and x divided by two to this power.
    fn exponent_and_mantissa(self) -> (Self, Self);
    /// Packs integers from 0 to 2¹⁵ as `first + 2¹⁶·end`.
    fn pack(first: Self, end: Self) -> [u32; WIDTH];
    /// Rounds towards zero numbers of magnitude below 2³¹.
    fn truncate(self) -> Self;
    /// Transposes sixteen vectors.
    fn transpose(rows: [Self; WIDTH]) -> [Self; WIDTH];

    /// Whether any lane of a mask is set.
    #[inline(always)]
    fn any(mask: Self::Mask) -> bool {
        Self::bits(mask) != 0
    }

    /// Sign of each lane: −1, 0 or 1; 0 for NaN.
    #[inline(always)]
    fn signum(self) -> Self {
        let (zero, one) = (Self::splat(0.0), Self::splat(1.0));
        one.keep(self.gt(zero)) - one.keep(zero.gt(self))
    }

    /// −x.
    #[inline(always)]
    fn negated(self) -> Self {
        Self::splat(0.0) - self
    }

    /// e^x for x from −87 to 87, relative error below 6e-6 there and 1e-6 near zero.
    #[inline(always)]
    fn exp(self) -> Self {
        (self * Self::splat(std::f32::consts::LOG2_E)).exp2()
    }

    /// log₂ of positive normal x, absolute error below 1e-6 for x from 1e-3 to 1e3.
    #[inline(always)]
    fn log2(self) -> Self {
        let (exponent, mantissa) = self.exponent_and_mantissa();
        let one = Self::splat(1.0);
        let high = mantissa.gt(Self::splat(std::f32::consts::SQRT_2));
        let exponent = exponent + one.keep(high);
        let mantissa = (mantissa * Self::splat(0.5)).or_where_not(high, mantissa);
        // ln m = 2 artanh s with s = (m − 1)/(m + 1), |s| < 0.172.
        let s = (mantissa - one) / (mantissa + one);
        let squared = s * s;
        let series = squared.mul_add(Self::splat(1.0 / 9.0), Self::splat(1.0 / 7.0));
        let series = series.mul_add(squared, Self::splat(1.0 / 5.0));
        let series = series.mul_add(squared, Self::splat(1.0 / 3.0));
        let series = series.mul_add(squared, one);
        (s * series).mul_add(Self::splat(2.0 * std::f32::consts::LOG2_E), exponent)
    }
}

/// Minimax polynomial of 2^f on [−½, ½], constant term first.
pub(super) const EXP2: [f32; 6] =
    [1.0, 0.693_146_94, 0.240_221_2, 5.550_713e-2, 9.675_542e-3, 1.327_647_2e-3];

/// 2^f for f in [−½, ½].
#[inline(always)]
pub(super) fn exp2_fraction<L: Lanes>(f: L) -> L {
    let p = f.mul_add(L::splat(EXP2[5]), L::splat(EXP2[4]));
    let p = p.mul_add(f, L::splat(EXP2[3]));
    let p = p.mul_add(f, L::splat(EXP2[2]));
    let p = p.mul_add(f, L::splat(EXP2[1]));
    p.mul_add(f, L::splat(EXP2[0]))
}

/// Adding and subtracting this number rounds to an integer. In between, the integer is in the low mantissa bits.
pub(super) const ROUNDING: f32 = 12_582_912.0;

/// A compiled form of the CPU kernels.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum SimdForm {
    /// The target's baseline instructions.
    #[default]
    Portable,
    /// AVX2 with FMA.
    Avx2,
    /// AVX-512 F, BW, DQ and VL.
    Avx512,
}

impl SimdForm {
    /// The forms that this CPU can run, slowest first.
    pub fn available() -> &'static [Self] {
        const ALL: [SimdForm; 3] = [SimdForm::Portable, SimdForm::Avx2, SimdForm::Avx512];
        let best = ALL.iter().filter(|form| Simd::of(**form).is_some()).count();
        &ALL[..best]
    }
}

/// Selects a compiled form of the kernels. A value other than the portable one proves that the CPU supports it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Simd {
    form: SimdForm,
}

impl Simd {
    /// A form, where this CPU can run it.
    pub(super) fn of(form: SimdForm) -> Option<Self> {
        #[cfg(target_arch = "x86_64")]
        let there = {
            use std::arch::is_x86_feature_detected as detected;
            let avx2 = detected!("avx2") && detected!("fma");
            let avx512 = detected!("avx512f") && detected!("avx512bw") && detected!("avx512dq");
            match form {
                SimdForm::Portable => true,
                SimdForm::Avx2 => avx2,
                SimdForm::Avx512 => avx2 && avx512 && detected!("avx512vl"),
            }
        };
        #[cfg(not(target_arch = "x86_64"))]
        let there = form == SimdForm::Portable;
        there.then_some(Self { form })
    }

    /// The best form that this CPU can run.
    pub(super) fn detect() -> Self {
        let best = SimdForm::available().last().copied();
        best.and_then(Self::of).unwrap_or_default()
    }

    /// The form.
    pub(super) fn form(self) -> SimdForm {
        self.form
    }
}

/// Builds an array of values by index. A macro, because a closure is compiled only for the baseline instructions: lanes
/// would pass through memory and calls.
macro_rules! array {
    (2, |$i:ident| $value:expr) => { array!(@ $i, $value, 0 1) };
    (3, |$i:ident| $value:expr) => { array!(@ $i, $value, 0 1 2) };
    (6, |$i:ident| $value:expr) => { array!(@ $i, $value, 0 1 2 3 4 5) };
    (@ $i:ident, $value:expr, $($index:literal)*) => {
        [$({
            let $i = $index;
            $value
        }),*]
    };
}
pub(super) use array;

/// Defines a function that runs a kernel, generic over [`Lanes`], in the form given by its first argument.
macro_rules! by_simd {
    ($(#[$doc:meta])* fn $name:ident = $kernel:ident($($arg:ident: $type:ty),* $(,)?) $(-> $result:ty)?) => {
        $(#[$doc])*
        pub(super) fn $name(simd: $crate::cpu::lanes::Simd, $($arg: $type),*) $(-> $result)? {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2,fma")]
                fn wide($($arg: $type),*) $(-> $result)? {
                    $kernel::<$crate::cpu::avx2::Avx2>($($arg),*)
                }
                #[target_feature(enable = "avx2,fma,avx512f,avx512bw,avx512dq,avx512vl")]
                fn widest($($arg: $type),*) $(-> $result)? {
                    $kernel::<$crate::cpu::avx512::Avx512>($($arg),*)
                }
                #[expect(unsafe_code, reason = "a `Simd` of a form exists only where the CPU was found to have it")]
                // SAFETY: as above.
                unsafe {
                    match simd.form() {
                        $crate::cpu::lanes::SimdForm::Avx512 => return widest($($arg),*),
                        $crate::cpu::lanes::SimdForm::Avx2 => return wide($($arg),*),
                        $crate::cpu::lanes::SimdForm::Portable => {}
                    }
                }
            }
            #[cfg(not(target_arch = "x86_64"))]
            let _ = simd;
            $kernel::<$crate::cpu::portable::Portable>($($arg),*)
        }
    };
}
pub(super) use by_simd;

#[cfg(test)]
mod tests {
    use super::*;

    fn stored<L: Lanes>(v: L) -> Chunk {
        let mut out = NONE;
        v.store(&mut out);
        out
    }

    fn check_functions<L: Lanes>() {
        let mut worst = [0.0f64; 5];
        let mut note = |k: usize, error: f64| worst[k] = worst[k].max(error.abs());
        for i in 0..100_000 {
            let part = f64::from(i) / 100_000.0;
            let x = (-87.0 * part) as f32;
            note(0, f64::from(stored(L::splat(x).exp())[3]) / f64::from(x).exp() - 1.0);
            let x = (-5.6 * part) as f32;
            note(1, f64::from(stored(L::splat(x).exp())[15]) / f64::from(x).exp() - 1.0);
            let x = (-126.0 + 252.0 * part) as f32;
            note(2, f64::from(stored(L::splat(x).exp2())[8]) / f64::from(x).exp2() - 1.0);
            let x = (10.0f64).powf(-3.0 + 6.0 * part) as f32;
            note(3, f64::from(stored(L::splat(x).log2())[0]) - f64::from(x).log2());
            note(4, f64::from(stored(L::splat(x).reciprocal())[9]) * f64::from(x) - 1.0);
        }
        println!(
            "exp {:.1e} {:.1e}, exp2 {:.1e}, log2 {:.1e}, reciprocal {:.1e}",
            worst[0], worst[1], worst[2], worst[3], worst[4]
        );
        // The argument reduction x·log₂e in f32 costs up to |x|·6e-8 beside the polynomial's 2e-7.
        assert!(worst[0] < 6e-6 && worst[1] < 1e-6 && worst[2] < 4e-7, "{worst:?}");
        assert!(worst[3] < 1e-6 && worst[4] < 3e-7, "{worst:?}");
        let least = stored(L::load(&[-1e4; WIDTH]).exp2());
        assert!(least.iter().all(|v| (0.0..=f32::MIN_POSITIVE).contains(v)), "{least:?}");
    }

    fn check_shuffles<L: Lanes>() {
        let mut rows = [L::splat(0.0); WIDTH];
        for (i, row) in rows.iter_mut().enumerate() {
            let values: Chunk = std::array::from_fn(|j| (20 * i + j) as f32);
            *row = L::load(&values);
            assert_eq!(row.sum(), values.iter().sum::<f32>());
        }
        for (j, column) in L::transpose(rows).into_iter().enumerate() {
            assert_eq!(stored(column), std::array::from_fn(|i| (20 * i + j) as f32));
        }
        let (nan, inf) = (f32::NAN, f32::INFINITY);
        let mut numbers = [1.0; WIDTH];
        numbers[..8].copy_from_slice(&[-2.0, 0.0, 3.0, nan, 1.0, -0.0, inf, 5.0]);
        let v = L::load(&numbers);
        let (zero, four) = (L::splat(0.0), L::splat(4.0));
        assert_eq!(L::bits(v.gt(zero)), 0xFFD4);
        assert_eq!(L::bits(L::mask(0xA5C3)), 0xA5C3);
        assert_eq!(L::bits(v.ge(zero)), 0xFFF6);
        assert_eq!(L::bits(L::both(v.ge(zero), four.gt(v))), 0xFF36);
        assert!(L::any(v.gt(four)) && !L::any(L::splat(nan).gt(v)));
        assert_eq!(stored(v.signum())[..8], [-1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 1.0]);
        assert_eq!(stored(v.keep(v.gt(four)))[..8], [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, inf, 5.0]);
        assert_eq!(stored(v.or_where_not(v.gt(four), four))[4..8], [4.0, 4.0, inf, 5.0]);
        assert_eq!(stored(v.min(four))[2..4], [3.0, 4.0]);
        assert_eq!(stored(v.max(four))[2..4], [4.0, 4.0]);
        assert_eq!(stored(v.abs())[0], 2.0);
        assert_eq!(stored(L::splat(-2.75).truncate())[11], -2.0);
        assert_eq!(L::pack(L::splat(3.0), L::splat(7.0)), [3 + (7 << 16); WIDTH]);
        let joined = stored(L::joined(1.0, 2.0));
        assert!(joined.iter().enumerate().all(|(i, v)| *v == if i < JOINED_FIRST { 1.0 } else { 2.0 }));
        let halves = stored(L::halves(1.0, 2.0));
        assert!(halves.iter().enumerate().all(|(i, v)| *v == if i < 8 { 1.0 } else { 2.0 }));
        assert_eq!(stored(four.neg_mul_add(four, L::splat(20.0)))[7], 4.0);
        assert_eq!(stored(four.mul_add(four, L::splat(20.0)))[7], 36.0);
        assert_eq!(stored(four.sqrt())[7], 2.0);
    }

    fn check<L: Lanes>() {
        check_functions::<L>();
        check_shuffles::<L>();
    }

    by_simd! { fn check_by = check() }

    #[test]
    fn functions_and_shuffles_are_right_in_every_form() {
        for form in SimdForm::available() {
            println!("{form:?}");
            check_by(Simd::of(*form).expect("it is available"));
        }
    }
}
