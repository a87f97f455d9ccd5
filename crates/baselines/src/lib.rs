//! Classical methods behind the same traits as the learned one: the paper's rivals.
//!
//! | module | method |
//! |---|---|
//! | [`direct`] | [`Direct`]: semi-dense alignment of brightness |
//! | [`magnetic`] | [`Magnetic`]: a dipole fitted to Hall sensors |
//! | [`fused`] | [`Fused`]: the magnet's place and any method's motion, in metres with all six degrees of freedom |
//! | [`least_squares`] | Levenberg-Marquardt on manifolds, which the methods share |
//!
//! Every method answers every observation: what it cannot use yields a pose of low confidence and a sentence.

pub mod direct;
pub mod error;
pub mod fused;
pub mod least_squares;
pub mod magnetic;

pub use direct::{Direct, DirectConfig};
pub use error::BaselineError;
pub use fused::{Fused, FusedConfig};
pub use magnetic::{Magnetic, MagneticConfig};
