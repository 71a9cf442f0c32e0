//! The paper's billiards experiment (section "Experiments", Table 1) on the eighteen fixed scenes: scan, materialize, plan
//! from many starts, and execute every plan in the target worlds.
//!
//! `planner_view.rs` builds the planner's view from the recording and the material prior; plans in `rows.rs` use
//! only that. Only `realise.rs` and `ablation.rs` read the truth. Each scene is a file, written after planning and after
//! every engine, so that interrupted runs resume and shards share one folder.

mod ablated;
mod ablation;
mod drawing;
mod figures;
mod grid;
mod options;
mod pictures;
pub(crate) mod planner_view;
mod realise;
mod result;
mod row;
mod rows;
mod run;
mod table;
mod vlm_materials;

pub use ablated::{Ablated, Ablation, Replaced};
pub use drawing::{Drawing, Way};
pub use figures::billiards_metrics;
pub use grid::{GridBaseline, GridPlan};
pub use options::{BilliardsBench, BilliardsGeometry, paper_entities};
pub use pictures::write_pictures;
pub use result::{BilliardsScene, Shot, read_billiards, write_shots};
pub use row::{Row, Unfinished};
pub use run::{run_billiards, scan_billiards};
pub use table::billiards_table;
