//! Milliseconds of one full training step on the CPU, split by part, in every compiled form that this CPU can run.
//!
//! `cargo bench -p sms-gaussians --bench step [-- THREADS] [portable|avx2|avx512|detected]… [share=SHARE]`. The scene
//! is a wall of discs about as dense as a scan leaves them.

mod scene;

use scene::trainer;
use sms_gaussians::{CpuTrainer, SimdForm, StepTimes, TrainConfig, Trainer};

/// Returns the CPU seconds of all threads of this process so far, if available (Linux); less disturbed by other
/// load than wall-clock time.
fn cpu_seconds() -> Option<f64> {
    let mut nanoseconds = 0.0;
    for task in std::fs::read_dir("/proc/self/task").ok()? {
        let text = std::fs::read_to_string(task.ok()?.path().join("schedstat")).ok()?;
        nanoseconds += text.split_whitespace().next()?.parse::<f64>().ok()?;
    }
    Some(nanoseconds * 1e-9)
}

/// Number of steps per measurement of CPU time.
const GROUP: usize = 10;

/// Returns the shortest step by the clock, the shortest time of each part, and the CPU seconds per step in the best
/// group.
fn measure(mut trainer: CpuTrainer, steps: usize) -> (f64, StepTimes, f64) {
    // Returns the best of several short runs, because other load only adds time.
    let mut best = (f64::INFINITY, StepTimes::from_parts([f64::INFINITY; StepTimes::PARTS]));
    let (mut least, mut cpu) = (f64::INFINITY, cpu_seconds());
    for step in 0..steps {
        let before = trainer.times();
        let start = std::time::Instant::now();
        trainer.steps(&[0]);
        let seconds = start.elapsed().as_secs_f64();
        let times = trainer.times().combined(&before, |after, before| after - before);
        best = (best.0.min(seconds), best.1.combined(&times, f64::min));
        // The system counts CPU time in ticks of some milliseconds: whole groups of steps are measured.
        if step % GROUP == GROUP - 1 {
            let now = cpu_seconds();
            least = least.min(cpu.zip(now).map_or(f64::NAN, |(from, to)| (to - from) / GROUP as f64));
            cpu = now;
        }
    }
    (best.0, best.1, least)
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let threads = arguments.iter().find_map(|a| a.parse().ok()).unwrap_or(1);
    let named = |form: &SimdForm| arguments.contains(&format!("{form:?}").to_lowercase());
    let mut forms = SimdForm::available().to_vec();
    if arguments.iter().any(|a| a == "detected") {
        forms.drain(..forms.len() - 1);
    } else if forms.iter().any(named) {
        forms.retain(named);
    }
    let share = arguments.iter().find_map(|a| a.strip_prefix("share=")?.parse().ok());
    let config = TrainConfig { segmentation_share: share.unwrap_or(1.0), ..TrainConfig::default() };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool");
    println!(
        "milliseconds of one step, shortest of several, {threads} thread(s); parts are summed over threads"
    );
    let names = StepTimes::NAMES.map(|name| format!("{:>7}", &name[..name.len().min(7)])).join(" ");
    println!("{:>9} {:>6} {:>9} {:>8} {:>8} {:>8}  {names}", "size", "count", "form", "wall", "cpu", "parts");
    for size in [(320, 200), (640, 400)] {
        for count in [10_000, 20_000] {
            for &form in &forms {
                let steps = if form == SimdForm::Portable { 10 } else { 100 };
                let Some(trainer) = pool.install(|| trainer(&config, form, size, count)) else {
                    continue;
                };
                let (seconds, times, cpu) = pool.install(|| measure(trainer, steps));
                let parts = times.parts().map(|s| format!("{:7.2}", s * 1e3)).join(" ");
                let size = format!("{}x{}", size.0, size.1);
                println!(
                    "{size:>9} {count:>6} {:>9} {:>8.2} {:>8.2} {:>8.2}  {parts}",
                    format!("{form:?}").to_lowercase(),
                    seconds * 1e3,
                    cpu * 1e3,
                    times.total() * 1e3,
                );
            }
        }
    }
}
