//! Settings of the stage.

use serde::{Deserialize, Serialize};
use sms_core::{InputError, Ranges};
use sms_mesh::{ConvexConfig, PrimitiveConfig, SphereConfig};
use std::path::PathBuf;

/// Rule that chooses the tetrahedra of the solid.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MeshRule {
    /// Each tetrahedron is voted in or out by its corners' normals and the cameras' free space; the votes are
    /// reconciled by a minimum cut.
    #[default]
    Vote,
    /// The paper's rule: tetrahedra with a long edge are dropped.
    Prune,
}

/// Settings of the entities stage; lengths in metres.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EntitiesConfig {
    /// Inside rule of the mesher.
    pub mesh: MeshRule,
    /// Gaussians whose label is less certain than this are left out.
    pub min_confidence: f64,
    /// Gaussians more transparent than this are left out.
    pub min_opacity: f64,
    /// Least surface points per square metre (released code: 25 000, 6.3 mm apart).
    pub density_per_m2: f64,
    /// Number of surface points for a small object, which is sampled more finely.
    pub point_budget: usize,
    /// Smallest point distance of small objects, metres. Finer points only repeat the noise of the scan.
    pub min_spacing: f64,
    /// Discs are sampled out to this number of standard deviations.
    pub disc_sigmas: f64,
    /// Whether points are moved along their normals to the median of the measured depth.
    pub refine_to_depth: bool,
    /// Largest tetrahedron edge of the prune rule in local feature sizes (released code: 2.25).
    pub prune_factor: f64,
    /// Neighbours whose mean distance is the local feature size (released code: 10).
    pub prune_neighbors: usize,
    /// Fixed largest tetrahedron edge of the prune rule in place of the adaptive one, metres.
    pub prune_length: Option<f64>,
    /// Rounds of Taubin smoothing.
    pub smoothing_iterations: usize,
    /// Largest number of faces of an object's mesh.
    pub face_budget: usize,
    /// Sphere recognition.
    pub sphere: SphereConfig,
    /// Recognition of boxes and cylinders.
    pub primitive: PrimitiveConfig,
    /// Convex parts.
    pub convex: ConvexConfig,
    /// Folder that caches convex decompositions. It does not change the result.
    #[serde(skip)]
    pub parts_cache: Option<PathBuf>,
    /// Textures on meshes.
    pub texture: TextureConfig,
    /// The static environment.
    pub environment: EnvironmentConfig,
}

impl Default for EntitiesConfig {
    fn default() -> Self {
        Self {
            mesh: MeshRule::default(),
            min_confidence: 0.5,
            min_opacity: 0.1,
            density_per_m2: 25_000.0,
            point_budget: 12_000,
            min_spacing: 0.0015,
            disc_sigmas: 2.0,
            refine_to_depth: true,
            prune_factor: 2.25,
            prune_neighbors: 10,
            prune_length: None,
            smoothing_iterations: 10,
            face_budget: 2000,
            sphere: SphereConfig::default(),
            primitive: PrimitiveConfig::default(),
            convex: ConvexConfig::default(),
            parts_cache: None,
            texture: TextureConfig::default(),
            environment: EnvironmentConfig::default(),
        }
    }
}

