//! How much memory this process has used.

/// Most memory the process ever held, megabytes (10^6 bytes); `None` where the system does not say.
///
/// Linux keeps it as `VmHWM` in `/proc/self/status`, in KiB (proc(5)).
pub fn peak_memory_mb() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kib: f64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib * 1024.0 * 1e-6)
}

#[cfg(test)]
mod tests {
    #[test]
    #[cfg(target_os = "linux")]
    fn a_process_has_used_some_memory() {
        let before = super::peak_memory_mb().unwrap();
        let block = vec![1_u8; 64 << 20];
        assert!(before > 1.0 && super::peak_memory_mb().unwrap() > before.min(block.len() as f64 * 1e-6));
    }
}
