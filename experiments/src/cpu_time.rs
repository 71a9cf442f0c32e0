//! CPU time of this process, from `/proc` (Linux); `None` on other systems.

/// Returns the CPU seconds of all living threads of this process. Other programs on the machine hardly disturb them,
/// unlike wall time.
pub(crate) fn cpu_seconds() -> Option<f64> {
    let mut nanoseconds = 0.0;
    for task in std::fs::read_dir("/proc/self/task").ok()? {
        let text = std::fs::read_to_string(task.ok()?.path().join("schedstat")).ok()?;
        nanoseconds += text.split_whitespace().next()?.parse::<f64>().ok()?;
    }
    Some(nanoseconds * 1e-9)
}

/// Returns the CPU seconds of the calling thread.
pub(crate) fn thread_cpu_seconds() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    Some(text.split_whitespace().next()?.parse::<f64>().ok()? * 1e-9)
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn work_uses_cpu_time_of_its_thread_and_its_process() {
        let before = (cpu_seconds().unwrap(), thread_cpu_seconds().unwrap());
        let mut bits = 1u64;
        while thread_cpu_seconds().unwrap() - before.1 < 0.02 {
            bits = std::hint::black_box(bits.wrapping_mul(6_364_136_223_846_793_005));
        }
        assert!(cpu_seconds().unwrap() - before.0 > 0.01);
    }
}
