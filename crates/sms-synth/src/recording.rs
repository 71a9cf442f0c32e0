//! Recordings of generated scenes in nerfstudio's layout.

use crate::path::CameraPath;
use crate::render::{CameraModel, Renderer};
use crate::scene::TruthScene;
use crate::sensor::{FrameState, SensorModel};
use crate::skin::Skin;
use glamx::{DMat4, DPose3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use sms_core::{
    Camera, Cancel, CoreError, DepthImage, Image, InputError, Intrinsics, Progress, Ranges, Seed, atomic,
    hash_serializable, write_png_color, write_png_gray16,
};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// Settings of a recording.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecordingSettings {
    /// Number of frames (paper: 60).
    pub frames: usize,
    /// Image width in pixels (paper: 1280).
    pub width: usize,
    /// Image height in pixels (paper: 800).
    pub height: usize,
    /// Horizontal field of view in radians. The paper's camera (Orbbec Gemini 2) has 91°. The default of 72° covers the
    /// workspace, and a ball at 1 m is 12 instead of 9 pixels wide at the CPU's scan resolution of 320 × 200.
    pub fov_x: f64,
    /// Path of the camera.
    pub path: CameraPath,
    /// Frames that are recorded in a second: with the path it decides how fast the camera moves, and by that how much its colour is
    /// blurred. By default, the frames that a slow hand leaves: 0.25 m/s on the paper's path of 15 m with 60 frames.
    pub frame_rate_hz: f64,
    /// Errors of the sensor and of the recorded poses (paper: exact poses). `--sensor` chooses among presets.
    pub sensor: SensorModel,
    /// Metres per unit of the 16-bit depth images.
    pub depth_unit_m: f64,
    /// Whether label images of the truth are part of the recording: referenced by `transforms.json` and listed in
    /// `objects.json`.
    pub expose_masks: bool,
    /// Seed of all noise. Commands take it from `--seed`.
    pub seed: Seed,
}

impl Default for RecordingSettings {
    fn default() -> Self {
        Self {
            frames: 60,
            width: 1280,
            height: 800,
            fov_x: 72f64.to_radians(),
            path: CameraPath::default(),
            frame_rate_hz: 1.0,
            sensor: SensorModel::default(),
            depth_unit_m: 0.0001,
            expose_masks: false,
            seed: Seed(0),
        }
    }
}

impl RecordingSettings {
    /// Settings of a small recording for `sms sample` and tests: 20 frames of 320 × 200.
    pub fn small() -> Self {
        Self { frames: 20, width: 320, height: 200, ..Self::default() }
    }

    /// Settings of `sms demo --quick`: 24 frames of 640 × 400.
    pub fn quick() -> Self {
        Self { frames: 24, width: 640, height: 400, ..Self::default() }
    }

    /// Returns the camera's intrinsics.
    pub fn intrinsics(&self) -> Intrinsics {
        Intrinsics::from_fov(self.width, self.height, self.fov_x)
    }

    /// Checks that all values are in range.
    ///
    /// # Errors
    /// [`InputError`] that names the first key out of range and the allowed range.
    pub fn validate(&self) -> Result<(), InputError> {
        let r = Ranges::of("recording");
        r.count("frames", self.frames, 1, 100_000)?;
        r.count("width", self.width, 8, 8192)?;
        r.count("height", self.height, 8, 8192)?;
        r.within("fov_x", self.fov_x, 0.1, 2.8)?;
        r.within("depth_unit_m", self.depth_unit_m, 1e-5, 0.01)?;
        r.within("frame_rate_hz", self.frame_rate_hz, 1e-3, 1000.0)?;
        let path = &self.path;
        r.count("path.rounds", path.rounds, 1, 1000)?;
        r.within("path.sphere_radius_m", path.sphere_radius_m, 0.01, 100.0)?;
        r.within("path.plane_x_m", path.plane_x_m, -100.0, 100.0)?;
        for height_m in path.height_range_m {
            // Below the top of the sphere, where its circle has no radius.
            r.within("path.height_range_m", height_m, 1e-3, 0.95 * path.sphere_radius_m)?;
        }
        self.sensor.validate(&r)
    }
}

/// Summary of a written recording.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RecordingSummary {
    /// Folder.
    pub dir: PathBuf,
    /// Frames in the recording.
    pub frames: usize,
    /// Frames rendered by this call; the others existed.
    pub rendered: usize,
}

/// Identity of a recording; a folder holds frames of one only.
#[derive(Serialize, Deserialize, PartialEq)]
struct RecordingKey {
    scene: String,
    settings: RecordingSettings,
    program: String,
}

