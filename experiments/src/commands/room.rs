//! `sms-experiments room`: time, memory and quality of a scan of a furnished room.

use super::shared::finish;
use clap::Args;
use sms_cli::front::Console;
use sms_core::metrics::Metrics;
use sms_core::{InputError, Seed, process};
use sms_experiments::Room;
use sms_gaussians::Preset;
use sms_pipeline::{MaterializeRequest, Run, ScanRequest};
use sms_synth::{ColorCamera, RecordingSettings, SceneViews, Sensor, record_views};
use std::fmt::Write as _;
use std::path::PathBuf;
use std::time::Instant;

/// Frames that the recorded camera takes in a second.
const FRAME_RATE_HZ: f64 = 30.0;

#[derive(Debug, Args, Clone)]
pub(crate) struct RoomArguments {
    /// Folder for the recording (made once) and the run, which must not exist.
    pub folder: PathBuf,
    /// Number of frames; the path is the same.
    #[arg(long, default_value_t = 1000)]
    pub frames: usize,
    /// Number of objects.
    #[arg(long, default_value_t = 100)]
    pub objects: usize,
    /// Preset of the scan.
    #[arg(long, default_value = "draft")]
    pub preset: Preset,
    /// Seed of the room and of the noise.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// File for the figures (JSON).
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

pub(crate) fn run(console: &Console, a: &RoomArguments) -> anyhow::Result<()> {
    let context = &console.context;
    let run_dir = a.folder.join("run");
    if run_dir.exists() {
        let cure = "delete it: a stage that is up to date takes no time";
        return Err(InputError::new("there is a run already", &run_dir, cure).into());
    }
    let room = Room::furnish(a.objects, Seed(a.seed));
    let mut settings =
        RecordingSettings { frame_rate_hz: FRAME_RATE_HZ, seed: Seed(a.seed), ..Sensor::Xtion.recording() };
    // Sharp images of one moment: tracing blurred ones of a thousand frames takes hours.
    let gain_walk = settings.sensor.color.gain_walk;
    settings.sensor.color = ColorCamera { gain_walk, ..ColorCamera::default() };
    let recording = a.folder.join("recording");
    let views = SceneViews { scene: &room.scene, skins: &[], poses: &Room::path(a.frames), source: "" };
    record_views(&views, &settings, &recording, context.progress.as_ref(), &context.cancel)?;
    let run = Run::new(&run_dir, context);
    let mut metrics = Metrics::new();
    let mut timed = |name: &str, work: &mut dyn FnMut() -> Result<usize, sms_pipeline::Error>| {
        let began = Instant::now();
        let count = work()?;
        metrics.set(format!("bench.room.{name}.seconds"), began.elapsed().as_secs_f64());
        metrics.set(format!("bench.room.{name}.objects"), count);
        metrics.set(format!("bench.room.{name}.peak_bytes"), process::peak_bytes().unwrap_or(0));
        Ok::<(), anyhow::Error>(())
    };
    let request = ScanRequest { preset: a.preset, holdout: Some(8), ..ScanRequest::default() };
    timed("scan", &mut || Ok(run.scan(&recording, &request)?.objects))?;
    timed("materialize", &mut || {
        Ok(run.materialize(&MaterializeRequest::default())?.entities.entities.len())
    })?;
    metrics.set("bench.room.objects", room.objects).set("bench.room.frames", a.frames);
    metrics.merge(run.metrics()?);
    finish(console, &metrics, a.out.as_ref(), &table(&metrics))
}

fn table(metrics: &Metrics) -> String {
    let number = |key: &str| metrics.number(key).unwrap_or(f64::NAN);
    let mut text = format!(
        "room with {:.0} objects, {:.0} frames\nstage            s   peak GiB   objects\n",
        number("bench.room.objects"),
        number("bench.room.frames")
    );
    for stage in ["scan", "materialize"] {
        let of = |name: &str| number(&format!("bench.room.{stage}.{name}"));
        let gib = of("peak_bytes") / f64::from(1 << 30);
        let _ = writeln!(text, "{stage:<11} {:>6.1} {gib:>10.2} {:>9.0}", of("seconds"), of("objects"));
    }
    let _ = write!(
        text,
        "held out: {:.1} dB, depth {:.1} mm; {:.0} Gaussians",
        number("scan.holdout_psnr_db"),
        1e3 * number("scan.holdout_depth_mae_m"),
        number("scan.gaussians")
    );
    text
}
