//! Evaluates pose refinement on recordings with known poses: `study [key=value …] RECORDING …`.
//!
//! Keys: `mm` and `deg` (standard deviation of the disturbance per axis, default 10 and 0.5), `seed`, `side` (longer
//! image side), `shift` (colour against depth, pixels), `drop` (share of depth removed), any number of [`PosesConfig`]
//! by name. A recording `…-N` that does not exist is generated (billiards, seed N). Prints, for each recording, errors
//! of points at 0.8 m and of poses before and after, and the judgement.

#[path = "../tests/it/compare.rs"]
mod compare;

use compare::compare_poses;
use glamx::{DPose3, DQuat, DVec3};
use rand::RngExt;
use sms_core::{Cancel, NoProgress, Seed, StageContext, Warnings};
use sms_frames::{LoadSettings, ReadOptions, Recording, Sequence, load, normals_from_depth};
use sms_poses::{PosesConfig, PosesMode, refine_poses};
use sms_synth::{BilliardsSettings, RecordingSettings, generate_billiards, write_recording};
use std::path::Path;
use std::time::Instant;

fn disturb(sequence: &mut Sequence, position_m: f64, rotation_rad: f64, seed: Seed) {
    for frame in &mut sequence.frames {
        let mut rng = seed.derive_index("pose", frame.index as u64).rng();
        let mut normal = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
        let shift = DVec3::new(normal(), normal(), normal()) * position_m;
        let turn = DVec3::new(normal(), normal(), normal()) * rotation_rad;
        let x = frame.camera.x_wc;
        frame.camera.x_wc =
            DPose3::from_parts(x.translation + shift, x.rotation * DQuat::from_scaled_axis(turn));
    }
}

/// A path that ends in `-N` and does not exist is recorded first: billiards, seed N, 60 frames of 1280 × 800.
fn record_if_missing(path: &Path) -> Result<(), Box<dyn std::error::Error>> {
    let name = path.display().to_string();
    if !path.join("transforms.json").exists()
        && let Some(seed) = name.rsplit_once('-').and_then(|(_, n)| n.parse().ok())
    {
        let scene = generate_billiards(Seed(seed), &BilliardsSettings::default());
        let settings = RecordingSettings { seed: Seed(seed), ..RecordingSettings::default() };
        write_recording(&scene, &settings, path, &NoProgress, &Cancel::new())?;
    }
    Ok(())
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (mut mm, mut deg, mut seed, mut shift, mut drop) = (10.0f64, 0.5f64, 1u64, 0usize, 0.0f64);
    let mut settings = LoadSettings::default();
    let mut config = serde_json::to_value(PosesConfig { mode: PosesMode::Auto, ..PosesConfig::default() })?;
    let mut recordings = Vec::new();
    for argument in std::env::args().skip(1).filter(|a| a != "--bench") {
        match argument.split_once('=') {
            Some(("mm", v)) => mm = v.parse()?,
            Some(("deg", v)) => deg = v.parse()?,
            Some(("seed", v)) => seed = v.parse()?,
            Some(("side", v)) => settings.long_side = v.parse()?,
            Some(("shift", v)) => shift = v.parse()?,
            Some(("drop", v)) => drop = v.parse()?,
            Some((key, v)) => config[key] = serde_json::from_str(v)?,
            None => recordings.push(argument),
        }
    }
    let config: PosesConfig = serde_json::from_value(config)?;
    for path in recordings {
        record_if_missing(Path::new(&path))?;
        let recording = Recording::open(Path::new(&path), &ReadOptions::default())?;
        let mut sequence =
            load(&recording, &settings, StageContext::quiet(&Cancel::new(), &Warnings::new()))?;
        for frame in &mut sequence.frames {
            if shift > 0 {
                let old = frame.color.clone();
                let w = old.width;
                for (at, pixel) in frame.color.data.iter_mut().enumerate() {
                    *pixel = old.data[at - at % w + (at % w + shift).min(w - 1)];
                }
            }
            if drop > 0.0 {
                let mut rng = Seed(9).derive_index("drop", frame.index as u64).rng();
                frame.depth.data.iter_mut().for_each(|z| {
                    if rng.random::<f64>() < drop {
                        *z = 0.0;
                    }
                });
                frame.normal_c =
                    normals_from_depth(&frame.depth, &frame.camera.intrinsics, &settings.noise, 2);
            }
        }
        let truth: Vec<DPose3> = sequence.frames.iter().map(|f| f.camera.x_wc).collect();
        disturb(&mut sequence, 1e-3 * mm, deg.to_radians(), Seed(seed));
        let poses = |s: &Sequence| s.frames.iter().map(|f| f.camera.x_wc).collect::<Vec<_>>();
        let began = Instant::now();
        let refined = refine_poses(
            &sequence,
            &PosesConfig { mode: PosesMode::Refine, ..config.clone() },
            StageContext::quiet(&Cancel::new(), &Warnings::new()),
        )?;
        let seconds = began.elapsed().as_secs_f64();
        let show = |s: &Sequence| {
            let e = compare_poses(&poses(s), &truth, 0.8);
            format!(
                "{:.3} mm at 0.8 m, {:.3} mm, {:.4}°",
                1e3 * e.point_rms_m,
                1e3 * e.position_rms_m,
                e.rotation_rms_rad.to_degrees()
            )
        };
        let j = refined.report.judgement;
        println!(
            "{path}: {seconds:.1} s, {} iterations, {} pairs, colour shift {:.2?}, focal length {:.4?}",
            refined.report.iterations,
            refined.report.pairs,
            refined.report.color_shift_px,
            refined.report.focal.map(|f| [f.share, f.sigma])
        );
        println!("  before {}\n  after  {}", show(&sequence), show(&refined.sequence));
        println!(
            "  {} | auto: {} (depth {:+.1} % t {:.1}, colour {:+.1} % t {:.1}, {} pairs)",
            refined.report.summary(),
            j.improved(),
            -100.0 * j.depth.share,
            j.depth.t,
            -100.0 * j.color.share,
            j.color.t,
            j.pairs
        );
    }
    Ok(())
}
