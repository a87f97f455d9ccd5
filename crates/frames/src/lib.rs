//! Where frames come from.
//!
//! ```text
//! path -> formats::open -> Sequence -> FrameReader::next_frame -> Frame -> preprocess -> sequence_folder::Writer
//!                              \-> inspect: do poses, depth and calibration agree?
//! ```
//!
//! | module | what |
//! |---|---|
//! | [`formats`] | tells data sets apart by content and loads each into a [`Sequence`] |
//! | [`sequence`] | [`Sequence`]: frames in time order with camera, poses, depth and masks where they exist |
//! | [`camera_file`] | calibrations from the files of other tools |
//! | [`magnet`] | magnetic readings beside the frames of a sequence folder |
//! | [`malformed`] | what a parser says about content whose file it does not know |
//! | [`reader`] | [`FrameSource`], the stream of decoded frames |
//! | [`picture`] | still pictures of any bit depth to [`endoscape_core::Image`] |
//! | [`depth`] | the depth encodings of all data sets to metres |
//! | [`video`] | video files and live inputs through an `ffmpeg` process |
//! | [`sequence_folder`] | our own folder, written in one piece |
//! | [`labels`] | what a run has found out about a sequence, in the place of its truth |
//! | [`preprocess`] | rectification, resizing, field-of-view and specular masks |
//! | [`convert`] | any sequence to a sequence folder |
//! | [`parallax`] | how far the picture moves between two frames |
//! | [`tracks`] | points followed from picture to picture |
//! | [`inspect`] | what a path holds and which convention its numbers follow |

pub mod camera_file;
pub mod convert;
pub mod depth;
pub mod error;
pub mod formats;
pub mod inspect;
pub mod labels;
pub mod magnet;
pub mod malformed;
pub mod natural;
pub mod parallax;
pub mod picture;
pub mod preprocess;
pub mod reader;
pub mod sequence;
pub mod sequence_folder;
pub mod tracks;
pub mod video;

pub use error::FramesError;
pub use formats::Format;
pub use malformed::Malformed;
pub use reader::FrameSource;
pub use sequence::{FrameEntry, ImageLocation, Sequence};
