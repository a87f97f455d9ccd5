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

    /// Rows to columns, in registers.
    #[inline(always)]
    pub(crate) fn transposed(self, rows: [&[f32; 8]; 8]) -> [[f32; 8]; 8] {
        match self.0 {
            #[cfg(target_arch = "x86_64")]
            Arch::V3(simd) => transposed_by_avx(simd, rows),
            #[cfg(target_arch = "x86_64")]
            Arch::V4(simd) => transposed_by_avx(*simd, rows),
            _ => {
                let mut columns = [[0.0; 8]; 8];
                for (index, value) in columns.as_flattened_mut().iter_mut().enumerate() {
                    *value = rows[index % 8][index / 8];
                }
                columns
            }
        }
    }

    /// Channels that are computed side by side: what fits the registers beside the pixels and a weight.
    pub(crate) fn panel_widths(self) -> &'static [usize] {
        match self.name() {
            "avx512" | "neon" => &[8, 4, 1],
            _ => &[4, 1],
        }
    }
}

/// Pairs of rows, then fours, then eights; compilers go through memory instead, in pieces that wait for each other.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn transposed_by_avx(simd: pulp::x86::V3, block: [&[f32; 8]; 8]) -> [[f32; 8]; 8] {
    let avx = simd.avx;
    let mut rows = [avx._mm256_setzero_ps(); 8];
    rows.iter_mut().zip(block).for_each(|(row, numbers)| *row = pulp::cast(*numbers));
    let (mut pairs, mut fours, mut columns) = (rows, rows, rows);
    for pair in 0..4 {
        let [upper, lower] = [rows[2 * pair], rows[2 * pair + 1]];
        pairs[2 * pair] = avx._mm256_unpacklo_ps(upper, lower);
        pairs[2 * pair + 1] = avx._mm256_unpackhi_ps(upper, lower);
    }
    for index in 0..4 {
        let first = index / 2 * 4 + index % 2;
        let [upper, lower] = [pairs[first], pairs[first + 2]];
        let place = index / 2 * 4 + index % 2 * 2;
        fours[place] = avx._mm256_shuffle_ps::<0x44>(upper, lower);
        fours[place + 1] = avx._mm256_shuffle_ps::<0xee>(upper, lower);
    }
    for column in 0..4 {
        let [upper, lower] = [fours[column], fours[column + 4]];
        columns[column] = avx._mm256_permute2f128_ps::<0x20>(upper, lower);
        columns[column + 4] = avx._mm256_permute2f128_ps::<0x31>(upper, lower);
    }
    pulp::cast(columns)
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
