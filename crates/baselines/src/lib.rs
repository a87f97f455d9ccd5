//! Classical methods behind the same traits as the learned one: the paper's rivals.
//!
//! | module | method |
//! |---|---|
//! | [`direct`] | [`Direct`]: semi-dense alignment of brightness |
//! | [`magnetic`] | [`Magnetic`]: a dipole fitted to Hall sensors |
//! | [`fused`] | [`Fused`]: the magnet's place and any method's motion, in metres with all six degrees of freedom |
//! | `orb` | `Orb`: ORB SLAM by the crate kornia-slam, in builds with the feature `orb` |
//! | [`least_squares`] | Levenberg-Marquardt on manifolds, which the methods share |
//!
//! Every method answers every observation: what it cannot use yields a pose of low confidence and a sentence.

#[cfg(test)]
mod alignment;
pub mod direct;
pub mod error;
pub mod fused;
pub mod least_squares;
pub mod magnetic;
#[cfg(feature = "orb")]
pub mod orb;
mod picture;

pub use direct::{Direct, DirectConfig};
pub use error::BaselineError;
pub use fused::{Fused, FusedConfig};
pub use magnetic::{Magnetic, MagneticConfig};
#[cfg(feature = "orb")]
pub use orb::{Orb, OrbConfig};
