//! Scans a recording, plans the task in its folder and exports the scene as MJCF:
//! `sms sample recording && cargo run --release -p sms-pipeline --example scan_to_mjcf recording`.

use sms_pipeline::{Context, Error, Format, MaterializeRequest, PlanRequest, PlannedTask, Run, ScanRequest};
use std::path::PathBuf;

fn main() -> Result<(), Error> {
    let recording = PathBuf::from(std::env::args().nth(1).unwrap_or_else(|| "recording".into()));
    let context = Context::default();
    let run = Run::new(recording.with_extension("run"), &context);

    let scan = run.scan(&recording, &ScanRequest::default())?;
    println!("{} objects; Gaussians in {}", scan.objects, scan.gaussians.display());
    let scene = run.materialize(&MaterializeRequest::default())?;
    println!("{} entities; scene in {}", scene.entities.entities.len(), scene.scene_dir.display());
    if let PlannedTask::Strike { plan, .. } = run.plan(&PlanRequest::new(recording.join("task.toml")))? {
        println!("predicted objective: {:.3} m", plan.objective);
    }
    for file in run.export(&[Format::Mjcf], None)? {
        println!("MJCF in {}", file.display());
    }
    Ok(())
}
