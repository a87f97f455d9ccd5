//! One file per command: `Args` and `run`.

pub mod convert;
pub mod devices;
pub mod inspect;
