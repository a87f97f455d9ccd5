//! From the name of a device to the device: the one place that knows which backends this build has.

use anyhow::{Context as _, bail};
use burn::tensor::{Device, Tensor};
use std::fmt;
use std::panic;
use std::str::FromStr;

/// `--device`, shared by all commands that compute with the networks.
#[derive(clap::Args, Clone, Copy, Debug)]
pub struct DeviceArgs {
    /// Where to compute: cpu, cuda, rocm, vulkan or metal; cuda:1 and rocm:1 are the second GPU.
    #[arg(long, value_name = "D", default_value = "cpu")]
    pub device: DeviceName,
}

/// A device by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeviceName {
    /// The processor.
    Cpu,
    /// An NVIDIA GPU by number.
    Cuda(usize),
    /// An AMD GPU by number.
    Rocm(usize),
    /// Any GPU with a Vulkan driver.
    Vulkan,
    /// An Apple GPU.
    Metal,
}

impl DeviceName {
    /// The device, or why there is none: not in this build, or not in this computer.
    pub fn open(self) -> anyhow::Result<Device> {
        if self == Self::Cpu {
            return Ok(Device::flex());
        }
        // GPU backends panic where a driver or the device itself is missing, so a sum is tried before any work begins.
        let hook = panic::take_hook();
        panic::set_hook(Box::new(|_| {}));
        let answer = panic::catch_unwind(|| -> anyhow::Result<Option<Device>> {
            let device = self.of_this_build()?;
            let sum = Tensor::<1>::ones([2], &device).sum().into_data();
            Ok(sum.iter::<f32>().eq([2.0]).then_some(device))
        });
        panic::set_hook(hook);
        answer.unwrap_or(Ok(None))?.with_context(|| {
            format!("{self} does not answer on this computer; check its driver and number, or use --device cpu")
        })
    }

    fn of_this_build(self) -> anyhow::Result<Device> {
        Ok(match self {
            Self::Cpu => Device::flex(),
            #[cfg(feature = "cuda")]
            Self::Cuda(number) => Device::cuda(number),
            #[cfg(feature = "rocm")]
            Self::Rocm(number) => Device::rocm(number),
            #[cfg(feature = "vulkan")]
            Self::Vulkan => {
                let options = Device::wgpu_options().graphics_api(burn::tensor::wgpu::WgpuBackend::Vulkan);
                options.init().map_err(|error| {
                    let remedy = "check its driver, or use --device cpu";
                    anyhow::anyhow!("{self} does not answer on this computer ({error}); {remedy}")
                })?
            }
            #[cfg(feature = "metal")]
            Self::Metal => Device::metal(burn::tensor::DeviceKind::DefaultDevice),
            #[allow(unreachable_patterns, reason = "a build may have every backend")]
            other => bail!(
                "this build of endoscape cannot compute on {other}; install it with `cargo install --features {}` or use \
                 --device cpu",
                other.feature()
            ),
        })
    }

    const fn feature(self) -> &'static str {
        match self {
            Self::Cpu => "default",
            Self::Cuda(_) => "cuda",
            Self::Rocm(_) => "rocm",
            Self::Vulkan => "vulkan",
            Self::Metal => "metal",
        }
    }
}

impl fmt::Display for DeviceName {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cpu => formatter.write_str("cpu"),
            Self::Cuda(number) | Self::Rocm(number) => write!(formatter, "{}:{number}", self.feature()),
            Self::Vulkan | Self::Metal => formatter.write_str(self.feature()),
        }
    }
}

impl FromStr for DeviceName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, number) = text.split_once(':').map_or((text, Ok(0)), |(name, number)| (name, number.parse()));
        let numbered = text.contains(':');
        match (name, number) {
            ("cpu", _) if !numbered => Ok(Self::Cpu),
            ("vulkan", _) if !numbered => Ok(Self::Vulkan),
            ("metal", _) if !numbered => Ok(Self::Metal),
            ("cuda", Ok(number)) => Ok(Self::Cuda(number)),
            ("rocm", Ok(number)) => Ok(Self::Rocm(number)),
            _ => Err(format!("`{text}` is no device; use cpu, cuda, cuda:1, rocm, vulkan or metal")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_and_written_alike() {
        for device in [DeviceName::Cpu, DeviceName::Cuda(1), DeviceName::Rocm(0), DeviceName::Vulkan, DeviceName::Metal]
        {
            assert_eq!(device.to_string().parse(), Ok(device));
        }
        assert_eq!("cuda".parse(), Ok(DeviceName::Cuda(0)));
        for wrong in ["gpu", "cpu:1", "cuda:", "cuda:x", ""] {
            assert!(wrong.parse::<DeviceName>().unwrap_err().contains("no device"));
        }
    }
}
