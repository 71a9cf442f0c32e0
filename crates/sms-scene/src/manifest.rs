//! `scene.json` and its meshes on disk.
//!
//! Geometry is written once, as OBJ files in `meshes/`, to which both the manifest and the exports refer.

use crate::{Body, BodyKind, BodyShape, SCENE_VERSION, Scene};
use glamx::{DPose3, DVec3};
use serde::{Deserialize, Serialize};
use sms_core::{
    CoreError, ErrorKind, InputError, MassProperties, Material, Mesh, StageError, atomic, read_mesh_texture,
    write_textured_obj,
};
use std::path::Path;

/// Errors of reading and writing scenes.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// Errors of files.
    #[error(transparent)]
    Core(#[from] CoreError),
    /// The scene cannot be simulated.
    #[error("the scene cannot be simulated:\n  {0}")]
    Invalid(String),
}

impl StageError for SceneError {
    fn kind(&self) -> ErrorKind<'_> {
        match self {
            Self::Core(e) => e.kind(),
            Self::Invalid(_) => ErrorKind::Other,
        }
    }
}

impl From<InputError> for SceneError {
    fn from(e: InputError) -> Self {
        Self::Core(e.into())
    }
}

/// `M` is the type of the mass properties. Reading converts them from JSON body by body, so that an error names the body.
#[derive(Serialize, Deserialize)]
struct ManifestFile<M> {
    version: u32,
    name: String,
    units: String,
    gravity_w: DVec3,
    /// Missing in scenes of earlier versions.
    #[serde(default)]
    size_sigma: f64,
    x_world_recording: DPose3,
    bodies: Vec<BodyEntry<M>>,
}

#[derive(Serialize, Deserialize)]
struct BodyEntry<M> {
    name: String,
    label: u16,
    description: String,
    kind: BodyKind,
    x_wb: DPose3,
    shape: ShapeEntry,
    visual: Option<String>,
    mass: Option<M>,
    material: Material,
    color: [u8; 3],
    observed_share: f64,
    /// Missing in scenes of earlier versions.
    #[serde(default)]
    fit_se_m: f64,
}

#[derive(Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case")]
enum ShapeEntry {
    Sphere { radius: f64 },
    Box { half_extents: DVec3 },
    Cylinder { radius: f64, half_length: f64 },
    HalfSpace,
    Hulls { files: Vec<String> },
    TriMesh { file: String },
}

fn visual_stem(body: &str) -> String {
    format!("{body}_visual")
}

/// The problems of a scene, one a line; empty for a valid scene.
fn problem_lines(scene: &Scene) -> String {
    scene.validate().iter().map(ToString::to_string).collect::<Vec<_>>().join("\n  ")
}

/// Returns the file name of a body's visual mesh, below the scene's folder.
pub fn visual_file(body: &Body) -> String {
    format!("meshes/{}.obj", visual_stem(&body.name))
}

/// Returns the file name of a body's hull, below the scene's folder.
pub fn hull_file(body: &Body, index: usize) -> String {
    format!("meshes/{}_hull_{index:02}.obj", body.name)
}

/// Returns the file name of a static body's collision mesh, below the scene's folder.
pub fn trimesh_file(body: &Body) -> String {
    format!("meshes/{}_collision.obj", body.name)
}

/// Writes every mesh of the scene as OBJ below `dir/meshes/`, in body frames, with their image textures.
///
/// # Errors
/// [`CoreError::Write`].
pub fn write_meshes(scene: &Scene, dir: &Path) -> Result<(), CoreError> {
    for body in &scene.bodies {
        if !body.visual.triangles.is_empty() {
            match &body.texture {
                Some(texture) => {
                    write_textured_obj(&body.visual, texture, &dir.join("meshes"), &visual_stem(&body.name))?;
                }
                None => body.visual.write_obj(&dir.join(visual_file(body)))?,
            }
        }
        match &body.shape {
            BodyShape::Hulls { hulls } => {
                for (i, hull) in hulls.iter().enumerate() {
                    hull.write_obj(&dir.join(hull_file(body, i)))?;
                }
            }
            BodyShape::TriMesh { mesh } => mesh.write_obj(&dir.join(trimesh_file(body)))?,
            BodyShape::Sphere { .. }
            | BodyShape::Box { .. }
            | BodyShape::Cylinder { .. }
            | BodyShape::HalfSpace => {}
        }
    }
    Ok(())
}

