//! Renders single pictures of the fixed scenes: `stills DIR NUMBER [FRAME ...]`, numbers 1 to 18, frames of a scan of 60.

use sms_core::{Camera, write_png_color};
use sms_synth::{CameraModel, CameraPath, FIXED_SCENES, RecordingSettings, Renderer};
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let usage = "usage: stills DIR NUMBER [FRAME ...]";
    let dir = PathBuf::from(args.next().ok_or(usage)?);
    let number: usize = args.next().ok_or(usage)?.parse()?;
    let scene = FIXED_SCENES.iter().find(|s| s.number == number).ok_or(usage)?.generate();
    let renderer = Renderer::new(&scene);
    let poses = CameraPath::default().poses(&scene, 60);
    for frame in args {
        let pose = *poses.get(frame.parse::<usize>()?).ok_or(usage)?;
        let camera = Camera::new(RecordingSettings::default().intrinsics(), pose);
        let image = renderer.render(&camera, &CameraModel::default());
        let path = dir.join(format!("scene_{number:02}_{frame}.png"));
        write_png_color(&path, &image.color)?;
        println!("{}", path.display());
    }
    Ok(())
}
