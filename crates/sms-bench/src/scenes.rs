//! The scenes that are measured, and the recordings made of them.

use serde::{Deserialize, Serialize};
use sms_core::{Cancel, CoreError, InputError, Progress, Seed, hash_serializable};
use sms_synth::{BilliardsSettings, RecordingSettings, TruthScene, generate_billiards, write_recording};
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// The ten fixed seeds of the billiards family. The demo's are 1 to 5. The scan was tuned on 1001, 1003 and
/// 1005, and 1002, 1009 and 1010 were looked at; 1004, 1006, 1007 and 1008 were only measured.
pub const SEEDS: [u64; 10] = [1001, 1002, 1003, 1004, 1005, 1006, 1007, 1008, 1009, 1010];

/// Frames of a recording (paper: 60).
pub const FRAMES: usize = 60;

/// Every so many frames one is held out.
pub const HOLDOUT: usize = 8;

/// The real recordings, by folder name.
pub const REAL: [&str; 2] = ["seq_tabletop_bin", "seq_shelf_tissue"];

/// One scene of the benchmark; its text is the `{scene}` of the metrics' keys.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum BenchScene {
    /// A generated billiards scene of this seed (`billiards_1001`).
    Billiards(u64),
    /// A real recording's folder name (`seq_tabletop_bin`).
    Real(String),
}

impl fmt::Display for BenchScene {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Billiards(seed) => write!(f, "billiards_{seed}"),
            Self::Real(name) => f.write_str(name),
        }
    }
}

impl FromStr for BenchScene {
    type Err = InputError;

    fn from_str(text: &str) -> Result<Self, InputError> {
        if let Some(real) = REAL.iter().find(|r| **r == text) {
            return Ok(Self::Real((*real).to_owned()));
        }
        text.strip_prefix("billiards_").unwrap_or(text).parse().map(Self::Billiards).map_err(|_| {
            InputError::new(
                format!("no scene is called `{text}`"),
                "--scenes",
                format!("give a number of scenes, seeds such as 1001, or {}", REAL.join(", ")),
            )
        })
    }
}

/// The scenes that a list names: `all` (the ten seeds and the real recordings), `real`, a number up to ten (the first
/// so many seeds), or ids separated by commas.
///
/// # Errors
/// [`InputError`] naming the part that is no scene.
pub fn select_scenes(list: &str) -> Result<Vec<BenchScene>, InputError> {
    let real = || REAL.iter().map(|r| BenchScene::Real((*r).to_owned()));
    let seeds = || SEEDS.into_iter().map(BenchScene::Billiards);
    match list {
        "all" => return Ok(seeds().chain(real()).collect()),
        "real" => return Ok(real().collect()),
        _ => {}
    }
    if let Ok(count @ 1..=10) = list.parse::<usize>() {
        return Ok(seeds().take(count).collect());
    }
    list.split(',').map(|id| id.trim().parse()).collect()
}

/// The true scene of a seed.
pub fn truth_scene(seed: u64) -> TruthScene {
    generate_billiards(Seed(seed), &BilliardsSettings::default())
}

/// Records a scene as `sms demo` does (1280×800, depth noise, the default camera path) into `cache`, or finds the
/// recording that is there. Folders are named by what they were made from, so that a changed renderer version or
/// setting is another recording; several processes may ask for the same one.
///
/// # Errors
/// [`CoreError::Write`], [`CoreError::Interrupted`].
pub fn recording(
    seed: u64,
    frames: usize,
    cache: &Path,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<PathBuf, CoreError> {
    let scene = truth_scene(seed);
    let settings = RecordingSettings { frames, seed: Seed(seed), ..RecordingSettings::default() };
    let key = hash_serializable(&(hash_serializable(&scene).0, &settings, env!("CARGO_PKG_VERSION"))).0;
    let dir = cache.join(format!("billiards_{seed}-{frames}-{}", &key[..12]));
    if dir.join("transforms.json").is_file() {
        return Ok(dir);
    }
    // Rendered aside and renamed: whoever looks finds a whole recording or none.
    let aside = dir.with_extension(format!("partial-{}", std::process::id()));
    write_recording(&scene, &settings, &aside, progress, cancel)?;
    match std::fs::rename(&aside, &dir) {
        Ok(()) => Ok(dir),
        Err(_) if dir.join("transforms.json").is_file() => {
            // Another process was faster; its recording has the same bytes.
            let _ = std::fs::remove_dir_all(&aside);
            Ok(dir)
        }
        Err(error) => Err(CoreError::write(&dir)(error)),
    }
}

/// The folder of the real recordings: `SMS_TEST_DATA`, else `../shared/data`.
pub fn real_data_dir() -> PathBuf {
    std::env::var_os("SMS_TEST_DATA").map_or_else(|| PathBuf::from("../shared/data"), PathBuf::from)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_name_scenes() {
        assert_eq!(select_scenes("2").unwrap(), [BenchScene::Billiards(1001), BenchScene::Billiards(1002)]);
        assert_eq!(select_scenes("all").unwrap().len(), 12);
        let mixed = select_scenes("1003, billiards_7,seq_shelf_tissue").unwrap();
        let text: Vec<String> = mixed.iter().map(ToString::to_string).collect();
        assert_eq!(text, ["billiards_1003", "billiards_7", "seq_shelf_tissue"]);
        assert!(select_scenes("snooker").unwrap_err().to_string().contains("snooker"));
    }
}
