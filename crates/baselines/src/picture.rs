//! What methods that only look at pictures say to other observations.

use endoscape_core::{Frame, Observation, Size, TrackError};

/// The picture of an observation, if it is one of the camera's size.
///
/// # Errors
/// [`TrackError::Unsuitable`] for a magnetic reading, or a picture of another camera.
pub fn of<'a>(observation: &'a Observation, method: &'static str, size: Size) -> Result<&'a Frame, TrackError> {
    let unsuitable = |index, reason| Err(TrackError::Unsuitable { method, index, reason });
    match observation {
        Observation::Frame(frame) if frame.image.size() == size => Ok(frame),
        Observation::Frame(frame) => {
            let found = frame.image.size();
            unsuitable(
                frame.index,
                format!("it is {found} but the camera is for {size}; give the camera of these frames"),
            )
        }
        Observation::Magnetic(reading) => {
            unsuitable(reading.index, "it is a magnetic reading, but pictures are needed; give a video".into())
        }
    }
}
