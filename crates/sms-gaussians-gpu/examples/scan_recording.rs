//! A whole scan of a recording on the CPU or a GPU, with its time and quality:
//! `scan_recording RECORDING cpu|gpu[:N] [draft|standard|fine] [--paper]`.
//!
//! Masks come from geometry, every eighth frame is held out, and frames are loaded at 640 pixels, the paper's half
//! resolution, whatever the preset.

use sms_core::{Cancel, NoProgress, Seed, Warnings};
use sms_frames::{LoadSettings, ReadOptions, Recording, load};
use sms_gaussians::{CpuTrainer, Preset, ScanConfig, Trainer, scan};
use sms_gaussians_gpu::{Choice, checked_trainer};
use sms_masks::{GeometryMasks, Segmenter};
use std::path::Path;
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [recording, device, options @ ..] = &arguments[..] else {
        return Err("give RECORDING cpu|gpu[:N] [draft|standard|fine] [--paper]".into());
    };
    let (cancel, warnings, seed) = (Cancel::new(), Warnings::new(), Seed(0));
    let recording = Recording::open(Path::new(recording), &ReadOptions::default())?;
    let settings = LoadSettings { long_side: 640, ..LoadSettings::default() };
    let sequence = load(&recording, &settings, &NoProgress, &cancel, &warnings)?;
    let labels = GeometryMasks::default().segment(&sequence, &NoProgress, &cancel, &warnings)?;
    let preset = options.first().filter(|o| !o.starts_with('-')).map_or("fine", String::as_str);
    let mut config = ScanConfig { holdout: 8, ..ScanConfig::preset(preset.parse::<Preset>()?) };
    if options.iter().any(|o| o == "--paper") {
        // The paper's number of steps, none of them saved.
        (config.steps_first, config.steps_frame) = (1000, 100);
        config.stop.enabled = false;
    }
    let began = Instant::now();
    let mut trainer: Box<dyn Trainer> = match device.split_once(':') {
        _ if device == "cpu" => Box::new(CpuTrainer::new(&config.train, labels.class_count(), seed)),
        Some(("gpu", index)) => Box::new(checked_trainer(
            &config.train,
            labels.class_count(),
            seed,
            Choice::Index(index.parse()?),
        )?),
        _ => Box::new(checked_trainer(&config.train, labels.class_count(), seed, Choice::Best)?),
    };
    let opened_s = began.elapsed().as_secs_f64();
    let dir = std::env::temp_dir().join(format!("sms-scan-{}", std::process::id()));
    let began = Instant::now();
    let result =
        scan(&sequence, &labels, &config, seed, &dir, trainer.as_mut(), &NoProgress, &cancel, &warnings)?;
    let seconds = began.elapsed().as_secs_f64();
    println!("{device} {preset}: {seconds:.2} s, opening and self-check {opened_s:.2} s");
    for (key, value) in result.metrics.iter() {
        println!("  {key} {value}");
    }
    // Best effort: a temporary folder.
    let _ = std::fs::remove_dir_all(dir);
    Ok(())
}
