//! The scene for other simulators.
//!
//! [`export`] writes a [`Scene`] as one folder that can be moved: MJCF, URDF (with a loader for PyBullet), SDFormat, USD
//! with physics schemas, glTF or OBJ; each with `bodies.json`, which lists every body for programs, and a README that says
//! how to load it where, and what the format cannot hold. The folder appears as a whole or not at all, and the same scene
//! gives the same bytes.
//!
//! ```
//! use sms_export::{Format, Sources, export};
//! use sms_scene::{SCENE_VERSION, Scene, example_material, floor_body};
//! use sms_core::glamx::{DPose3, DVec3};
//! let scene = Scene {
//!     version: SCENE_VERSION,
//!     name: "empty desk".into(),
//!     gravity_w: DVec3::new(0.0, 0.0, -9.81),
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

/// What a scene can be written as.
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

    /// Name, as the command line takes it and as the default folder is called.
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

    /// The file to open, below the folder.
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

    /// Folder (with its slash) in which `meshes/` of a body lies; `None` where meshes are no files of their own.
    fn mesh_folder(self, body: &Body) -> Option<String> {
        match self {
            Self::Mjcf | Self::Urdf | Self::Obj => Some(String::new()),
            Self::Sdf => Some(format!("models/{}/", body.name)),
            Self::Usd | Self::Glb => None,
        }
    }
}

/// Where the parts of an export that are not in the [`Scene`] come from.
#[derive(Debug, Clone, Default)]
pub struct Sources {
    /// Folder with the Gaussians of each body in its body frame, `<name>.ply`; copied where present.
    pub gaussians: Option<PathBuf>,
}

/// Writes the scene into the folder `dir`, replacing an earlier export, and returns the file to open.
///
/// # Errors
/// [`CoreError::Input`] when `dir` holds something other than an earlier export; [`CoreError::Write`]. What was there
/// before then stays as it was.
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

/// Copies the Gaussians of the bodies that have some; returns those bodies' names.
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
