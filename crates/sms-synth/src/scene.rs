//! The truth of a generated scene. The planner never reads it; `execute`, `evaluate` and benchmarks do.

use crate::texture::Texture;
use glamx::{DPose3, DVec3};
use serde::{Deserialize, Serialize};
use sms_core::{Aabb, CoreError, InputError, MassProperties, Material, Mesh, Seed, atomic};
use std::collections::BTreeMap;
use std::path::Path;

/// Version of `truth.json`; readers refuse newer ones. 2: textures have `metalness`.
const TRUTH_VERSION: u32 = 2;

/// A generated scene with its complete truth. World: metres, z up, floor at z = 0, robot base at the
/// origin, the robot facing +x.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TruthScene {
    /// Schema version.
    pub version: u32,
    /// Name ("billiards seed 1").
    pub name: String,
    /// The seed that made it.
    pub seed: Seed,
    /// The objects: cue ball, target ball, then the obstacles. The label of `objects[i]` in label maps is `i + 1`.
    pub objects: Vec<TruthObject>,
    /// The floor.
    pub floor: TruthFloor,
    /// Name of the cue ball.
    pub cue: String,
    /// Name of the target ball.
    pub target: String,
    /// Goal of the target ball on the floor, metres.
    pub goal_w: [f64; 2],
    /// Base of the manipulator in the world.
    pub robot_base_w: DVec3,
    /// Centre of the workspace, at which the cameras look.
    pub workspace_center_w: DVec3,
    /// Truth of a landing structure; `None` in other scenes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub landing: Option<LandingTruth>,
}

/// One object. Its body frame `B` has its origin at the centre of mass and its axes parallel to the world's at
/// scan time (`x_wb` is a translation), as in the manifest of `sms-scene`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TruthObject {
    /// Unique name, usable as a file name.
    pub name: String,
    /// Description ("ceramic mug").
    pub class: String,
    /// True material, drawn around the published ranges of its class. `density` is the effective one over the
    /// closed outer volume: `mass / mesh.volume()`.
    pub material: Material,
    /// Radius in metres if the object is exactly a sphere.
    pub sphere_radius: Option<f64>,
    /// Closed, oriented, vertex-coloured surface in `B`, metres. For spheres a fine polyhedron for pictures; physics
    /// and the camera use the exact sphere.
    pub mesh: Mesh,
    /// Convex pieces in `B` whose union is the solid as simulated; closed meshes whose vertices are their corners.
    /// Empty for spheres.
    pub parts: Vec<Mesh>,
    /// Pose in the world, `X_WB`.
    pub x_wb: DPose3,
    /// Surface appearance.
    pub texture: Texture,
    /// `X_AB`: carries points of `B` into the asset frame `A` (origin on the floor below the asset's axis), in which
    /// the texture is defined.
    pub x_ab: DPose3,
    /// Interior of the closed surface.
    pub hollow: Hollow,
    /// Mass, centre of mass (the origin) and inertia in `B`.
    pub mass: MassProperties,
}

/// Interior of the closed surface of an object.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum Hollow {
    /// Solid material.
    Solid,
    /// An open vessel: the surface includes the cavity, material fills the walls.
    Vessel {
        /// Smallest wall thickness, metres.
        wall_m: f64,
    },
    /// A closed shell of this thickness around air.
    Shell {
        /// Wall thickness, metres.
        wall_m: f64,
        /// Density of the wall's substance, kg/m³.
        wall_density: f64,
    },
}

/// A square floor at z = 0, centred at the world's origin.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TruthFloor {
    /// Half of its edge length, metres.
    pub half_size_m: f64,
    /// True material.
    pub material: Material,
    /// Surface appearance, seeded.
    pub texture: Texture,
}

