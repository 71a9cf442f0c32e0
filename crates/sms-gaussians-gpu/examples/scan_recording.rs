//! Scans a recording on the CPU or a GPU and prints time and quality: `scan_recording RECORDING cpu|gpu[:N]
//! [draft|standard|fine] [--steps-frame N] [--paper]`.
//!
//! Masks come from geometry, every eighth frame is held out, and frames are loaded at 640 pixels, the paper's half
//! resolution, for all presets.

use sms_core::glamx::Vec3;
use sms_core::{Camera, Cancel, Seed, StageContext, Warnings};
use sms_frames::{LoadSettings, ReadOptions, Recording, load};
use sms_gaussians::parameters::Parameters;
use sms_gaussians::{
    CpuTrainer, FrameId, GaussianModel, LearningRates, Preset, RenderedMaps, ScanConfig, Seedling, StepBatch,
    StepStats, TrainFrame, TrainState, Trainer, TrainerError, scan,
};
use sms_gaussians_gpu::{AdapterChoice, checked_trainer};
use sms_masks::{GeometryMasks, Segmenter};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [recording, device, options @ ..] = &arguments[..] else {
        return Err("give RECORDING cpu|gpu[:N] [draft|standard|fine] [--steps-frame N] [--paper]".into());
    };
    let (cancel, warnings, seed) = (Cancel::new(), Warnings::new(), Seed(0));
    let recording = Recording::open(Path::new(recording), &ReadOptions::default())?;
    let settings = LoadSettings { long_side: 640, ..LoadSettings::default() };
    let sequence = load(&recording, &settings, StageContext::quiet(&cancel, &warnings))?;
    let labels = GeometryMasks::default().segment(&sequence, StageContext::quiet(&cancel, &warnings))?;
    let preset = options.first().filter(|o| !o.starts_with('-')).map_or("fine", String::as_str);
    let mut config = ScanConfig { holdout: 8, ..ScanConfig::preset(preset.parse::<Preset>()?) };
    if let Some(at) = options.iter().position(|o| o == "--steps-frame") {
        config.steps_frame = options.get(at + 1).ok_or("--steps-frame takes a number")?.parse()?;
    }
    if options.iter().any(|o| o == "--paper") {
        // The paper's number of steps, without early stopping.
        (config.steps_first, config.steps_frame) = (1000, 100);
        config.stop.enabled = false;
    }
    let began = Instant::now();
    let trainer: Box<dyn Trainer> = match device.split_once(':') {
        _ if device == "cpu" => Box::new(CpuTrainer::new(&config.train, labels.class_count(), seed)),
        Some(("gpu", index)) => Box::new(checked_trainer(
            &config.train,
            labels.class_count(),
            seed,
            AdapterChoice::Index(index.parse()?),
        )?),
        _ => Box::new(checked_trainer(&config.train, labels.class_count(), seed, AdapterChoice::Best)?),
    };
    let mut trainer = Timed { trainer, times: RefCell::default() };
    let opened_s = began.elapsed().as_secs_f64();
    let dir = std::env::temp_dir().join(format!("sms-scan-{}", std::process::id()));
    let began = Instant::now();
    let result = scan(
        &sequence,
        &labels,
        &config,
        &dir,
        &mut trainer,
        &mut (),
        StageContext::quiet(&cancel, &warnings).with_seed(seed),
    )?;
    let seconds = began.elapsed().as_secs_f64();
    println!("{device} {preset}: {seconds:.2} s, opening and self-check {opened_s:.2} s");
    for (stage, seconds) in result.stages.iter() {
        println!("  stage {stage:12} {seconds:7.3} s");
    }
    for (call, (seconds, count)) in trainer.times.borrow().iter() {
        println!("  {call:12} {seconds:7.3} s in {count} calls");
    }
    for (key, value) in result.metrics.iter() {
        println!("  {key} {value}");
    }
    if device != "cpu" {
        // The wall has no splats close to the camera; a scan has some.
        let mut batches: Vec<f64> = (0..7)
            .map(|_| {
                let began = Instant::now();
                trainer.trainer.steps(&[0; 50]);
                began.elapsed().as_secs_f64() * 1e3 / 50.0
            })
            .collect();
        batches.sort_by(f64::total_cmp);
        println!("  {:.3} ms a step on the finished Gaussians and the first frame", batches[3]);
    }
    // Best effort: a temporary folder.
    let _ = std::fs::remove_dir_all(dir);
    Ok(())
}

