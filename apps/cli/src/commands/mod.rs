//! One module per command: its arguments and what it does.

pub mod adapt;
pub mod compare;
pub mod convert;
pub mod demo;
pub mod depth;
pub mod devices;
pub mod eval;
pub mod export;
pub mod import;
pub mod inspect;
pub mod motion;
pub mod report;
pub mod run;
pub mod simulate;
pub mod train;
