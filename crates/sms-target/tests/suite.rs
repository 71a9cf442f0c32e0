//! The target engines through the closed-form suite. Run with `--nocapture` for the figures.

use sms_sim::suite::probes;
use sms_target::engine_factories;

#[test]
fn figures_of_every_engine() {
    for (key, factory) in engine_factories() {
        let Ok(factory) = factory else { continue };
        if std::env::var("ENGINE").is_ok_and(|e| !key.contains(&e)) {
            continue;
        }
        for probe in probes() {
            if std::env::var("PROBE").is_ok_and(|e| !probe.name.contains(&e)) {
                continue;
            }
            let t = std::time::Instant::now();
            match probe.measure(&*factory) {
                Ok(m) => println!(
                    "{key:>14} {:>22} limit {:>8} figure {:.6} worst {:.6} rms {:.6} {:.2}s {}",
                    probe.name,
                    probe.limit,
                    probe.figure(&m),
                    m.worst,
                    m.rms,
                    t.elapsed().as_secs_f64(),
                    if probe.figure(&m) > probe.limit { "MISS" } else { "" }
                ),
                Err(e) => println!("{key:>14} {:>22} {e}", probe.name),
            }
        }
    }
}
