//! Range checks of settings.

use crate::InputError;
use std::fmt::Display;

/// Checks the values of one section of the settings; the error names the key, the value and the allowed range.
///
/// ```
/// use sms_core::Ranges;
/// let scan = Ranges::of("scan");
/// assert!(scan.within("current_share", 0.4, 0.0, 1.0).is_ok());
/// let error = scan.within("current_share", f64::NAN, 0.0, 1.0).unwrap_err();
/// assert_eq!(error.key(), Some("scan.current_share"));
/// ```
#[derive(Debug, Clone, Copy)]
pub struct Ranges<'a> {
    section: &'a str,
}

impl<'a> Ranges<'a> {
    /// Creates the checks of a section.
    pub fn of(section: &'a str) -> Self {
        Self { section }
    }

    /// Checks that `value` is from `low` to `high`, both included; NaN is not.
    ///
    /// # Errors
    /// [`InputError`] naming the key, the value and the range.
    pub fn within<T>(&self, key: &str, value: T, low: f64, high: f64) -> Result<(), InputError>
    where
        T: Into<f64> + Display + Copy,
    {
        if (low..=high).contains(&value.into()) {
            return Ok(());
        }
        Err(self.fault(key, value, low, high))
    }

    /// As [`Self::within`], for counts and sizes.
    ///
    /// # Errors
    /// [`InputError`] naming the key, the value and the range.
    pub fn count(&self, key: &str, value: usize, low: usize, high: usize) -> Result<(), InputError> {
        if (low..=high).contains(&value) { Ok(()) } else { Err(self.fault(key, value, low, high)) }
    }

    /// Checks that `low` is not above `high`: two related keys of the section.
    ///
    /// # Errors
    /// [`InputError`] naming both keys and values.
    pub fn ordered(&self, low: (&str, f64), high: (&str, f64)) -> Result<(), InputError> {
        if low.1 <= high.1 {
            return Ok(());
        }
        let section = self.section;
        Err(InputError::new(
            format!("`{section}.{}` is {}, above `{section}.{}`, which is {}", low.0, low.1, high.0, high.1),
            format!("[{section}]"),
            "swap the two values, or change one",
        )
        .at_key(format!("{section}.{}", low.0)))
    }

    fn fault(&self, key: &str, value: impl Display, low: impl Display, high: impl Display) -> InputError {
        let section = self.section;
        InputError::new(
            format!("`{section}.{key}` is {value}, and must be from {low} to {high}"),
            format!("[{section}]"),
            format!("give `{key}` a value from {low} to {high}"),
        )
        .at_key(format!("{section}.{key}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_ends_are_allowed_and_nothing_beyond() {
        let r = Ranges::of("s");
        for good in [0.5f32, 1.0, 2.0] {
            assert!(r.within("k", good, 0.5, 2.0).is_ok());
        }
        for bad in [f32::NAN, f32::INFINITY, -0.0, 0.4999, 2.0001] {
            assert!(r.within("k", bad, 0.5, 2.0).is_err(), "{bad}");
        }
        assert_eq!(r.within("a.b", 0.1f32, 0.5, 2.0).unwrap_err().key(), Some("s.a.b"));
        assert_eq!(r.count("n", 0, 1, 3).unwrap_err().key(), Some("s.n"));
        assert!(r.count("n", 0, 1, 3).is_err() && r.count("n", 3, 1, 3).is_ok());
        assert_eq!(r.ordered(("min", 3.0), ("max", 2.0)).unwrap_err().key(), Some("s.min"));
        assert!(r.ordered(("min", 2.0), ("max", 2.0)).is_ok());
    }
}
