//! Errors.

/// What wash cannot be made of.
#[derive(Debug, thiserror::Error)]
pub enum WashError {
    /// A setting is out of range.
    #[error("{name} is {value}, but must be {must}")]
    Setting {
        /// Which.
        name: String,
        /// Its value.
        value: f64,
        /// What it must be.
        must: &'static str,
    },
    /// A part of a body is no convex solid.
    #[error("part {part} of the body is no convex solid: {why}")]
    Part {
        /// Index of the part.
        part: usize,
        /// What is wrong.
        why: String,
    },
}

impl WashError {
    /// Refuses what is not positive and finite.
    pub(crate) fn positive(name: &str, value: f64) -> Result<(), Self> {
        if value > 0.0 && value.is_finite() {
            return Ok(());
        }
        Err(Self::Setting { name: name.to_owned(), value, must: "positive" })
    }
}
