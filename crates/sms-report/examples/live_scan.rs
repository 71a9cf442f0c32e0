//! Scans the frames and masks of a finished run again, with the `draft` preset, and streams the scan to a Rerun viewer:
//! `cargo run --release -p sms-report --features rerun --example live_scan -- RUN [ADDR]`.

use sms_core::{Cancel, PlainProgress, Seed, StageContext, Warnings};
use sms_frames::Sequence;
use sms_gaussians::{CpuTrainer, Preset, ScanConfig, scan};
use sms_report::{LiveScan, Viewer};
use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let run = arguments.next().ok_or("the folder of a run is missing")?;
    let viewer = arguments.next().map_or(Viewer::Any, Viewer::At);
    let sequence = Sequence::load(&Path::new(&run).join("frames"))?;
    let labels = sms_masks::load_labels(&Path::new(&run).join("masks"))?;
    let config = ScanConfig::preset(Preset::Draft);
    let mut live = LiveScan::start(&viewer, &run)?;
    let mut trainer = CpuTrainer::new(&config.train, labels.class_count(), Seed(0));
    let work = tempfile::tempdir()?;
    let progress = PlainProgress::default();
    let (cancel, warnings) = (Cancel::new(), Warnings::new());
    scan(
        &sequence,
        &labels,
        &config,
        work.path(),
        &mut trainer,
        &mut live,
        StageContext::new(&progress, &cancel, &warnings),
    )?;
    live.finish()?;
    Ok(())
}
