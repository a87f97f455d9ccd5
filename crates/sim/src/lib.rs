//! The procedural patient: endoscopic sequences with exact truth, from a seed.
//!
//! ```text
//! seed -> Anatomy (wall, axis, lesions) -> Deformation(t) -> Posed wall -+
//!                        \-> Flight(t) -> pose of every row ------------+-> Scene::render -> light and truth per pixel
//!                        \-> Mucosa, Lamps ----------------------------/        |
//!                                           Medium (fluid, bubbles, debris) ----+-> Sensor -> frame and masks
//!                                                                                    \-> sequence folder
//! ```
//! An organ is a net of vertices around a curve; bicubic patches over the net are its surface. Deformation moves the
//! vertices as a closed function of time, so any moment can be had without those before it. Rays meet the patches by
//! Newton's method inside a bounding-volume hierarchy that is refitted, not rebuilt, from moment to moment. Depth,
//! normals, classes and surface flow all come from the one smooth surface, so they agree to rounding; fine relief and
//! vessels exist in the shading only. Everything random is a hash of the seed and its purpose ([`random`]), so the
//! same seed gives the same bytes on any number of threads.
//!
//! | module | what |
//! |---|---|
//! | [`anatomy`] | colon, stomach, small bowel, imported meshes; lesions |
//! | [`deformation`] | peristalsis, contractions, breathing |
//! | [`surface`] | patches and triangles, rays, sites that move with the tissue |
//! | [`path`] | where the camera goes |
//! | [`mucosa`] | colour, vessels, relief, classes |
//! | [`light`] | lamps, diffuse and wet reflection |
//! | [`render`] | one frame of light and truth |
//! | [`medium`] | what floats between wall and lens |
//! | [`sensor`] | from light to bytes |
//! | [`magnet`] | the capsule's magnet read by Hall sensors |
//! | [`simulate`](mod@simulate) | a sequence folder from a seed |

pub mod anatomy;
pub mod deformation;
mod effects;
pub mod error;
pub mod light;
pub mod magnet;
pub mod medium;
pub mod mucosa;
pub mod path;
pub mod random;
pub mod render;
pub mod sensor;
pub mod simulate;
pub mod surface;

pub use anatomy::{Anatomy, Organ};
pub use effects::{Effect, Effects};
pub use error::SimError;
pub use magnet::{Hall, Magnetometer};
pub use path::{Flight, PathKind};
pub use simulate::{Config, Patient, Rendered, Session, Source, Summary, capsule_lens, simulate};
