//! Which vector instructions are used.

use pulp::{Arch, Simd, WithSimd};

/// A set of vector instructions the machine has.
///
/// Results of different levels differ by rounding alone; the same level gives the same bits every time.
#[derive(Clone, Copy, Debug)]
pub struct Level(Arch);

impl Default for Level {
    /// The widest the machine has.
    fn default() -> Self {
        Self(Arch::new())
    }
}

impl Level {
    /// All levels of this machine, narrowest first; the first is plain scalar code.
    pub fn all() -> Vec<Self> {
        let mut levels = vec![Self(Arch::Scalar)];
        #[cfg(target_arch = "x86_64")]
        {
            levels.extend(pulp::x86::V3::try_new().map(|simd| Self(Arch::V3(simd))));
            levels.extend(pulp::x86::V4::try_new().map(|simd| Self(Arch::V4(simd))));
        }
        #[cfg(target_arch = "aarch64")]
        levels.extend(pulp::aarch64::Neon::try_new().map(|simd| Self(Arch::Neon(simd))));
        levels
    }

    /// Its name: `scalar`, `avx2`, `avx512`, `neon`.
    pub fn name(self) -> &'static str {
        match self.0 {
            Arch::Scalar => "scalar",
            #[cfg(target_arch = "x86_64")]
            Arch::V3(_) => "avx2",
            #[cfg(target_arch = "x86_64")]
            Arch::V4(_) => "avx512",
            #[cfg(target_arch = "aarch64")]
            Arch::Neon(_) => "neon",
            _ => "other",
        }
    }

    /// Numbers of a vector.
    pub(crate) fn lanes(self) -> usize {
        self.run(Lanes)
    }

    #[inline]
    pub(crate) fn run<Op: WithSimd>(self, op: Op) -> Op::Output {
        self.0.dispatch(op)
    }

    /// Channels that are computed side by side: what fits the registers beside the pixels and a weight.
    pub(crate) fn panel_widths(self) -> &'static [usize] {
        match self.name() {
            "avx512" | "neon" => &[8, 4, 1],
            _ => &[4, 1],
        }
    }
}

/// Counts the numbers of a vector.
struct Lanes;

impl WithSimd for Lanes {
    type Output = usize;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> usize {
        S::F32_LANES
    }
}
