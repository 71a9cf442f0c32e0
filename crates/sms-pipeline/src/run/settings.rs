//! Settings of a scan for later commands of the same run.

use crate::Error;
use serde::{Deserialize, Serialize};
use sms_core::{Hash, Hasher, InputError, Labels, RunFolder, atomic};
use std::path::Path;

/// File of the settings of the Gaussians, in their folder: `run.toml` may already contain the settings of a later,
/// unfinished scan.
pub(crate) const SETTINGS: &str = "settings.json";

/// The options of a scan, stored in `run.toml` and beside the Gaussians.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct RunSettings {
    /// Folder of the recording.
    pub recording: String,
    /// Random seed.
    pub seed: u64,
    /// Preset of the scan.
    pub preset: String,
    /// Source of the masks.
    pub masks: String,
    /// Interval of the held-out frames (0: none).
    #[serde(default)]
    pub holdout: usize,
    /// Hash of the label maps of the training.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub regions: Option<String>,
}

impl RunSettings {
    /// Reads the settings of the run's Gaussians.
    ///
    /// # Errors
    /// [`Error::Core`] if there are no Gaussians, [`Error::Input`] if their settings are missing.
    pub(crate) fn of(run: &RunFolder) -> Result<Self, Error> {
        let path = run.stage_dir("gaussians", "scan DIR --out")?.join(SETTINGS);
        if !path.exists() {
            let cure = "scan the recording again into this run";
            return Err(InputError::new("the settings of this scan are missing", &path, cure).into());
        }
        Ok(atomic::read_json(&path)?)
    }

    /// Returns the name of the recording's folder.
    pub fn recording_name(&self) -> String {
        let path = Path::new(&self.recording);
        path.file_name().map_or_else(|| "scene".into(), |n| n.to_string_lossy().into_owned())
    }
}

/// Returns the content hash of the label maps, independent of the object names.
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
