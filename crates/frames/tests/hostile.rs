//! Damaged input to every parser: none may panic or hang, whatever the bytes.
//!
//! The deterministic little sister of the fuzz targets, over the same table of parsers and valid inputs.

#[allow(clippy::expect_used, reason = "a seed that cannot be made is a broken test")]
#[path = "../../../fuzz/src/parsers.rs"]
mod parsers;

use parsers::{PARSERS, Parser};
use std::time::{Duration, Instant};

/// Damaged inputs per parser.
const CASES: usize = 300;

/// Marsaglia's xorshift64: the same numbers on every machine.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    /// A number below `end`, which must not be 0.
    fn below(&mut self, end: usize) -> usize {
        (self.next() % end as u64) as usize
    }
}

/// One to four kinds of damage on top of each other.
fn damaged(seed: &[u8], other: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = seed.to_vec();
    for _ in 0..=random.below(4) {
        if bytes.is_empty() {
            break;
        }
        let at = random.below(bytes.len());
        match random.below(6) {
            0 => bytes[at] ^= 1 << random.below(8),
            1 => bytes[at] = [0x00, 0xff, b'-', b'9', b'[', b'\n'][random.below(6)],
            2 => bytes.truncate(at),
            3 => drop(bytes.splice(at..at, other.iter().skip(random.below(other.len())).take(32).copied())),
            4 => bytes.extend_from_within(at..),
            // Counts and sizes are stored as integers of this width.
            _ => bytes.iter_mut().skip(at).take(8).for_each(|byte| *byte = 0xff),
        }
    }
    bytes
}

fn assault(parser: &Parser, random: &mut Random) {
    let seed = (parser.seed)();
    let other = (PARSERS[random.below(PARSERS.len())].seed)();
    (parser.parse)(&seed);
    for case in 0..CASES {
        let bytes = damaged(&seed, &other, random);
        let start = Instant::now();
        (parser.parse)(&bytes);
        let took = start.elapsed();
        assert!(took < Duration::from_secs(60), "{}, case {case}: took {took:?}", parser.name);
    }
}

#[test]
fn no_parser_panics_or_hangs() {
    let mut random = Random(0x9e37_79b9_7f4a_7c15);
    for parser in PARSERS {
        assault(parser, &mut random);
    }
}

#[test]
fn every_parser_has_its_fuzz_target() {
    let fuzz = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz");
    let manifest = std::fs::read_to_string(fuzz.join("Cargo.toml")).unwrap();
    for parser in PARSERS {
        let target = std::fs::read_to_string(fuzz.join(format!("fuzz_targets/{}.rs", parser.name))).unwrap();
        assert!(target.contains(&format!("parse(\"{}\", bytes)", parser.name)), "{}", parser.name);
        assert!(manifest.contains(&format!("fuzz_targets/{}.rs", parser.name)), "{}", parser.name);
    }
}
