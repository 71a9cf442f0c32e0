//! Prefetching. The kernels read splats, gradients and images in an order that the hardware does not predict.

/// Bytes of a cache line.
const LINE: usize = 64;

/// Prefetches all of `value`.
#[inline(always)]
#[cfg(target_arch = "x86_64")]
pub(super) fn prefetch<T>(value: &T) {
    use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
    let first = std::ptr::from_ref(value).cast::<i8>();
    for line in 0..size_of::<T>().div_ceil(LINE) {
        #[expect(unsafe_code, reason = "an intrinsic that takes a pointer; it reads nothing")]
        // SAFETY: a hint has no effect on memory and never faults; the address is within the value.
        unsafe {
            _mm_prefetch::<_MM_HINT_T0>(first.wrapping_add(line * LINE));
        }
    }
}

/// Does nothing: this target has no stable hint.
#[inline(always)]
#[cfg(not(target_arch = "x86_64"))]
pub(super) fn prefetch<T>(_value: &T) {}
