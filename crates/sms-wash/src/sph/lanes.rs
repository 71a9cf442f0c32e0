//! Eight `f32` at a time, as plain arrays that the compiler makes registers of: the same source serves every width of vectors.

use std::ops::{Add, AddAssign, Mul, Sub};

/// Number of lanes.
pub(super) const WIDTH: usize = 8;

/// Eight numbers.
#[derive(Clone, Copy)]
#[repr(align(32))]
pub(super) struct Lanes(pub(super) [f32; WIDTH]);

/// One expression per lane, written out: iterators over arrays keep checks that stand in the way of vectors.
macro_rules! lanes {
    ($i:ident => $e:expr) => {
        Lanes([
            { const $i: usize = 0; $e },
            { const $i: usize = 1; $e },
            { const $i: usize = 2; $e },
            { const $i: usize = 3; $e },
            { const $i: usize = 4; $e },
            { const $i: usize = 5; $e },
            { const $i: usize = 6; $e },
            { const $i: usize = 7; $e },
        ])
    };
}

macro_rules! lanewise {
    ($trait:ident, $method:ident, $op:tt) => {
        impl $trait for Lanes {
            type Output = Self;
            #[inline(always)]
            fn $method(self, b: Self) -> Self {
                lanes!(I => self.0[I] $op b.0[I])
            }
        }
    };
}
lanewise!(Add, add, +);
lanewise!(Sub, sub, -);
lanewise!(Mul, mul, *);

impl AddAssign for Lanes {
    #[inline(always)]
    fn add_assign(&mut self, b: Self) {
        *self = *self + b;
    }
}

impl Lanes {
    /// The same number in every lane.
    #[inline(always)]
    pub(super) fn splat(x: f32) -> Self {
        Self([x; WIDTH])
    }

    /// Eight numbers of a slice from `start` on.
    #[inline(always)]
    pub(super) fn load(from: &[f32], start: usize) -> Self {
        Self(*from[start..].first_chunk().expect("arrays are padded"))
    }

    #[inline(always)]
    pub(super) fn max(self, b: Self) -> Self {
        lanes!(I => if self.0[I] > b.0[I] { self.0[I] } else { b.0[I] })
    }

    #[inline(always)]
    pub(super) fn min(self, b: Self) -> Self {
        lanes!(I => if self.0[I] < b.0[I] { self.0[I] } else { b.0[I] })
    }

    #[inline(always)]
    pub(super) fn sqrt(self) -> Self {
        lanes!(I => self.0[I].sqrt())
    }

    #[inline(always)]
    pub(super) fn reciprocal(self) -> Self {
        lanes!(I => 1.0 / self.0[I])
    }

    /// The first `count` lanes; `other` in the rest.
    #[inline(always)]
    pub(super) fn first(self, count: u32, other: Self) -> Self {
        lanes!(I => if (I as u32) < count { self.0[I] } else { other.0[I] })
    }

    /// Sum of the lanes, always in the same order.
    #[inline(always)]
    pub(super) fn sum(self) -> f32 {
        let [a, b, c, d, e, f, g, h] = self.0;
        ((a + e) + (c + g)) + ((b + f) + (d + h))
    }
}