impl EntitiesConfig {
    /// Checks all values.
    ///
    /// # Errors
    /// [`InputError`] that names the key and its range.
    pub fn validate(&self) -> Result<(), InputError> {
        let r = Ranges::of("entities");
        let (sphere, convex, environment) = (&self.sphere, &self.convex, &self.environment);
        for (key, value, low, high) in [
            ("min_confidence", self.min_confidence, 0.0, 1.0),
            ("min_opacity", self.min_opacity, 0.0, 1.0),
            ("density_per_m2", self.density_per_m2, 1.0, 1e8),
            ("min_spacing", self.min_spacing, 1e-5, 1.0),
            ("disc_sigmas", self.disc_sigmas, 1e-3, 10.0),
            ("prune_factor", self.prune_factor, 1e-3, 1e3),
            ("prune_length", self.prune_length.unwrap_or(1.0), 1e-6, 1e3),
            ("sphere.inlier_distance", sphere.inlier_distance, 0.0, 1.0),
            ("sphere.inlier_radius_share", sphere.inlier_radius_share, 0.0, 1.0),
            ("sphere.min_inlier_share", sphere.min_inlier_share, 0.0, 1.0),
            ("sphere.min_coverage", sphere.min_coverage, 0.0, 1.0),
            ("sphere.min_radius", sphere.min_radius, 0.0, 100.0),
            ("sphere.max_radius", sphere.max_radius, 0.0, 100.0),
            ("primitive.inlier_distance", self.primitive.inlier_distance, 1e-5, 1.0),
            ("primitive.min_inlier_share", self.primitive.min_inlier_share, 0.0, 1.0),
            ("primitive.max_volume_error", self.primitive.max_volume_error, 0.0, 1.0),
            ("convex.threshold", convex.threshold, 1e-3, 1.0),
            ("convex.floor", convex.floor, 0.0, 1.0),
            ("texture.texel_m", self.texture.texel_m, 1e-5, 1.0),
            ("environment.spacing", environment.spacing, 5e-4, 1.0),
            ("environment.reach", environment.reach, 0.0, 100.0),
            ("environment.floor_band", environment.floor_band, 0.0, 1.0),
        ] {
            r.within(key, value, low, high)?;
        }
        for (key, value, low, high) in [
            ("point_budget", self.point_budget, 50, 10_000_000),
            ("prune_neighbors", self.prune_neighbors, 1, 1000),
            ("smoothing_iterations", self.smoothing_iterations, 0, 1000),
            ("face_budget", self.face_budget, 12, 10_000_000),
            ("sphere.samples", sphere.samples, 1, 1_000_000),
            ("convex.max_parts", convex.max_parts, 1, 1024),
            ("convex.max_vertices", convex.max_vertices, 8, 64),
            ("texture.max_side", self.texture.max_side, 64, 16_384),
            ("texture.views", self.texture.views, 1, 8),
            ("texture.image_side", self.texture.image_side, 16, 16_384),
            ("environment.face_budget", environment.face_budget, 12, 10_000_000),
        ] {
            r.count(key, value, low, high)?;
        }
        r.ordered(("sphere.min_radius", sphere.min_radius), ("sphere.max_radius", sphere.max_radius))
    }
}

/// Textures on meshes, baked from the frames.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TextureConfig {
    /// Whether meshes get textures. If not, they have only vertex colours.
    pub enabled: bool,
    /// Size of a texel on the surface, metres; larger if the texture would exceed `max_side`.
    pub texel_m: f64,
    /// Longest side of a texture, pixels.
    pub max_side: usize,
    /// Number of views averaged for a texel (at most 8).
    pub views: usize,
    /// Long side at which recorded colour images are read for textures, pixels.
    pub image_side: usize,
}

impl Default for TextureConfig {
    fn default() -> Self {
        Self { enabled: true, texel_m: 0.001, max_side: 2048, views: 3, image_side: 1280 }
    }
}

/// Open meshes of all surface that does not move.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EnvironmentConfig {
    /// Whether the environment is built. The other settings also apply to bodies that are kept fixed, without `reach`.
    pub enabled: bool,
    /// Least distance between the points of static meshes, metres.
    pub spacing: f64,
    /// Environment farther than this from every object is left out, metres.
    pub reach: f64,
    /// Largest number of faces of all static meshes together.
    pub face_budget: usize,
    /// Surface closer than this to the support plane is part of the plane, metres.
    pub floor_band: f64,
}

impl Default for EnvironmentConfig {
    fn default() -> Self {
        Self { enabled: true, spacing: 0.006, reach: 0.5, face_budget: 2000, floor_band: 0.012 }
    }
}
