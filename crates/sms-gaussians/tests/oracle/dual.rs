//! Forward-mode derivatives: a number with its derivatives with respect to ten inputs.

use std::ops::{Add, Div, Mul, Neg, Sub};

/// Inputs: position 3, rotation 4, logarithm of scale 3, in the order of a parameter row.
pub(super) const INPUTS: usize = 10;

/// A value and its derivatives.
#[derive(Debug, Clone, Copy)]
pub(super) struct Dual {
    pub(super) value: f64,
    pub(super) derivative: [f64; INPUTS],
}

impl Dual {
    pub(super) fn constant(value: f64) -> Self {
        Self { value, derivative: [0.0; INPUTS] }
    }

    pub(super) fn input(value: f64, index: usize) -> Self {
        let mut dual = Self::constant(value);
        dual.derivative[index] = 1.0;
        dual
    }

    /// Returns `f(self)`, given the value and the slope of `f` at `self`.
    fn through(self, value: f64, slope: f64) -> Self {
        Self { value, derivative: self.derivative.map(|d| d * slope) }
    }

    pub(super) fn exp(self) -> Self {
        self.through(self.value.exp(), self.value.exp())
    }

    pub(super) fn sqrt(self) -> Self {
        self.through(self.value.sqrt(), 0.5 / self.value.sqrt())
    }

    /// Clamps the value; the derivative is zero beyond the limits.
    pub(super) fn clamp(self, low: f64, high: f64) -> Self {
        if self.value < low || self.value > high { Self::constant(self.value.clamp(low, high)) } else { self }
    }
}

impl Add for Dual {
    type Output = Self;
    fn add(self, b: Self) -> Self {
        let derivative = std::array::from_fn(|i| self.derivative[i] + b.derivative[i]);
        Self { value: self.value + b.value, derivative }
    }
}

impl Mul for Dual {
    type Output = Self;
    fn mul(self, b: Self) -> Self {
        let by_parts = self.through(self.value * b.value, b.value) + b.through(0.0, self.value);
        Self { value: self.value * b.value, ..by_parts }
    }
}

impl Neg for Dual {
    type Output = Self;
    fn neg(self) -> Self {
        self.through(-self.value, -1.0)
    }
}

impl Sub for Dual {
    type Output = Self;
    fn sub(self, b: Self) -> Self {
        self + -b
    }
}

impl Div for Dual {
    type Output = Self;
    fn div(self, b: Self) -> Self {
        self * b.through(1.0 / b.value, -1.0 / (b.value * b.value))
    }
}
