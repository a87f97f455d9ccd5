//! One module per command: its arguments and what it does.

pub mod convert;
pub mod devices;
pub mod eval;
pub mod export;
pub mod import;
pub mod inspect;
pub mod simulate;
pub mod train;
