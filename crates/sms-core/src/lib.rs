//! The types that all stages of `sms` share.
//!
//! Posed cameras and images, label maps, meshes with their mass properties, entities, materials with intervals; and the
//! services of every stage: run folder, warnings, seeds and progress.
//!
//! # Conventions
//! - World `W`: metres, z up, gravity along −z. Recording world `R`: the recording's own.
//! - Camera `C`: OpenCV axes (x right, y down, z forward). The centre of pixel (i, j) is at image-plane
//!   coordinates (i + 0.5, j + 0.5); readers convert.
//! - `x_wc` (monogram notation `X_WC`) is the pose of the camera in the world: it carries a point `p_C` to
//!   `p_W = X_WC · p_C`. Vectors carry their frame in the name: `p_w`, `v_w`.
//! - Poses and geometry are `f64` ([`glamx::DPose3`], [`glamx::DVec3`]); training is `f32`.
//!
//! ```
//! use sms_core::{Camera, Intrinsics};
//! use sms_core::glamx::{DPose3, DVec3};
//! let camera = Camera::new(Intrinsics::from_fov(320, 200, 1.2), DPose3::identity());
//! let p_w = camera.unproject(160.0, 100.0, 2.0);
//! assert!((p_w - DVec3::new(0.0, 0.0, 2.0)).length() < 1e-12);
//! ```

mod angle;
pub mod atomic;
mod camera;
mod cancel;
mod cholesky;
mod color_io;
mod directions;
mod eigen;
mod entity;
mod error;
mod hash;
mod image;
mod inertia;
mod judgement;
mod labels;
mod material;
mod mesh;
mod mesh_io;
mod mesh_texture;
pub mod metrics;
pub mod ply;
mod png_io;
pub mod process;
mod progress;
mod quantile;
mod ranges;
mod remaining_time;
mod run_folder;
mod seed;
mod shell;
mod stage_context;
pub mod table;
mod text;
mod topology;
mod warnings;

pub use angle::wrapped_angle;
pub use camera::{Camera, Intrinsics};
pub use cancel::Cancel;
pub use cholesky::Cholesky;
pub use color_io::{damaged_image, jpeg_bytes, missing_image, read_color, read_color_size};
pub use directions::{GOLDEN_ANGLE_RAD, even_directions};
pub use eigen::symmetric_eigen;
pub use entity::{Entity, EntityKind, EntityShape, PointCloud};
pub use error::{CoreError, ErrorKind, InputError, StageError};
pub use glamx;
pub use hash::{Hash, Hasher, hash_serializable};
pub use image::{ColorImage, DepthImage, Image, NormalImage};
pub use inertia::{
    InertiaError, MassProperties, box_mass_properties, cylinder_mass_properties, polyhedron_mass_properties,
    sphere_mass_properties,
};
pub use judgement::{
    DepthAgreement, Grade, Judgement, is_at_rest, judge_depth_agreement, judge_depth_error, judge_psnr,
    judge_success, judge_surface_error,
};
pub use labels::{BACKGROUND, LabelInfo, LabelMap, Labels, MaskSource};
pub use material::{Interval, Material, Property, PropertySource};
pub use mesh::{Aabb, Mesh};
pub use mesh_texture::{MeshTexture, read_mesh_texture, write_textured_obj};
pub use png_io::{read_png_color, read_png_gray16, read_png_labels, write_png_color, write_png_gray16};
pub use progress::{JsonProgress, NoProgress, PlainProgress, Progress, Status, shown_units};
pub use quantile::{NORMAL_90, QuantileRule, quantile};
pub use ranges::Ranges;
pub use remaining_time::RemainingTime;
pub use run_folder::{RunFolder, STAGE_RECORD, Stage, StageState, toml_value};
pub use seed::{Seed, StageRng, standard_normal};
pub use shell::{shell_argument, shell_word};
pub use stage_context::StageContext;
pub use text::{counted, duration_text, escape_xml, length_text, lengths_text, wrapped};
pub use warnings::{Warning, Warnings};
