//! Exports the true geometry of generated billiards scenes, and one scene with every shape and a texture, in every
//! format, to check exports without scanning.
//!
//! `cargo run --release -p sms-export --example generated_scenes -- DIR [first seed] [number]`

use sms_core::Seed;
use sms_export::{Format, Sources, export};
use sms_synth::{BilliardsSettings, generate_billiards};
use sms_target::scene_from_truth;
use std::path::PathBuf;

#[path = "../src/example.rs"]
mod example;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let dir = PathBuf::from(arguments.first().ok_or("usage: generated_scenes DIR [first seed] [number]")?);
    let number = |i: usize, default: u64| arguments.get(i).map_or(Ok(default), |a| a.parse());
    let (first, count) = (number(1, 1)?, number(2, 20)?);
    for format in Format::ALL {
        let folder = dir.join("shapes").join(format.name());
        export(&example::scene(), format, &Sources::default(), &folder)?;
    }
    for seed in first..first + count {
        let truth = generate_billiards(Seed(seed), &BilliardsSettings::default());
        let scene = scene_from_truth(&truth)?;
        for format in Format::ALL {
            export(&scene, format, &Sources::default(), &dir.join(format!("{seed:02}")).join(format.name()))?;
        }
        println!("{seed}: {} bodies", scene.bodies.len());
    }
    Ok(())
}
