//! Export of scenes to other simulators.
//!
//! [`export`] writes a [`Scene`] as one folder that can be moved: MJCF, URDF (with a loader for PyBullet), SDFormat, USD
//! with physics schemas, glTF or OBJ; each with `bodies.json`, which lists every body for programs, and a README on
//! how to load it and on the limits of the format. The folder is written atomically, and the same scene gives the same bytes.
//!
//! ```
//! use sms_export::{Format, Sources, export};
//! use sms_scene::{SCENE_VERSION, Scene, example_material, floor_body};
//! use sms_core::glamx::{DPose3, DVec3};
//! let scene = Scene {
//!     version: SCENE_VERSION,
//!     name: "empty desk".into(),
//!     gravity_w: DVec3::new(0.0, 0.0, -9.81),
//!     size_sigma: 0.0,
//!     x_world_recording: DPose3::identity(),
//!     bodies: vec![floor_body(0.0, example_material())],
//! };
//! let dir = tempfile::tempdir().unwrap();
//! let main_file = export(&scene, Format::Sdf, &Sources::default(), &dir.path().join("desk")).unwrap();
//! assert!(std::fs::read_to_string(main_file).unwrap().contains("<plane>"));
//! ```

mod bodies;
mod contact;
#[cfg(test)]
mod example;
mod folder;
mod gltf;
mod mjcf;
mod mjcf_view;
mod obj;
mod readme;
mod sdf;
mod surface;
mod text;
mod urdf;
mod usd;

pub use mjcf::mjcf_text;

use sms_core::{CoreError, atomic};
use sms_scene::{Body, Scene};
use std::fs;
use std::path::{Path, PathBuf};

/// Export formats.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Format {
    /// MuJoCo's XML.
    Mjcf,
    /// One URDF file per body, with a loader for PyBullet.
    Urdf,
    /// An SDFormat world (Gazebo) and one model per body.
    Sdf,
    /// OpenUSD with physics schemas (Isaac Sim, Omniverse).
    Usd,
    /// glTF 2.0 binary: the scene, and each object.
    Glb,
    /// Wavefront OBJ: the scene, each object and its convex parts.
    Obj,
}

impl Format {
    /// Every format.
    pub const ALL: [Self; 6] = [Self::Mjcf, Self::Urdf, Self::Sdf, Self::Usd, Self::Glb, Self::Obj];

    /// Returns the name on the command line and of the default folder.
    pub fn name(self) -> &'static str {
        match self {
            Self::Mjcf => "mjcf",
            Self::Urdf => "urdf",
            Self::Sdf => "sdf",
            Self::Usd => "usd",
            Self::Glb => "glb",
            Self::Obj => "obj",
        }
    }

    /// Returns the file to open, relative to the folder.
    pub fn main_file(self) -> &'static str {
        match self {
            Self::Mjcf => "scene.xml",
            Self::Urdf => "load_pybullet.py",
            Self::Sdf => "world.sdf",
            Self::Usd => "scene.usda",
            Self::Glb => "scene.glb",
            Self::Obj => "scene.obj",
        }
    }

    /// Returns the folder (with its slash) of a body's `meshes/`; `None` for formats without separate mesh files.
    fn mesh_folder(self, body: &Body) -> Option<String> {
        match self {
            Self::Mjcf | Self::Urdf | Self::Obj => Some(String::new()),
            Self::Sdf => Some(format!("models/{}/", body.name)),
            Self::Usd | Self::Glb => None,
        }
    }
}

/// Sources of the parts of an export that are not in the [`Scene`].
#[derive(Debug, Clone, Default)]
pub struct Sources {
    /// Folder with the Gaussians of each body in its body frame, `<name>.ply`; copied if present.
    pub gaussians: Option<PathBuf>,
}

/// Writes the scene into the folder `dir`, replacing an earlier export, and returns the file to open.
///
/// # Errors
/// [`CoreError::Input`] when `dir` holds something other than an earlier export; [`CoreError::Write`]. The
/// existing folder is kept then.
pub fn export(scene: &Scene, format: Format, sources: &Sources, dir: &Path) -> Result<PathBuf, CoreError> {
    folder::write_folder(dir, |work| {
        match format {
            Format::Mjcf => mjcf::write(work, scene)?,
            Format::Urdf => urdf::write(work, scene)?,
            Format::Sdf => sdf::write(work, scene)?,
            Format::Usd => usd::write(work, scene)?,
            Format::Glb => gltf::write(work, scene)?,
            Format::Obj => obj::write(work, scene)?,
        }
        let gaussians = copy_gaussians(scene, sources, work)?;
        let readme = readme::text(scene, format, !gaussians.is_empty());
        atomic::write_bytes(&work.join("README.md"), readme.as_bytes())?;
        atomic::write_json(&work.join(folder::MANIFEST), &bodies::bodies_json(scene, format, &gaussians))
    })?;
    Ok(dir.join(format.main_file()))
}

/// Copies the Gaussians of bodies; returns the names of the bodies that have some.
fn copy_gaussians(scene: &Scene, sources: &Sources, work: &Path) -> Result<Vec<String>, CoreError> {
    let Some(from) = &sources.gaussians else { return Ok(Vec::new()) };
    let mut copied = Vec::new();
    for body in &scene.bodies {
        let file = format!("{}.ply", body.name);
        let source = from.join(&file);
        if source.is_file() {
            let bytes = fs::read(&source).map_err(CoreError::read(&source))?;
            atomic::write_bytes(&work.join("gaussians").join(&file), &bytes)?;
            copied.push(body.name.clone());
        }
    }
    Ok(copied)
}
