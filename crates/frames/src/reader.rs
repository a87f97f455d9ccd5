//! The stream of decoded frames.

use crate::FramesError;
use endoscape_core::Frame;

/// Gives frames in time order until there are no more.
pub trait FrameSource: Send {
    /// The next frame, or `None` at the end. After an error about one frame (a picture that does not decode) the next
    /// call goes on with the frame after it.
    ///
    /// # Errors
    /// [`FramesError`] that names the frame's file.
    fn next_frame(&mut self) -> Result<Option<Frame>, FramesError>;
}