/// Records a scene into `dir` in nerfstudio's layout: `transforms.json` (camera-to-world matrices with OpenGL axes),
/// `color/`, `depth/` (16-bit PNG), `confidence/` for sensors that state it, and `truth/` with `truth.json`, the true label images and their list. Only with
/// `expose_masks` do `masks/` and `objects.json` exist outside `truth/`.
///
/// Existing frames are kept, so that an interrupted recording resumes; `transforms.json` is written last.
///
/// # Errors
/// [`CoreError::Input`] when the settings are out of range or `dir` holds another recording, [`CoreError::Write`],
/// [`CoreError::Interrupted`].
pub fn write_recording(
    scene: &TruthScene,
    settings: &RecordingSettings,
    dir: &Path,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<RecordingSummary, CoreError> {
    let poses = settings.path.poses(scene, settings.frames);
    let views = SceneViews { scene, skins: &[], poses: &poses, source: "" };
    record(&views, hash_serializable(scene).0, settings, dir, progress, cancel)
}

/// A scene, textured or not, and the cameras that record it.
#[derive(Debug, Clone, Copy)]
pub struct SceneViews<'a> {
    /// The scene.
    pub scene: &'a TruthScene,
    /// Image textures of the objects, see [`Renderer::with_skins`].
    pub skins: &'a [Option<Skin>],
    /// Camera poses `X_WC` (OpenCV axes), one per frame.
    pub poses: &'a [DPose3],
    /// Identifies the source of the image textures: recordings of different sources do not mix in one folder.
    pub source: &'a str,
}