/// Truth of a landing structure besides its objects.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LandingTruth {
    /// Name of the object to land on.
    pub platform: String,
    /// Height of its top, metres.
    pub top_m: f64,
    /// Outline of its top, counterclockwise in the world's x and y, metres.
    pub outline_w: Vec<[f64; 2]>,
    /// Unit vector in the world's x and y from the base to the overhang's end.
    pub overhang_w: [f64; 2],
    /// The middle of the overhang's end, in the world's x and y, metres.
    pub end_w: [f64; 2],
    /// The levels at which the stack can tip; see [`TruthScene::tipping_load_n`].
    pub supports: Vec<SupportLevel>,
    /// Starts of the benchmark's flights, on a circle of 2 m around the structure, 0.35 m above the platform.
    pub starts_w: Vec<DVec3>,
}

/// A level at which a stack stands on another object or the floor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SupportLevel {
    /// The objects above the level: the one that stands on it and its whole load.
    pub above: Vec<String>,
    /// The object below; `None` for the floor.
    pub below: Option<String>,
    /// Height of the level, metres.
    pub height_m: f64,
    /// Convex hull of the contact, counterclockwise in the world's x and y, metres.
    pub footprint_w: Vec<[f64; 2]>,
}

impl TruthScene {
    /// Creates a scene of objects on a floor, without balls, goal or robot; the workspace's centre is the origin.
    pub fn of_objects(name: String, seed: Seed, objects: Vec<TruthObject>, floor: TruthFloor) -> Self {
        Self {
            version: TRUTH_VERSION,
            name,
            seed,
            objects,
            floor,
            cue: String::new(),
            target: String::new(),
            goal_w: [0.0; 2],
            robot_base_w: DVec3::ZERO,
            workspace_center_w: DVec3::ZERO,
            landing: None,
        }
    }

    /// Returns the object of this name.
    pub fn object(&self, name: &str) -> Option<&TruthObject> {
        self.objects.iter().find(|o| o.name == name)
    }
}

impl TruthObject {
    /// Returns the surface in the world.
    pub fn mesh_w(&self) -> Mesh {
        self.mesh.transformed(&self.x_wb)
    }

    /// Returns the box around the object in the world; exact for spheres.
    pub fn aabb_w(&self) -> Aabb {
        let center = self.x_wb.translation;
        match self.sphere_radius {
            Some(r) => Aabb { min: center - DVec3::splat(r), max: center + DVec3::splat(r) },
            None => self.mesh_w().aabb().unwrap_or(Aabb { min: center, max: center }),
        }
    }
}

/// Returns the box around all objects of a scene in the world; empty at the origin without objects.
pub fn bounds_w(scene: &TruthScene) -> Aabb {
    let boxes = scene.objects.iter().map(TruthObject::aabb_w);
    let join = |a: Aabb, b: Aabb| Aabb { min: a.min.min(b.min), max: a.max.max(b.max) };
    boxes.reduce(join).unwrap_or(Aabb { min: DVec3::ZERO, max: DVec3::ZERO })
}

/// Lifts an object that stands on the floor onto the top of another.
pub fn on_top(mut object: TruthObject, below: &TruthObject) -> TruthObject {
    let lift = DPose3::from_translation(DVec3::Z * below.aabb_w().max.z);
    object.x_wb = lift * object.x_wb;
    object
}

/// Makes names unique by numbering repeated ones: `mug`, `mug_2`, `mug_3` …
pub fn name_uniquely(objects: &mut [TruthObject]) {
    let mut used: BTreeMap<String, usize> = BTreeMap::new();
    for object in objects {
        let count = used.entry(object.name.clone()).or_default();
        *count += 1;
        if *count > 1 {
            object.name = format!("{}_{count}", object.name);
        }
    }
}

/// Reads `truth/truth.json` of a recording written by [`crate::write_recording`].
///
/// # Errors
/// [`CoreError::Read`] when there is no such file, [`CoreError::Input`] when it is damaged or newer than this program.
pub fn read_truth(dir: &Path) -> Result<TruthScene, CoreError> {
    let path = dir.join("truth").join("truth.json");
    let scene: TruthScene = atomic::read_json(&path)?;
    if scene.version > TRUTH_VERSION {
        let version = scene.version;
        let what = format!("this truth.json has version {version}, this program reads up to {TRUTH_VERSION}");
        let cure = "use a newer version of sms, or generate the recording again";
        return Err(InputError::new(what, &path, cure).into());
    }
    Ok(scene)
}
