//! `endoscape devices`: what this build can compute on.

use crate::device::DeviceName;
use serde::Serialize;
use std::io::Write as _;

/// List what this build can compute on.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  endoscape devices --json")]
pub struct Args {
    /// Print one JSON object instead of text.
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Device {
    name: String,
    available: bool,
    detail: String,
}

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let devices = devices();
    let mut out = std::io::stdout();
    if args.json {
        writeln!(out, "{}", serde_json::to_string_pretty(&serde_json::json!({ "devices": devices }))?)?;
        return Ok(());
    }
    for device in devices {
        let state = if device.available { "yes" } else { "no " };
        writeln!(out, "{state} {:<8}{}", device.name, device.detail)?;
    }
    Ok(())
}

fn devices() -> Vec<Device> {
    let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let detail = format!("{threads} threads, {}", instruction_sets().join(" "));
    let cpu = Device { name: "cpu".into(), available: true, detail };
    std::iter::once(cpu).chain(BACKENDS.iter().map(backend)).collect()
}

/// The GPU backends and whether this build has them.
const BACKENDS: &[(&str, bool)] = &[
    ("cuda", cfg!(feature = "cuda")),
    ("rocm", cfg!(feature = "rocm")),
    ("vulkan", cfg!(feature = "vulkan")),
    ("metal", cfg!(feature = "metal")),
];

fn backend((name, in_build): &(&str, bool)) -> Device {
    let available = *in_build && name.parse().is_ok_and(|device: DeviceName| device.open().is_ok());
    let detail = match (in_build, available) {
        (true, true) => format!("--device {name}"),
        (true, false) => "in this build, but no driver or device answers".to_owned(),
        (false, _) => format!("not in this build: add --features {name}"),
    };
    Device { name: (*name).into(), available, detail }
}

/// Vector instructions of the processor that runs this.
fn instruction_sets() -> Vec<&'static str> {
    #[cfg(target_arch = "x86_64")]
    let found = [
        ("avx512f", std::arch::is_x86_feature_detected!("avx512f")),
        ("avx2", std::arch::is_x86_feature_detected!("avx2")),
        ("fma", std::arch::is_x86_feature_detected!("fma")),
        ("sse4.2", std::arch::is_x86_feature_detected!("sse4.2")),
    ];
    #[cfg(target_arch = "aarch64")]
    let found = [("neon", std::arch::is_aarch64_feature_detected!("neon"))];
    #[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
    let found: [(&'static str, bool); 0] = [];
    found.into_iter().filter(|(_, present)| *present).map(|(name, _)| name).collect()
}