/// Validates the scene and writes `scene.json` with its meshes into `dir`.
///
/// # Errors
/// [`SceneError::Invalid`] with every problem, or [`SceneError::Core`] when a file cannot be written.
pub fn save_scene(dir: &Path, scene: &Scene) -> Result<(), SceneError> {
    let problems = problem_lines(scene);
    if !problems.is_empty() {
        return Err(SceneError::Invalid(problems));
    }
    write_meshes(scene, dir)?;
    let entry = |body: &Body| BodyEntry {
        name: body.name.clone(),
        label: body.label,
        description: body.description.clone(),
        kind: body.kind,
        x_wb: body.x_wb,
        shape: match &body.shape {
            BodyShape::Sphere { radius } => ShapeEntry::Sphere { radius: *radius },
            BodyShape::Box { half_extents } => ShapeEntry::Box { half_extents: *half_extents },
            BodyShape::Cylinder { radius, half_length } => {
                ShapeEntry::Cylinder { radius: *radius, half_length: *half_length }
            }
            BodyShape::HalfSpace => ShapeEntry::HalfSpace,
            BodyShape::Hulls { hulls } => {
                ShapeEntry::Hulls { files: (0..hulls.len()).map(|i| hull_file(body, i)).collect() }
            }
            BodyShape::TriMesh { .. } => ShapeEntry::TriMesh { file: trimesh_file(body) },
        },
        visual: (!body.visual.triangles.is_empty()).then(|| visual_file(body)),
        mass: body.mass,
        material: body.material.clone(),
        color: body.color,
        observed_share: body.observed_share,
        fit_se_m: body.fit_se_m,
    };
    let file = ManifestFile {
        version: scene.version,
        name: scene.name.clone(),
        units: "metre, kilogram, second, radian; world z up".into(),
        gravity_w: scene.gravity_w,
        size_sigma: scene.size_sigma,
        x_world_recording: scene.x_world_recording,
        bodies: scene.bodies.iter().map(entry).collect(),
    };
    Ok(atomic::write_json(&dir.join("scene.json"), &file)?)
}

