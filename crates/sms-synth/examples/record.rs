//! Records a generated billiards scene: `record SEED DIR [full|quick|small]`.

use sms_core::{Cancel, PlainProgress, Seed};
use sms_synth::{BilliardsSettings, RecordingSettings, generate_billiards, write_recording};
use std::path::PathBuf;
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let usage = "usage: record SEED DIR [full|quick|small]";
    let seed = Seed(args.next().ok_or(usage)?.parse()?);
    let dir = PathBuf::from(args.next().ok_or(usage)?);
    let settings = match args.next().as_deref() {
        Some("quick") => RecordingSettings::quick(),
        Some("small") => RecordingSettings::small(),
        _ => RecordingSettings::default(),
    };
    let began = Instant::now();
    let scene = generate_billiards(seed, &BilliardsSettings::default());
    for o in &scene.objects {
        let p = o.x_wb.translation;
        println!(
            "{:14} {:20} {:6.3} kg  at ({:.3}, {:.3}, {:.3})  {} triangles, {} parts",
            o.name,
            o.class,
            o.mass.mass(),
            p.x,
            p.y,
            p.z,
            o.mesh.triangles.len(),
            o.parts.len()
        );
    }
    println!("goal {:?}; scene made in {:.2} s", scene.goal_w, began.elapsed().as_secs_f64());
    let began = Instant::now();
    let summary = write_recording(&scene, &settings, &dir, &PlainProgress::default(), &Cancel::new())?;
    println!("{} frames rendered in {:.1} s", summary.rendered, began.elapsed().as_secs_f64());
    Ok(())
}
