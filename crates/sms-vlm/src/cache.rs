//! Cache of replies on disk, by question.

use serde::{Deserialize, Serialize};
use sms_core::{CoreError, Hash, Hasher, Warnings, atomic};
use std::path::{Path, PathBuf};

/// Version of the format; a new number invalidates old replies.
const VERSION: u32 = 1;

/// The last reply to one question.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct CachedReply {
    version: u32,
    pub model: String,
    /// Name of the object, for readers of the folder.
    pub object: String,
    /// The raw reply.
    pub reply: String,
    pub prompt_tokens: u64,
    pub completion_tokens: u64,
    /// Hash of all fields above: damaged or edited files are not used.
    check: Hash,
}

impl CachedReply {
    pub(crate) fn new(model: &str, object: &str, reply: &str, tokens: (u64, u64)) -> Self {
        let mut entry = Self {
            version: VERSION,
            model: model.to_owned(),
            object: object.to_owned(),
            reply: reply.to_owned(),
            prompt_tokens: tokens.0,
            completion_tokens: tokens.1,
            check: Hash(String::new()),
        };
        entry.check = entry.hash();
        entry
    }

    fn hash(&self) -> Hash {
        let mut h = Hasher::new();
        h.text(&self.model).text(&self.object).text(&self.reply);
        h.text(&format!("{} {} {}", self.version, self.prompt_tokens, self.completion_tokens));
        h.finish()
    }
}

/// A folder of replies.
#[derive(Debug, Clone)]
pub struct Cache {
    dir: PathBuf,
}

impl Cache {
    /// A cache in this folder, which is created with the first reply.
    pub fn new(dir: &Path) -> Self {
        Self { dir: dir.to_owned() }
    }

    /// Returns the key of a question: a hash of image, prompt and model.
    pub(crate) fn key(image: &[u8], prompt: &str, model: &str) -> Hash {
        Hasher::new().text("vlm 1").bytes(image).text(prompt).text(model).finish()
    }

    fn path(&self, key: &Hash) -> PathBuf {
        self.dir.join(format!("{}.json", key.0))
    }

    /// Returns the stored reply if it exists and is intact. Damage causes a warning.
    pub(crate) fn get(&self, key: &Hash, object: &str, warnings: &Warnings) -> Option<CachedReply> {
        let path = self.path(key);
        if !path.exists() {
            return None;
        }
        let entry = atomic::read_json::<CachedReply>(&path)
            .ok()
            .filter(|e| e.version == VERSION && e.check == e.hash());
        if entry.is_none() {
            warnings.add(
                "vlm",
                "vlm_cache_damaged",
                format!("the stored reply about {object} is damaged and is not used ({})", path.display()),
                "the model is asked again if requests are allowed; delete the file to silence this warning",
            );
        }
        entry
    }

    /// Stores a reply.
    ///
    /// # Errors
    /// [`CoreError::Write`].
    pub(crate) fn put(&self, key: &Hash, entry: &CachedReply) -> Result<(), CoreError> {
        atomic::write_json(&self.path(key), entry)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn replies_are_kept_and_damage_is_found() {
        let dir = tempfile::tempdir().unwrap();
        let cache = Cache::new(&dir.path().join("vlm"));
        let key = Cache::key(b"image", "prompt", "model");
        let warnings = Warnings::new();
        assert_eq!(cache.get(&key, "mug", &warnings), None);
        let entry = CachedReply::new("model", "mug", "{\"a\": 1}", (7, 9));
        cache.put(&key, &entry).unwrap();
        assert_eq!(cache.get(&key, "mug", &warnings), Some(entry));
        assert!(warnings.snapshot().is_empty());
        let path = cache.path(&key);
        let whole = std::fs::read_to_string(&path).unwrap();
        for damaged in [whole[..whole.len() / 2].to_owned(), whole.replace("1}", "2}"), String::new()] {
            std::fs::write(&path, damaged).unwrap();
            assert_eq!(cache.get(&key, "mug", &warnings), None);
        }
        assert_eq!((warnings.snapshot().len(), warnings.snapshot()[0].count), (1, 3));
    }

    #[test]
    fn the_key_is_of_image_prompt_and_model() {
        let key = Cache::key(b"image", "prompt", "model");
        assert_eq!(key, Cache::key(b"image", "prompt", "model"));
        assert_ne!(key, Cache::key(b"imagE", "prompt", "model"));
        assert_ne!(key, Cache::key(b"image", "prompT", "model"));
        assert_ne!(key, Cache::key(b"image", "prompt", "modeL"));
        assert_ne!(key, Cache::key(b"imagep", "rompt", "model"));
    }
}
