//! Metrics, and comparison with known models and generated truth.
//!
//! - **Known models**: [`evaluate_object`] compares a mesh with a scanned or exact surface, [`SolidScores`] its mass
//!   properties, [`match_objects`] assigns reconstructed objects to known ones.
//! - **Truth of generated scenes**: [`true_surfaces`] and [`true_views`]; [`observed_surface_at_most`] is the part of a
//!   surface that at least three cameras see. [`match_labels`] finds the true object of each mask label.
//! - **Colour and depth**: [`psnr_db`] of held-out views, all pixels; [`DepthErrors`] against noise-free depth.
//! - **Labels**: [`mean_iou`] of rendered labels, [`score_masks`] of mask images.
//! - **Surfaces**: points on the discs of an object's Gaussians ([`disc_points`]) compared with its true surface
//!   ([`score_labelled`]). The score of a scene is the mean over its objects.
//! - **Entities**: [`surface_figures`], [`solid_figures`], [`placed_figures`].
//! - **Recorded depth**: [`depth_agreement`] of the scene's surfaces with the depth of any recording, without a reference.
//! - **Physics engines**: [`closed_form`] experiments.
//!
//! ```
//! use sms_core::Mesh;
//! use sms_eval::{EvaluateSettings, KnownSurface, evaluate_object};
//! let (found, truth) = (Mesh::icosphere(0.0301, 4), Mesh::icosphere(0.03, 4));
//! let scores = evaluate_object(&found, KnownSurface::Mesh(&truth), &EvaluateSettings::default()).unwrap();
//! assert!((scores.chamfer_m - 1e-4).abs() < 1e-5 && scores.f1_2p5mm == 1.0);
//! ```
//!
//! ```
//! use sms_core::glamx::DVec3;
//! use sms_eval::{F1_M, SurfacePoint, score_surface};
//! // A floor 2 mm too high is within 2.5 mm.
//! let observed: Vec<SurfacePoint> = (0..100)
//!     .map(|i| SurfacePoint { point: DVec3::new(0.001 * f64::from(i), 0.0, 0.0), normal: DVec3::Z })
//!     .collect();
//! let found: Vec<DVec3> = observed.iter().map(|s| s.point + DVec3::Z * 0.002).collect();
//! let scores = score_surface(&found, |p| p.z.abs(), &observed);
//! assert!((scores.median_m - 0.002).abs() < 1e-12 && scores.f1 == 1.0 && F1_M == 0.0025);
//! ```

mod assignment;
pub mod closed_form;
mod depth_agreement;
mod entity_scores;
mod evaluate;
mod images;
mod label_matching;
mod mask_scores;
mod overlap;
mod placement;
mod solids;
mod statistics;
mod surface_index;
mod surface_scores;
mod truth;

pub use assignment::{least_cost_assignment, match_objects};
pub use depth_agreement::{AGREES_M, AGREES_SHARE, DepthAgreement, SceneAgreement, depth_agreement};
pub use entity_scores::{SURFACE_SAMPLES, solid_figures, surface_figures};
pub use evaluate::{
    EvaluateError, EvaluateSettings, KnownObject, KnownSurface, ObjectScores, compare_sphere,
    evaluate_object, read_known_objects,
};
pub use images::{DepthErrors, DepthScores, mean_iou, psnr_db};
pub use label_matching::{Overlaps, UNMATCHED, match_labels};
pub use mask_scores::{FOUND_IOU, MaskScores, MaskedObject, score_masks};
pub use overlap::collision_solids;
pub use placement::placed_figures;
pub use solids::{SolidScores, entity_solid, known_solid};
pub use statistics::mean;
pub use surface_index::{ClosestPoint, SurfaceIndex, sample_surface};
pub use surface_scores::{
    CROP_M, DiscSampling, F1_M, LabelledPoint, SceneScores, SurfaceScores, disc_points, is_near,
    score_cropped, score_labelled, score_surface, stray_share,
};
pub use truth::{
    OBSERVED_BY, OBSERVED_SPACING_M, SurfacePoint, TrueSurface, TrueView, carried, observed_surface_at_most,
    sample_true_surface, true_surfaces, true_views,
};
