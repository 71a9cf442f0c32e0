//! Baselines of the paper's landing experiment (appendix "Baseline Implementation Details"): landing sites and
//! approaches from geometry alone, and methods of choosing among them.
//!
//! | [`Chooser`] | site | approach |
//! |---|---|---|
//! | `visual prompting` | a vision-language model, shown the numbered sites | the same, shown nine numbered curves |
//! | `geometric` | the site nearest the centre of the top face | straight |
//! | `random` | any | any |
//!
//! [`landing_sites`] finds up to 15 places with room for the vehicle, [`approaches`] makes nine Bézier curves to
//! one of them. [`visual_prompting`] draws both on a picture and asks a model through `sms-vlm`; [`geometric`] and
//! [`random`] need none. By design, the baselines ignore masses and the wash.
//!
//! ```
//! use glamx::{DPose3, DVec3};
//! use sms_core::Mesh;
//! use sms_prompting::{ApproachSettings, ObjectSurface, SiteSettings, approaches, geometric, landing_sites};
//! use sms_robots::Quadrotor;
//!
//! let lifted = DPose3::from_translation(DVec3::new(0.2, 0.0, 0.68));
//! let mesh_w = Mesh::cuboid(DVec3::new(0.4, 0.3, 0.02)).transformed(&lifted);
//! let platform = ObjectSurface { name: "box".into(), mesh_w };
//! let sites = landing_sites(&[platform], &Quadrotor::default(), &SiteSettings::default())?;
//! let choice = geometric(&sites, DVec3::new(2.0, 0.0, 1.05), &ApproachSettings::default());
//! assert!(choice.site.p_w.distance(DVec3::new(0.2, 0.0, 0.7)) < 0.02);
//! assert!((choice.approach.path.length() - 1.8).abs() < 0.02, "straight");
//! # Ok::<(), sms_prompting::NoSite>(())
//! ```

mod annotate;
mod approaches;
mod canvas;
mod choice;
mod prompt;
mod sites;
mod top_map;
mod visual;

pub use annotate::{Annotated, best_view, paths_picture, resized, sites_picture};
pub use approaches::{Approach, ApproachSettings, approaches};
pub use choice::{Choice, Chooser, geometric, random};
pub use sites::{LandingSite, NoSite, SiteSettings, Sites, landing_sites};
pub use top_map::{ObjectSurface, surfaces_of};
pub use visual::{Observation, PromptedChoice, PromptingInputs, visual_prompting};
