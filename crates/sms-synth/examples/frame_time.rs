//! Times one full-size frame on the threads that there are.
use sms_core::{Camera, Seed};
use sms_synth::{BilliardsSettings, CameraModel, RecordingSettings, Renderer, generate_billiards};
use std::time::Instant;

fn main() {
    for seed in 1..=4 {
        let scene = generate_billiards(Seed(seed), &BilliardsSettings::default());
        let settings = RecordingSettings::default();
        let poses = settings.path.poses(&scene, 60);
        let began = Instant::now();
        let renderer = Renderer::new(&scene);
        let prepared = began.elapsed().as_secs_f64();
        let began = Instant::now();
        let shown = [0, 17, 30, 50];
        for i in shown {
            let frame =
                renderer.render(&Camera::new(settings.intrinsics(), poses[i]), &CameraModel::default());
            std::hint::black_box(frame);
        }
        let per_frame = began.elapsed().as_secs_f64() / shown.len() as f64;
        println!("seed {seed}: prepared in {prepared:.3} s, {per_frame:.3} s a frame");
    }
}
