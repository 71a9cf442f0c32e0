//! Errors.

/// Error in the input of a wash model.
#[derive(Debug, thiserror::Error)]
pub enum WashError {
    /// A setting is out of range.
    #[error("{name} is {value}, but must be {must}")]
    Setting {
        /// Name of the setting.
        name: String,
        /// Its value.
        value: f64,
        /// The allowed range.
        must: &'static str,
    },
    /// A part of a body is not a convex solid.
    #[error("part {part} of the body is not a convex solid: {why}")]
    Part {
        /// Index of the part.
        part: usize,
        /// The fault.
        why: String,
    },
}

impl WashError {
    /// Refuses values that are not positive and finite.
    pub(crate) fn positive(name: &str, value: f64) -> Result<(), Self> {
        if value > 0.0 && value.is_finite() {
            return Ok(());
        }
        Err(Self::Setting { name: name.to_owned(), value, must: "positive" })
    }
}