/// Records a scene from given camera poses. `settings.frames` and `settings.path` are ignored.
///
/// # Errors
/// As [`write_recording`].
pub fn record_views(
    views: &SceneViews<'_>,
    settings: &RecordingSettings,
    dir: &Path,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<RecordingSummary, CoreError> {
    let key = hash_serializable(&(views.scene, views.poses, views.source)).0;
    let settings = RecordingSettings { frames: views.poses.len(), ..settings.clone() };
    record(views, key, &settings, dir, progress, cancel)
}

fn record(
    views: &SceneViews<'_>,
    key: String,
    settings: &RecordingSettings,
    dir: &Path,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<RecordingSummary, CoreError> {
    let SceneViews { scene, skins, poses, .. } = *views;
    settings.validate().map_err(|error| InputError::new(error.what, dir, error.cure))?;
    claim_folder(key, settings, dir)?;
    write_truth(scene, dir)?;
    let objects = objects_file(scene);
    atomic::write_json(&dir.join("truth/objects.json"), &objects)?;
    if settings.expose_masks {
        atomic::write_json(&dir.join("objects.json"), &objects)?;
    }
    let renderer = Renderer::with_skins(scene, skins);
    let gains = settings.sensor.color.gains(poses.len(), settings.seed);
    let (done, rendered) = (AtomicU64::new(0), AtomicU64::new(0));
    progress.begin("record", settings.frames as u64);
    let written: Vec<Result<(), CoreError>> = poses
        .par_iter()
        .enumerate()
        .map(|(index, &x_wc)| {
            cancel.check()?;
            let state = FrameState::on_path(poses, index, settings.frame_rate_hz);
            let state = FrameState { gain: gains[index], ..state };
            if write_frame(&renderer, settings, dir, index, (x_wc, &state))? {
                rendered.fetch_add(1, Ordering::Relaxed);
            }
            let count = done.fetch_add(1, Ordering::Relaxed) + 1;
            progress.update(count, &format!("{count} of {} frames", settings.frames));
            Ok(())
        })
        .collect();
    written.into_iter().collect::<Result<(), _>>()?;
    atomic::write_json(&dir.join("transforms.json"), &transforms(settings, poses))?;
    let rendered = rendered.into_inner() as usize;
    progress.end(&format!("{} frames recorded", settings.frames));
    Ok(RecordingSummary { dir: dir.to_owned(), frames: settings.frames, rendered })
}

/// Writes `truth/truth.json`, without the line breaks that would double the size of its meshes.
fn write_truth(scene: &TruthScene, dir: &Path) -> Result<(), CoreError> {
    atomic::write_with(&dir.join("truth/truth.json"), |w| {
        serde_json::to_writer(&mut *w, scene).map_err(std::io::Error::other)?;
        w.write_all(b"\n")
    })
}

/// Checks that existing frames in `dir` come from the same scene and settings.
fn claim_folder(scene: String, settings: &RecordingSettings, dir: &Path) -> Result<(), CoreError> {
    let key =
        RecordingKey { scene, settings: settings.clone(), program: env!("CARGO_PKG_VERSION").to_owned() };
    let path = dir.join("truth/recording.json");
    if path.exists() {
        let found: RecordingKey = atomic::read_json(&path)?;
        if found != key {
            let what = "this folder holds a recording of another scene or with other settings";
            return Err(InputError::new(what, dir, "choose another folder, or remove this one").into());
        }
        for folder in ["color", "depth", "confidence", "masks", "truth", "truth/masks"] {
            atomic::remove_leftovers(&dir.join(folder));
        }
        return Ok(());
    }
    if dir.join("transforms.json").exists() || dir.join("color").exists() {
        let what = "this folder holds a recording that sms did not generate";
        let cure = "choose another folder";
        return Err(InputError::new(what, dir, cure).into());
    }
    atomic::write_json(&path, &key)
}

fn frame_name(folder: &str, index: usize) -> String {
    format!("{folder}/{index:06}.png")
}

/// Renders and writes one frame unless it exists; returns whether it did.
fn write_frame(
    renderer: &Renderer,
    settings: &RecordingSettings,
    dir: &Path,
    index: usize,
    (x_wc, state): (DPose3, &FrameState),
) -> Result<bool, CoreError> {
    let mut folders = vec!["color", "depth", "truth/masks"];
    if settings.sensor.depth.has_confidence {
        folders.push("confidence");
    }
    if settings.expose_masks {
        folders.push("masks");
    }
    // Files are written atomically, so that existing ones are complete.
    if folders.iter().all(|f| dir.join(frame_name(f, index)).exists()) {
        return Ok(false);
    }
    let model = CameraModel {
        depth: settings.sensor.depth.clone(),
        color: settings.sensor.color.clone(),
        antialias: true,
        seed: settings.seed.derive_index("frame", index as u64),
    };
    let frame = renderer.render_moving(&Camera::new(settings.intrinsics(), x_wc), &model, state);
    write_png_color(&dir.join(frame_name("color", index)), &frame.color)?;
    write_png_gray16(
        &dir.join(frame_name("depth", index)),
        &encode_depth(&frame.depth_noisy, settings.depth_unit_m),
    )?;
    if let Some(confidence) = &frame.confidence {
        write_png_gray16(&dir.join(frame_name("confidence", index)), confidence)?;
    }
    for folder in folders.iter().filter(|f| f.ends_with("masks")) {
        write_png_gray16(&dir.join(frame_name(folder, index)), &frame.label)?;
    }
    Ok(true)
}

/// Encodes depth in units of `unit_m`; values beyond 16 bits count as not measured.
fn encode_depth(depth: &DepthImage, unit_m: f64) -> Image<u16> {
    depth.map(|&z| {
        let units = (f64::from(z) / unit_m).round();
        if units >= 1.0 && units <= f64::from(u16::MAX) { units as u16 } else { 0 }
    })
}

/// Returns the list of the label images' values, as in `objects.json`.
fn objects_file(scene: &TruthScene) -> Value {
    let entry = |(i, o): (usize, &crate::TruthObject)| json!({ "name": o.name, "description": o.class, "mask_value": i + 1 });
    let objects: Vec<Value> = scene.objects.iter().enumerate().map(entry).collect();
    json!({ "objects": objects, "up_vector_world": [0.0, 0.0, 1.0] })
}

/// Returns the contents of `transforms.json`; the order of the keys is that of the file.
fn transforms(settings: &RecordingSettings, poses: &[DPose3]) -> Value {
    let k = settings.intrinsics();
    let depth = &settings.sensor.depth;
    let recorded = settings.sensor.poses.applied(poses, settings.seed);
    let frame = |(index, x_wc): (usize, &DPose3)| {
        let mut frame = json!({
            "file_path": frame_name("color", index),
            "depth_file_path": frame_name("depth", index),
        });
        if depth.has_confidence {
            frame["confidence_file_path"] = frame_name("confidence", index).into();
        }
        if settings.expose_masks {
            frame["mask_path"] = frame_name("masks", index).into();
        }
        frame["transform_matrix"] = json!(opengl_matrix(x_wc));
        frame
    };
    let mut all = json!({
        "camera_model": "OPENCV",
        "fl_x": k.fx,
        "fl_y": k.fy,
        "cx": k.cx,
        "cy": k.cy,
        "w": k.width,
        "h": k.height,
        "k1": 0.0,
        "k2": 0.0,
        "p1": 0.0,
        "p2": 0.0,
        "depth_unit_scale_factor": settings.depth_unit_m,
        "pixel_center": 0.5,
        "world_up": [0.0, 0.0, 1.0],
        "world_is_aligned": true,
        "camera_convention": "opengl",
        "frames": recorded.iter().enumerate().map(frame).collect::<Vec<_>>(),
    });
    let own = depth.intrinsics(&k);
    if own != k {
        for (key, value) in
            [("depth_fl_x", own.fx), ("depth_fl_y", own.fy), ("depth_cx", own.cx), ("depth_cy", own.cy)]
        {
            all[key] = value.into();
        }
    }
    all
}

/// Returns the rows of the 4 × 4 camera-to-world matrix with OpenGL axes.
fn opengl_matrix(x_wc: &DPose3) -> [[f64; 4]; 4] {
    let flip = DMat4::from_diagonal(glamx::DVec4::new(1.0, -1.0, -1.0, 1.0));
    let matrix = DMat4::from_rotation_translation(x_wc.rotation, x_wc.translation) * flip;
    matrix.transpose().to_cols_array_2d()
}
