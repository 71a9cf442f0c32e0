//! The paper's landing experiment (section "Quadrotor Landing Scenario") on the four fixed structures, or on drawn ones: scan,
//! materialize, plan from ten starts, and fly every plan in the target world, together with baselines without a wash model.
//!
//! Plans use the scan and the material prior; only `run.rs` reads the truth: for the starts, for the prior of
//! materials, and to fly plans. Every flight is a file,
//! so that an interrupted run resumes, and shards of a run meet in one folder.

mod options;
mod result;
mod run;
mod sight;
mod stand;
mod table;

pub use options::{LandingBaseline, LandingBench, LandingChoice, LandingPart};
pub use result::{LandingFlight, LandingPlanned, read_landings};
pub use run::{LandingScan, run_landing, run_landings, scan_landings};
pub use sight::LandingSight;
pub use stand::{EdgeLoad, Standing};
pub use table::{landing_metrics, landing_scan_metrics, landing_table};