/// A trainer that times each kind of call, to separate the scan's own time from its steps.
struct Timed {
    trainer: Box<dyn Trainer>,
    times: RefCell<BTreeMap<&'static str, (f64, usize)>>,
}

impl Timed {
    fn note(&self, call: &'static str, began: Instant) {
        let mut times = self.times.borrow_mut();
        let entry = times.entry(call).or_default();
        entry.0 += began.elapsed().as_secs_f64();
        entry.1 += 1;
    }
}

impl Trainer for Timed {
    fn len(&self) -> usize {
        self.trainer.len()
    }

    fn failure(&self) -> Option<String> {
        self.trainer.failure()
    }

    fn add_frame(&mut self, frame: TrainFrame) -> FrameId {
        let began = Instant::now();
        let out = self.trainer.add_frame(frame);
        self.note("add_frame", began);
        out
    }

    fn insert(&mut self, seedlings: &[Seedling]) {
        let began = Instant::now();
        self.trainer.insert(seedlings);
        self.note("insert", began);
    }

    fn retain(&mut self, mask: &[bool]) {
        let began = Instant::now();
        self.trainer.retain(mask);
        self.note("retain", began);
    }

    fn steps(&mut self, frames: &[FrameId]) -> StepStats {
        let began = Instant::now();
        let out = self.trainer.steps(frames);
        self.note("steps", began);
        out
    }

    fn batches(
        &mut self,
        batches: &[StepBatch],
        next: &dyn Fn() -> Option<TrainFrame>,
    ) -> (Vec<StepStats>, Option<FrameId>) {
        let began = Instant::now();
        let out = self.trainer.batches(batches, next);
        self.note("batches", began);
        out
    }

    fn edit(&mut self, change: &mut dyn FnMut(&mut Parameters)) -> Result<(), TrainerError> {
        let began = Instant::now();
        let out = self.trainer.edit(change);
        self.note("edit", began);
        out
    }

    fn places(&self) -> (Vec<Vec3>, Vec<f32>) {
        let began = Instant::now();
        let out = self.trainer.places();
        self.note("places", began);
        out
    }

    fn set_background(&mut self, rgb: [f32; 3]) {
        let began = Instant::now();
        self.trainer.set_background(rgb);
        self.note("set_background", began);
    }

    fn set_rates(&mut self, rates: &LearningRates) {
        let began = Instant::now();
        self.trainer.set_rates(rates);
        self.note("set_rates", began);
    }

    fn render(&mut self, camera: &Camera) -> RenderedMaps {
        let began = Instant::now();
        let out = self.trainer.render(camera);
        self.note("render", began);
        out
    }

    fn restore(&mut self, state: &TrainState) -> Result<(), TrainerError> {
        let began = Instant::now();
        let out = self.trainer.restore(state);
        self.note("restore", began);
        out
    }

    fn opacities(&self) -> Vec<f32> {
        let began = Instant::now();
        let out = self.trainer.opacities();
        self.note("opacities", began);
        out
    }

    fn positions_w(&self) -> Vec<Vec3> {
        let began = Instant::now();
        let out = self.trainer.positions_w();
        self.note("positions_w", began);
        out
    }

    fn model(&self) -> GaussianModel {
        let began = Instant::now();
        let out = self.trainer.model();
        self.note("model", began);
        out
    }

    fn snapshot(&self) -> TrainState {
        let began = Instant::now();
        let out = self.trainer.snapshot();
        self.note("snapshot", began);
        out
    }
}
