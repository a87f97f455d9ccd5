//! Pictures, depth and masks made ready: rectification, resizing, field-of-view and specular masks.
//!
//! | module | what |
//! |---|---|
//! | [`rectify`] | pictures, depth and masks of one lens as another would have seen them |
//! | [`resize`] | other sizes, in step with [`endoscape_core::Camera::scaled_to`] |
//! | [`field_of_view`] | the circle, polygon or rectangle the optics fill, found from dark borders |
//! | [`contrast`] | brightness against its surroundings, for comparing pictures under a moving lamp |
//! | [`specular`] | highlights, where brightness says nothing about the surface |
//!
//! Masks are `true` where a pixel may be used. Nothing here invents data: every operation on a mask or a depth map may
//! lose pixels, but a pixel it keeps rests on usable ones alone.

pub mod contrast;
pub mod field_of_view;
pub mod rectify;
pub mod resize;
pub mod specular;

mod convex;
mod windows;