/// Reads a scene that [`save_scene`] wrote, and validates it, because a user may have edited it.
///
/// # Errors
/// [`SceneError`] with an [`InputError`] that names the file, the invalid body, and the cure.
pub fn load_scene(dir: &Path) -> Result<Scene, SceneError> {
    let path = dir.join("scene.json");
    let file: ManifestFile<serde_json::Value> = atomic::read_json(&path)?;
    if file.version > SCENE_VERSION {
        return Err(InputError::new(
            format!("this scene has version {}, this program reads up to {SCENE_VERSION}", file.version),
            &path,
            "use a newer version of sms",
        )
        .into());
    }
    let mut bodies = Vec::with_capacity(file.bodies.len());
    for entry in file.bodies {
        let read_mesh = |file: &str| -> Result<Mesh, SceneError> {
            let mesh = dir.join(file);
            if !mesh.is_file() {
                return Err(InputError::new(
                    format!("the mesh `{file}` of body `{}` is missing", entry.name),
                    &path,
                    "restore the file, or write the scene again with `sms materialize`",
                )
                .into());
            }
            Ok(Mesh::read_obj(&mesh)?)
        };
        let mass = entry.mass.map(serde_json::from_value::<MassProperties>).transpose().map_err(|e| {
            InputError::new(
                format!("the mass properties of body `{}` are invalid: {e}", entry.name),
                &path,
                "give `mass_kg` above 0 with a possible `inertia_kg_m2`, or write the scene again with `sms materialize`",
            )
        })?;
        let shape = match entry.shape {
            ShapeEntry::Sphere { radius } => BodyShape::Sphere { radius },
            ShapeEntry::Box { half_extents } => BodyShape::Box { half_extents },
            ShapeEntry::Cylinder { radius, half_length } => BodyShape::Cylinder { radius, half_length },
            ShapeEntry::HalfSpace => BodyShape::HalfSpace,
            ShapeEntry::Hulls { files } => {
                BodyShape::Hulls { hulls: files.iter().map(|f| read_mesh(f)).collect::<Result<_, _>>()? }
            }
            ShapeEntry::TriMesh { file } => BodyShape::TriMesh { mesh: read_mesh(&file)? },
        };
        let (visual, texture) = match &entry.visual {
            Some(file) => {
                (read_mesh(file)?, read_mesh_texture(&dir.join("meshes"), &visual_stem(&entry.name))?)
            }
            None => (Mesh::default(), None),
        };
        bodies.push(Body {
            texture,
            name: entry.name,
            label: entry.label,
            description: entry.description,
            kind: entry.kind,
            x_wb: entry.x_wb,
            shape,
            visual,
            mass,
            material: entry.material,
            color: entry.color,
            observed_share: entry.observed_share,
            fit_se_m: entry.fit_se_m,
        });
    }
    let scene = Scene {
        version: file.version,
        name: file.name,
        gravity_w: file.gravity_w,
        size_sigma: file.size_sigma,
        x_world_recording: file.x_world_recording,
        bodies,
    };
    let problems = problem_lines(&scene);
    if problems.is_empty() {
        return Ok(scene);
    }
    Err(InputError::new(
        format!("this scene cannot be simulated:\n  {problems}"),
        &path,
        "correct these bodies in this file or in their meshes, or write the scene again with `sms materialize`",
    )
    .into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{example_material, floor_body};

    #[test]
    fn a_scene_round_trips_to_the_nanometre() {
        let dir = tempfile::tempdir().unwrap();
        let mesh = Mesh::icosphere(0.04, 1);
        let mass = sms_core::polyhedron_mass_properties(&mesh, 900.0).unwrap();
        let mut body = floor_body(0.0, example_material());
        body.name = "rock".into();
        body.kind = BodyKind::Dynamic;
        body.x_wb = DPose3::from_translation(DVec3::new(0.1, 0.2, 0.3));
        body.mass = Some(MassProperties::new(mass.mass(), DVec3::ZERO, mass.inertia()).unwrap());
        body.shape = BodyShape::Hulls { hulls: vec![mesh.clone()] };
        body.visual = mesh;
        let scene = Scene {
            version: SCENE_VERSION,
            name: "t".into(),
            gravity_w: DVec3::new(0.0, 0.0, -9.81),
            size_sigma: 0.003,
            x_world_recording: DPose3::from_translation(DVec3::X),
            bodies: vec![floor_body(0.01, example_material()), body],
        };
        save_scene(dir.path(), &scene).unwrap();
        let back = load_scene(dir.path()).unwrap();
        assert_eq!((&back.bodies[0], back.size_sigma), (&scene.bodies[0], 0.003));
        let (a, b) = (&back.bodies[1], &scene.bodies[1]);
        assert_eq!((a.x_wb, a.mass, &a.material), (b.x_wb, b.mass, &b.material));
        assert!(a.visual.vertices.iter().zip(&b.visual.vertices).all(|(p, q)| (*p - *q).length() < 1e-9));
        // A second round trip changes nothing: later stages read stable bytes.
        let again = tempfile::tempdir().unwrap();
        save_scene(again.path(), &back).unwrap();
        let read = |d: &Path| std::fs::read(d.join("scene.json")).unwrap();
        assert_eq!(read(dir.path()), read(again.path()));
    }

    #[test]
    fn an_invalid_body_in_the_files_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let mesh = Mesh::cuboid(DVec3::splat(0.03));
        let mass = sms_core::polyhedron_mass_properties(&mesh, 900.0).unwrap();
        let mut body = floor_body(0.0, example_material());
        body.name = "crate".into();
        body.kind = BodyKind::Dynamic;
        body.mass = Some(mass);
        body.shape = BodyShape::Hulls { hulls: vec![mesh.clone()] };
        body.visual = mesh;
        let scene = Scene {
            version: SCENE_VERSION,
            name: "t".into(),
            gravity_w: DVec3::NEG_Z,
            size_sigma: 0.0,
            x_world_recording: DPose3::identity(),
            bodies: vec![floor_body(0.0, example_material()), body],
        };
        let path = dir.path().join("scene.json");
        let hull = dir.path().join(hull_file(&scene.bodies[1], 0));
        let refused = |corrupt: &dyn Fn()| {
            save_scene(dir.path(), &scene).unwrap();
            load_scene(dir.path()).unwrap();
            corrupt();
            let loaded = load_scene(dir.path());
            let Err(SceneError::Core(CoreError::Input(e))) = loaded else { panic!("{loaded:?}") };
            assert!(e.path.ends_with("scene.json"), "{e}");
        };
        let edit = |change: &dyn Fn(&mut serde_json::Value)| {
            let mut json: serde_json::Value =
                serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
            change(&mut json["bodies"][1]);
            std::fs::write(&path, json.to_string()).unwrap();
        };
        refused(&|| edit(&|b| b["mass"]["mass_kg"] = 0.0.into()));
        refused(&|| edit(&|b| b["mass"]["mass_kg"] = (-1.5).into()));
        refused(&|| edit(&|b| b["mass"]["mass_kg"] = serde_json::Value::Null));
        refused(&|| edit(&|b| b["mass"]["inertia_kg_m2"][0][0] = (-1.0).into()));
        refused(&|| edit(&|b| b["mass"] = serde_json::Value::Null));
        refused(&|| std::fs::remove_file(&hull).unwrap());
        let open = || {
            let text = std::fs::read_to_string(&hull).unwrap();
            let at = text.rfind("\nf ").unwrap();
            std::fs::write(&hull, &text[..=at]).unwrap();
        };
        refused(&open);
    }

    #[test]
    fn a_newer_or_invalid_scene_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let scene = Scene {
            version: SCENE_VERSION,
            name: "t".into(),
            gravity_w: DVec3::NEG_Z,
            size_sigma: 0.0,
            x_world_recording: DPose3::identity(),
            bodies: vec![floor_body(0.0, example_material()), floor_body(0.0, example_material())],
        };
        assert!(matches!(save_scene(dir.path(), &scene), Err(SceneError::Invalid(_))));
        let good = Scene { bodies: vec![floor_body(0.0, example_material())], ..scene };
        save_scene(dir.path(), &good).unwrap();
        let path = dir.path().join("scene.json");
        let text = std::fs::read_to_string(&path).unwrap().replace("\"version\": 1", "\"version\": 99");
        std::fs::write(&path, text).unwrap();
        assert!(matches!(load_scene(dir.path()), Err(SceneError::Core(CoreError::Input(_)))));
    }
}
