//! Content hashes of settings and inputs.

use crate::CoreError;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// A content hash, written as hexadecimal.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Hash(pub String);

/// Builds a [`struct@Hash`] from parts; each part is framed by its length so that parts cannot run into each other.
#[derive(Debug, Default)]
pub struct Hasher(blake3::Hasher);

impl Hasher {
    /// Creates an empty hasher.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds bytes.
    pub fn bytes(&mut self, bytes: &[u8]) -> &mut Self {
        self.0.update(&(bytes.len() as u64).to_le_bytes());
        self.0.update(bytes);
        self
    }

    /// Adds text.
    pub fn text(&mut self, text: &str) -> &mut Self {
        self.bytes(text.as_bytes())
    }

    /// Adds a file's content.
    pub fn file(&mut self, path: &Path) -> Result<&mut Self, CoreError> {
        let bytes = std::fs::read(path).map_err(CoreError::read(path))?;
        Ok(self.bytes(&bytes))
    }

    /// Returns the hash of everything added.
    pub fn finish(&self) -> Hash {
        Hash(self.0.finalize().to_hex().as_str()[..32].to_owned())
    }
}

/// Hashes a value through its JSON text.
pub fn hash_serializable<T: Serialize>(value: &T) -> Hash {
    let mut hasher = Hasher::new();
    // Serialising plain settings to memory cannot fail; an empty text would only cause a re-run.
    hasher.text(&serde_json::to_string(value).unwrap_or_default());
    hasher.finish()
}
