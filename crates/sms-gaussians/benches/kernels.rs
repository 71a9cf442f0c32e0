//! Times each kernel of the training step on one thread, in every compiled form that this CPU can run.
//!
//! `cargo bench -p sms-gaussians --bench kernels [-- FILTER]`; a filter is part of a name such as `blend/avx2`. The
//! ratios to the portable form, measured in the same run, follow Criterion's output.

mod scene;

use criterion::Criterion;
use scene::trainer;
use sms_gaussians::{SimdForm, StepTimes, TrainConfig, Trainer};
use std::collections::BTreeMap;
use std::time::Duration;

const SIZE: (usize, usize) = (320, 200);
const COUNT: usize = 20_000;

fn main() {
    let mut criterion = Criterion::default()
        .sample_size(10)
        .warm_up_time(Duration::from_millis(200))
        .measurement_time(Duration::from_secs(1))
        .without_plots()
        .configure_from_args();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread pool");
    // Shortest time of each kernel in each form.
    let mut shortest = BTreeMap::new();
    for &form in SimdForm::available() {
        let name = format!("{form:?}").to_lowercase();
        let Some(mut trainer) = pool.install(|| trainer(&TrainConfig::default(), form, SIZE, COUNT)) else {
            continue;
        };
        for (part, kernel) in StepTimes::NAMES.into_iter().enumerate() {
            criterion.bench_function(&format!("{kernel}/{name}"), |bencher| {
                bencher.iter_custom(|steps| {
                    let mut sum = 0.0;
                    for _ in 0..steps {
                        let before = trainer.times();
                        pool.install(|| trainer.steps(&[0]));
                        let seconds = trainer.times().parts()[part] - before.parts()[part];
                        let least = shortest.entry((part, form)).or_insert(f64::INFINITY);
                        *least = seconds.min(*least);
                        sum += seconds;
                    }
                    Duration::from_secs_f64(sum)
                });
            });
        }
    }
    criterion.final_summary();
    println!("shortest time in ms, and how many times faster than the portable form");
    for (&(part, form), &seconds) in &shortest {
        let ratio = shortest.get(&(part, SimdForm::Portable)).map_or(f64::NAN, |portable| portable / seconds);
        println!(
            "{:>12} {:>9} {:8.3} {ratio:6.1}",
            StepTimes::NAMES[part],
            format!("{form:?}"),
            1e3 * seconds
        );
    }
}
