//! Labels a recording by geometry, says what was found, and writes overlays to look at.
//!
//! `cargo run --release -p sms-masks --example geometry_masks -- RECORDING [OUT_DIR]`; a generated recording is also
//! compared with its truth.

use sms_core::{Cancel, NoProgress, Warnings, write_png_color};
use sms_frames::{LoadSettings, ReadOptions, Recording, load};
use sms_masks::{GeometryMasks, Labels, Segmenter, TruthMasks, label_color};
use std::path::PathBuf;
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let source = args.next().ok_or("give the folder of a recording")?;
    let out = args.next().map(PathBuf::from);
    let recording = Recording::open(&source, &ReadOptions::default())?;
    let settings = LoadSettings { long_side: 320, ..LoadSettings::default() };
    let (progress, cancel, warnings) = (NoProgress, Cancel::new(), Warnings::new());
    let sequence = load(&recording, &settings, &progress, &cancel, &warnings)?;
    let began = Instant::now();
    let labels = GeometryMasks::default().segment(&sequence, &progress, &cancel, &warnings)?;
    println!("{} objects in {:.2} s", labels.objects.len(), began.elapsed().as_secs_f64());
    for object in &labels.objects {
        let pixels: Vec<usize> =
            labels.maps.iter().map(|m| m.data.iter().filter(|&&l| l == object.id).count()).collect();
        let shown = pixels.iter().filter(|&&n| n > 0).count();
        println!("  {}: {} pixels in {shown} frames", object.name, pixels.iter().sum::<usize>());
    }
    if sequence.source.join("truth/truth.json").is_file() {
        compare(&TruthMasks.segment(&sequence, &progress, &cancel, &warnings)?, &labels);
    }
    if let Some(out) = out {
        for (index, (frame, map)) in sequence.frames.iter().zip(&labels.maps).enumerate() {
            let mut picture = frame.color.clone();
            for (pixel, &label) in picture.data.iter_mut().zip(&map.data).filter(|(_, l)| **l != 0) {
                let color = label_color(label);
                *pixel = std::array::from_fn(|c| ((u16::from(pixel[c]) + u16::from(color[c])) / 2) as u8);
            }
            write_png_color(&out.join(format!("{index:06}.png")), &picture)?;
        }
    }
    Ok(())
}

/// Prints the best intersection over union of every true object.
fn compare(truth: &Labels, found: &Labels) {
    for object in &truth.objects {
        let classes = found.class_count();
        let (mut both, mut area, mut own) = (vec![0usize; classes], vec![0usize; classes], 0usize);
        for (t, f) in truth.maps.iter().zip(&found.maps) {
            for (&t, &f) in t.data.iter().zip(&f.data) {
                area[usize::from(f)] += 1;
                own += usize::from(t == object.id);
                both[usize::from(f)] += usize::from(t == object.id);
            }
        }
        let best = (1..classes)
            .map(|id| (both[id] as f64 / (own + area[id] - both[id]) as f64, id))
            .fold((0.0, 0), |best, next| if next.0 > best.0 { next } else { best });
        let (extra, lost) = (area[best.1] - both[best.1], own - both[best.1]);
        println!(
            "  {}: IoU {:.3} with {} (of {own} pixels {lost} lost, {extra} too many)",
            object.name, best.0, best.1
        );
    }
}
