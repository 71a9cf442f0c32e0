//! Memory of this process and of the machine, from `/proc` (Linux); `None` on other systems.

/// Returns the peak resident memory of this process in bytes.
pub fn peak_bytes() -> Option<u64> {
    entry_bytes("/proc/self/status", "VmHWM:")
}

/// Returns the resident memory of this process in bytes.
pub fn resident_bytes() -> Option<u64> {
    entry_bytes("/proc/self/status", "VmRSS:")
}

/// Returns the memory that programs can take without swapping, in bytes.
pub fn available_bytes() -> Option<u64> {
    entry_bytes("/proc/meminfo", "MemAvailable:")
}

/// Returns the value of a line `KEY: N kB`.
fn entry_bytes(file: &str, key: &str) -> Option<u64> {
    let text = std::fs::read_to_string(file).ok()?;
    let line = text.lines().find(|l| l.starts_with(key))?;
    line.split_whitespace().nth(1)?.parse::<u64>().ok().map(|kib| kib * 1024)
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn a_process_has_a_peak() {
        let resident = resident_bytes().unwrap();
        assert!(resident > 100_000 && peak_bytes().unwrap() >= resident);
    }

    #[test]
    fn a_machine_has_memory_left() {
        assert!(available_bytes().unwrap() > 100_000);
    }
}
