//! Fuzz targets for every parser of foreign text and bytes.
//!
//! The table in `parsers.rs` names each parser with a valid input to start from. A new parser is one row there, one
//! file of two lines in `fuzz_targets/` and one `[[bin]]` in `Cargo.toml`. The same table drives the deterministic
//! `hostile` test of `endoscape-frames`, which runs with every `cargo test`.
//!
//! ```text
//! cargo +nightly run --example seeds      # in fuzz/, once: writes corpus/<target>/seed
//! cargo +nightly fuzz run camera -- -max_total_time=60
//! ```

mod parsers;

pub use parsers::{PARSERS, Parser};

/// Feeds bytes to the parser of this name.
///
/// # Panics
/// If there is no such parser, or the parser itself does, which is what fuzzing looks for.
pub fn parse(name: &str, bytes: &[u8]) {
    let parser = PARSERS.iter().find(|parser| parser.name == name).expect("a parser of the table");
    (parser.parse)(bytes);
}
