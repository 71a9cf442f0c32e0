//! Recordings of the scenes, rendered when they are first needed.

use crate::error::BenchError;
use crate::models::orbit_poses;
use crate::options::BenchOptions;
use crate::scenes::{BenchScene, generated, real_data_dir};
use sms_core::{Cancel, CoreError, Progress, Seed, hash_serializable};
use sms_synth::{
    HelicalPath, ModelScene, RecordingSettings, SceneViews, Skin, bounds_w, record_views, write_recording,
};
use std::path::PathBuf;

/// Records a generated scene as `sms demo` does (the sensor and the camera path of `options`; models from an orbit
/// scaled to their size) into the cache, or finds the recording that is there. Folders are named by a hash of their inputs,
/// from, so that a changed renderer version or setting is another recording; several processes may ask for the same one.
///
/// # Errors
/// [`CoreError::Write`], [`CoreError::Interrupted`].
pub fn recording(
    scene: &BenchScene,
    made: &ModelScene,
    options: &BenchOptions,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<PathBuf, CoreError> {
    let (truth, frames) = (&made.scene, options.frames);
    let settings = options.recording();
    let noise = match scene {
        BenchScene::Billiards(seed) | BenchScene::Ten(seed) => Seed(*seed),
        _ => truth.seed,
    };
    let settings = RecordingSettings { seed: noise, ..settings };
    let near_m = settings.sensor.depth.range_m[0];
    let orbit = match (scene, truth.objects.first()) {
        (BenchScene::Model(_), Some(object)) => Some(orbit_poses(&object.aabb_w(), frames, near_m)),
        (BenchScene::Stacked(_) | BenchScene::DrawnStacked(..), _) => {
            Some(orbit_poses(&bounds_w(truth), frames, near_m))
        }
        (BenchScene::Landing(_) | BenchScene::ScannedLanding(_), _) => {
            Some(HelicalPath::default().poses(truth, frames))
        }
        _ => None,
    };
    let (hash, version) = (hash_serializable(truth).0, env!("CARGO_PKG_VERSION"));
    let pictures = skins_hash(&made.skins);
    let key = match &orbit {
        None => hash_serializable(&(hash, &settings, version)).0,
        Some(poses) => hash_serializable(&(hash, &settings, version, poses, &pictures)).0,
    };
    let dir = options.cache.join(format!("{scene}-{frames}-{}", &key[..12]));
    if dir.join("transforms.json").is_file() {
        return Ok(dir);
    }
    // Rendered aside and renamed: whoever looks finds a whole recording or none.
    let aside = dir.with_extension(format!("partial-{}", std::process::id()));
    match &orbit {
        None => write_recording(truth, &settings, &aside, progress, cancel)?,
        Some(poses) => {
            let views = SceneViews { scene: truth, skins: &made.skins, poses, source: &pictures };
            record_views(&views, &settings, &aside, progress, cancel)?
        }
    };
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

/// Names the pictures of a scene.
fn skins_hash(skins: &[Option<Skin>]) -> String {
    let mut hasher = sms_core::Hasher::new();
    for image in skins.iter().flatten().map(Skin::image) {
        hasher.bytes(image.data.as_flattened());
    }
    hasher.finish().0
}

/// Returns the folder of a scene's recording, rendering it first if necessary; `None` for a real recording
/// or a model that is not there.
///
/// # Errors
/// As [`generated`] and [`recording`].
pub fn locate(
    scene: &BenchScene,
    options: &BenchOptions,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<Option<PathBuf>, BenchError> {
    Ok(match scene {
        BenchScene::Real(name) => {
            Some(real_data_dir().join(name)).filter(|d| d.join("transforms.json").is_file())
        }
        _ => match generated(scene)? {
            Some(made) => Some(recording(scene, &made, options, progress, cancel)?),
            None => None,
        },
    })
}
