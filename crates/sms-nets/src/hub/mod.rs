//! Weights from the Hugging Face hub, in its standard cache.
//!
//! The cache is shared with every other program that uses the hub: `models--ORG--NAME/snapshots/COMMIT/FILE` are
//! links to `blobs/CHECKSUM`, and `refs/REVISION` contains the commit of a branch at its last download. Cached
//! files are used without network access. Every model is pinned to a commit.

mod cache;
mod download;

pub use cache::{CachedModel, HubConfig};

use crate::{ModelFolders, NetsError};
use sms_core::{Cancel, InputError, Progress};
use std::path::{Path, PathBuf};

/// A downloadable model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct HubModel {
    /// Name on the command line.
    pub name: &'static str,
    /// Repository on the hub.
    pub repository: &'static str,
    /// Pinned commit.
    pub revision: &'static str,
    /// Its purpose.
    pub about: &'static str,
    /// Required files.
    pub files: &'static [&'static str],
}

const DETECTOR_FILES: &[&str] = &["config.json", "vocab.json", "merges.txt", "model.safetensors"];
const TRACKER_FILES: &[&str] = &["config.json", "model.safetensors"];

/// The known models, the default detector and the default tracker first.
pub const MODELS: [HubModel; 5] = [
    HubModel {
        name: "owlv2",
        repository: "google/owlv2-base-patch16-ensemble",
        revision: "cfd3195ba4ea9592eec887ded089f4c08eff231d",
        about: "detection of objects named by text (620 MB)",
        files: DETECTOR_FILES,
    },
    HubModel {
        name: "sam2-tiny",
        repository: "facebook/sam2.1-hiera-tiny",
        revision: "de431c4043854a71d8101e17995dfe596bf101a5",
        about: "masks and tracking, the fastest (156 MB)",
        files: TRACKER_FILES,
    },
    HubModel {
        name: "sam2-small",
        repository: "facebook/sam2.1-hiera-small",
        revision: "ee5bba1d82bb8749febdf90f45e84b687142ba03",
        about: "masks and tracking (184 MB)",
        files: TRACKER_FILES,
    },
    HubModel {
        name: "sam2-base-plus",
        repository: "facebook/sam2.1-hiera-base-plus",
        revision: "b7320756a13354e7530a63935656d35b2f91a290",
        about: "masks and tracking (323 MB)",
        files: TRACKER_FILES,
    },
    HubModel {
        name: "sam2-large",
        repository: "facebook/sam2.1-hiera-large",
        revision: "665f8e2ad61cf5f53d65644ff27c8ee525124610",
        about: "masks and tracking, the most accurate (898 MB)",
        files: TRACKER_FILES,
    },
];

/// Returns the model of that name or repository.
///
/// # Errors
/// [`NetsError::Input`] with the list of known names.
pub fn model(name: &str) -> Result<HubModel, NetsError> {
    let found = MODELS.iter().find(|m| m.name == name || m.repository == name);
    let names: Vec<&str> = MODELS.iter().map(|m| m.name).collect();
    found.copied().ok_or_else(|| {
        let cure = format!("choose one of {}", names.join(", "));
        InputError::new(format!("there is no model `{name}`"), "model", cure).into()
    })
}

impl HubModel {
    /// Returns the folder with the model's files: in `weights`, if given (itself, or its subfolder with the model's
    /// or the repository's name), else in the cache, downloaded if missing.
    ///
    /// # Errors
    /// [`NetsError::Input`] with the missing files and their place; [`NetsError::Core`] for files and interruption.
    pub fn folder(
        &self,
        weights: Option<&Path>,
        hub: &HubConfig,
        progress: &dyn Progress,
        cancel: &Cancel,
    ) -> Result<PathBuf, NetsError> {
        match weights {
            Some(weights) => self.local(weights),
            None => hub.fetch(self, progress, cancel),
        }
    }

    /// Returns the model's folder in a local copy.
    fn local(&self, weights: &Path) -> Result<PathBuf, NetsError> {
        let last = self.repository.rsplit('/').next().unwrap_or(self.name);
        let candidates =
            [weights.join(self.name), weights.join(last), weights.join(self.repository), weights.to_owned()];
        let is_whole = |folder: &&PathBuf| self.files.iter().all(|f| folder.join(f).is_file());
        candidates.iter().find(is_whole).cloned().ok_or_else(|| {
            let cure = format!(
                "put {} of https://huggingface.co/{} into {}",
                self.files.join(", "),
                self.repository,
                weights.join(last).display()
            );
            InputError::new(format!("the model {} is not in this folder", self.repository), weights, cure)
                .into()
        })
    }
}

/// Returns the folders of a tracker and, if needed, a detector.
///
/// # Errors
/// As [`HubModel::folder`].
pub fn model_folders(
    detector: Option<HubModel>,
    tracker: HubModel,
    weights: Option<&Path>,
    hub: &HubConfig,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<ModelFolders, NetsError> {
    let owlv2 = detector.map(|m| m.folder(weights, hub, progress, cancel)).transpose()?;
    Ok(ModelFolders { owlv2, sam2: tracker.folder(weights, hub, progress, cancel)? })
}
