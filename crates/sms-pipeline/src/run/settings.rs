//! Settings of a scan that later commands of the same run need.

use crate::Error;
use serde::{Deserialize, Serialize};
use sms_core::{Hash, Hasher, InputError, Labels, RunFolder, atomic};
use std::path::Path;

/// File of the settings that the Gaussians were made with, in their folder: `run.toml` may already hold those of a
/// scan that was begun later and not finished.
pub(crate) const SETTINGS: &str = "settings.json";

/// The choices of a scan, kept in `run.toml` and beside the Gaussians.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct RunSettings {
    /// Folder of the recording.
    pub recording: String,
    /// Seed of everything random.
    pub seed: u64,
    /// Preset of the scan.
    pub preset: String,
    /// Source of the masks.
    pub masks: String,
    /// Every how many frames one was held out of training (0: none).
    #[serde(default)]
    pub holdout: usize,
    /// Hash of the label maps that the Gaussians were trained with.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub regions: Option<String>,
}

impl RunSettings {
    /// Reads the settings that the run's Gaussians were made with.
    ///
    /// # Errors
    /// [`Error::Core`] when there are no Gaussians, [`Error::Input`] when they lack their settings.
    pub(crate) fn of(run: &RunFolder) -> Result<Self, Error> {
        let path = run.stage_dir("gaussians", "scan DIR --out")?.join(SETTINGS);
        if !path.exists() {
            let cure = "scan the recording again into this run";
            return Err(InputError::new("this run does not say how it was scanned", &path, cure).into());
        }
        Ok(atomic::read_json(&path)?)
    }

    /// Returns the name of the recording's folder.
    pub fn recording_name(&self) -> String {
        let path = Path::new(&self.recording);
        path.file_name().map_or_else(|| "scene".into(), |n| n.to_string_lossy().into_owned())
    }
}

/// Returns the content hash of the label maps: which pixel belongs to which object, whatever the objects are called.
pub(crate) fn regions_hash(labels: &Labels) -> Result<Hash, Error> {
    let mut hasher = Hasher::new();
    let ids: Vec<u16> = labels.objects.iter().map(|o| o.id).collect();
    hasher.text(&serde_json::to_string(&(labels.source, ids))?);
    for map in &labels.maps {
        hasher.text(&serde_json::to_string(&map.size())?);
        let bytes: Vec<u8> = map.data.iter().flat_map(|label| label.to_le_bytes()).collect();
        hasher.bytes(&bytes);
    }
    Ok(hasher.finish())
}
