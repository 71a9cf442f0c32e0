//! Times the full-size networks with random weights: `speed owlv2|encoder|track|reprompt [REPEATS] [OBJECTS]
//! [--device cpu|cuda|metal]`. Prints one JSON object with the time of every repeat and the peak of main memory;
//! `benches/peers/nets.py` compares it with PyTorch's. On a GPU the clock is read after synchronization, and the
//! first repeats load its kernels.

#[path = "../tests/it/random.rs"]
mod random;

use candle_core::{Device, Tensor};
use sms_nets::owlv2::{Owlv2, Owlv2Config, PixelBox};
use sms_nets::sam2::{Sam2, Sam2Config, Tracker};
use sms_nets::{NetsError, TensorObserver};
use std::time::Instant;

/// Returns the CPU seconds of all threads so far, if available (Linux); else 0.
fn cpu_seconds() -> f64 {
    let tasks = std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    let times = tasks.filter_map(|task| std::fs::read_to_string(task.path().join("schedstat")).ok());
    times.filter_map(|text| text.split_whitespace().next()?.parse::<f64>().ok()).sum::<f64>() * 1e-9
}

/// Returns the largest resident memory so far in bytes, if available (Linux); else 0.
fn peak_bytes() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    peak.and_then(|text| text.trim().trim_end_matches("kB").trim().parse::<u64>().ok()).unwrap_or(0) * 1024
}

fn main() -> Result<(), NetsError> {
    let mut args: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let on = args.iter().position(|a| a == "--device").map_or("cpu".to_owned(), |at| {
        let on = args.get(at + 1).cloned().unwrap_or_default();
        args.drain(at..args.len().min(at + 2));
        on
    });
    let device = match on.as_str() {
        "cpu" => Device::Cpu,
        "cuda" => Device::new_cuda(0)?,
        "metal" => Device::new_metal(0)?,
        _ => panic!("--device takes cpu, cuda or metal"),
    };
    let mut args = args.into_iter();
    let what = args.next().unwrap_or_else(|| "encoder".into());
    let repeats: usize = args.next().and_then(|a| a.parse().ok()).unwrap_or(3);
    let objects: usize = args.next().and_then(|a| a.parse().ok()).unwrap_or(6);
    let image = |side: usize, seed: usize| {
        let values = (0..3 * side * side).map(|i| ((i * (seed + 7) % 1013) as f32 / 506.0) - 1.0).collect();
        Tensor::from_vec(values, (1, 3, side, side), &device)
    };
    let weights = random::random_weights(1, &device);
    let (mut seconds, mut cpu_used) = (Vec::new(), Vec::new());
    match what.as_str() {
        "owlv2" => {
            let mut config = Owlv2Config::default();
            config.vision_config.image_size = 960;
            let model = Owlv2::new(&config, &weights)?;
            for i in 0..repeats {
                let pixels = image(960, i)?;
                device.synchronize()?;
                let (start, cpu) = (Instant::now(), cpu_seconds());
                model.image(&pixels, &mut TensorObserver::none())?;
                device.synchronize()?;
                seconds.push(start.elapsed().as_secs_f64());
                cpu_used.push(cpu_seconds() - cpu);
            }
        }
        _ => {
            let model = Sam2::new(&Sam2Config::default(), &weights)?;
            let at =
                |i: usize| PixelBox { x0: 20.0 * i as f64, y0: 30.0, x1: 20.0 * i as f64 + 60.0, y1: 90.0 };
            let boxes: Vec<PixelBox> = (0..objects).map(at).collect();
            let mut tracker = Tracker::new(&model, &boxes, (640, 400), repeats);
            for i in 0..repeats {
                let pixels = image(1024, i)?;
                device.synchronize()?;
                let (start, cpu) = (Instant::now(), cpu_seconds());
                let features = model.encode(&pixels, &mut TensorObserver::none())?;
                match what.as_str() {
                    "track" => drop(tracker.next(&features, &mut TensorObserver::none())?),
                    "reprompt" => {
                        for bbox in &boxes {
                            model.segment(&features, bbox, (640, 400))?;
                        }
                    }
                    _ => {}
                }
                device.synchronize()?;
                seconds.push(start.elapsed().as_secs_f64());
                cpu_used.push(cpu_seconds() - cpu);
            }
        }
    }
    let median = {
        let mut sorted = seconds.clone();
        sorted.sort_by(f64::total_cmp);
        sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
    };
    let best = |of: &[f64]| of.iter().copied().fold(f64::INFINITY, f64::min);
    println!(
        "{{\"what\": \"{what}\", \"device\": \"{on}\", \"seconds\": {seconds:.4?}, \"best_s\": {:.4}, \
         \"median_s\": {median:.4}, \"best_cpu_s\": {:.4}, \
         \"total_s\": {:.1}, \"total_cpu_s\": {:.1}, \"peak_bytes\": {}}}",
        best(&seconds),
        best(&cpu_used),
        seconds.iter().sum::<f64>(),
        cpu_used.iter().sum::<f64>(),
        peak_bytes()
    );
    Ok(())
}
