//! Builds the entities of a recording straight from its depth, without training, and prints their properties.
//!
//! `cargo run --release -p sms-entities --example from_depth -- RECORDING files|truth|geometry [OUT]`

use sms_core::{Cancel, NoProgress, StageContext, Warnings};
use sms_entities::{EntitiesConfig, build_entities, save_entities};
use sms_frames::{LoadSettings, ReadOptions, Recording, load};
use sms_gaussians::GaussianModel;
use sms_masks::{FileMasks, GeometryMasks, Segmenter, TruthMasks};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [source, masks, ..] = arguments.as_slice() else {
        return Err("usage: from_depth RECORDING files|truth|geometry [OUT]".into());
    };
    let (progress, cancel, warnings) = (NoProgress, Cancel::new(), Warnings::new());
    let recording = Recording::open(source, &ReadOptions::default())?;
    let sequence =
        load(&recording, &LoadSettings::default(), StageContext::new(&progress, &cancel, &warnings))?;
    let segmenter: Box<dyn Segmenter> = match masks.as_str() {
        "truth" => Box::new(TruthMasks),
        "geometry" => Box::new(GeometryMasks::default()),
        _ => Box::new(FileMasks::default()),
    };
    let labels = segmenter.segment(&sequence, StageContext::new(&progress, &cancel, &warnings))?;
    let progress = sms_core::PlainProgress::new(std::time::Duration::ZERO);
    let began = std::time::Instant::now();
    let config = EntitiesConfig::default();
    let model = GaussianModel::default();
    let set = build_entities(
        &model,
        &sequence,
        &labels,
        &config,
        StageContext::new(&progress, &cancel, &warnings),
    )?;
    println!(
        "{:.2?}, support {:?}, X_world_recording {:?}",
        began.elapsed(),
        set.support_height,
        sequence.x_world_recording
    );
    for e in &set.entities {
        println!(
            "{:>3} {:24} {:?} cloud {} faces {} volume {:.1} cm³ parts {} observed {:.2} residual {:.2} mm box {:?}",
            e.label,
            e.name,
            e.shape,
            e.cloud.points_w.len(),
            e.mesh.triangles.len(),
            1e6 * e.mesh.volume(),
            e.parts.len(),
            e.observed_share,
            1e3 * e.residual_m,
            e.mesh.aabb().map(|b| (b.min, b.max)),
        );
    }
    for w in warnings.snapshot() {
        println!("{} {}: {}", w.stage, w.code, w.message);
    }
    if let Some(out) = arguments.get(2) {
        save_entities(std::path::Path::new(out), &set)?;
    }
    Ok(())
}
