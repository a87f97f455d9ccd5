//! What the method sees of a frame: a small picture through a pinhole, and the ORB features in it (E. Rublee et al.,
//! "ORB: an efficient alternative to SIFT or SURF", ICCV 2011; the crate kornia-imgproc).
//!
//! A lens with distortion is rectified to the widest pinhole that leaves no pixel empty, because the map's geometry is
//! a pinhole's.

use super::OrbConfig;
use crate::BaselineError;
use endoscape_core::{Camera, CameraModel, Frame, Image, Mask, Size};
use endoscape_frames::preprocess::rectify::{Rectifier, pinhole_for};
use endoscape_frames::preprocess::resize;
use kornia_3d::camera::PinholeCamera;
use kornia_image::{Image as Pixels, ImageSize};
use kornia_imgproc::clahe::clahe;
use kornia_imgproc::features::{OrbDetector, OrbFeatures};

/// Smallest side a working picture may have, pixels: two borders of 19 around a patch of ORB and room to move.
const SMALLEST_SIDE: usize = 64;
/// Smallest side of the coarsest picture of the pyramid, pixels.
const COARSEST_SIDE: f64 = 48.0;
/// Ratio of neighbouring sizes of the pyramid, and its levels (Rublee et al.; the map counts on both).
const PYRAMID: (f64, usize) = (1.2, 8);
/// Tiles across and down whose contrast is equalised, as usual for CLAHE (K. Zuiderveld, "Graphics gems IV", 1994).
const TILES: (usize, usize) = (8, 8);

/// One frame as the method sees it.
#[derive(Clone)]
pub struct View {
    /// Grey picture of the working size.
    pub pixels: Pixels<u8, 1>,
    /// Its features, at usable pixels.
    pub features: OrbFeatures,
}

/// Makes views of the frames of one camera.
pub struct Eye {
    config: OrbConfig,
    working: Size,
    rectifier: Option<Rectifier>,
    pinhole: PinholeCamera,
    detector: OrbDetector,
}

impl Eye {
    /// An eye for a camera.
    ///
    /// # Errors
    /// [`BaselineError`] for pictures too small or a lens no pinhole sees through.
    pub fn new(config: &OrbConfig, camera: &Camera) -> Result<Self, BaselineError> {
        let working = working_size(camera.size(), config.width);
        let side = working.width.min(working.height);
        if side < SMALLEST_SIDE {
            let expected = "such that both sides of the pictures have at least 64 pixels";
            return Err(BaselineError::Config { name: "width", value: working.width as f64, expected });
        }
        let small = camera.scaled_to(working)?;
        let (pinhole, rectifier) = match small.model() {
            CameraModel::Pinhole(_) => (small, None),
            _ => {
                let pinhole = pinhole_for(&small, working, None)?;
                let rectifier = Rectifier::new(&small, &pinhole);
                (pinhole, Some(rectifier))
            }
        };
        let levels = (side as f64 / COARSEST_SIDE).log(PYRAMID.0).floor() as usize + 1;
        let detector = OrbDetector {
            n_keypoints: config.features,
            n_scales: levels.min(PYRAMID.1),
            downscale: PYRAMID.0 as f32,
            ini_fast_threshold: config.fast_threshold as f32 / 255.0,
            min_fast_threshold: config.fast_floor as f32 / 255.0,
            ..OrbDetector::new()
        };
        Ok(Self { config: *config, working, rectifier, pinhole: intrinsics(&pinhole), detector })
    }

    /// The pinhole of the views.
    pub const fn pinhole(&self) -> &PinholeCamera {
        &self.pinhole
    }

    /// Size of the views.
    pub const fn size(&self) -> ImageSize {
        ImageSize { width: self.working.width, height: self.working.height }
    }

    /// The view of a frame; a sentence where it cannot be made.
    pub fn see(&self, frame: &Frame) -> Result<View, String> {
        let pixels = self.pixels(&frame.image)?;
        let mut features = self.detector.detect_and_extract_u8(&pixels).map_err(|error| error.to_string())?;
        if let Some(usable) = self.usable(frame)? {
            keep(&mut features, |[x, y]| usable.get(*x as usize, *y as usize) == Some(&true));
        }
        Ok(View { pixels, features })
    }

    fn pixels(&self, image: &Image) -> Result<Pixels<u8, 1>, String> {
        let small;
        let mut picture = image;
        if image.size() != self.working {
            small = resize::image(image, self.working).map_err(|error| error.to_string())?;
            picture = &small;
        }
        let rectified;
        if let Some(rectifier) = &self.rectifier {
            rectified = rectifier.image(picture).map_err(|error| error.to_string())?;
            picture = &rectified;
        }
        let grey: Vec<u8> = picture.luma().values().iter().map(|value| value.round() as u8).collect();
        let pixels = Pixels::new(self.size(), grey).map_err(|error| error.to_string())?;
        if self.config.clip_limit == 0.0 {
            return Ok(pixels);
        }
        let mut equalised = pixels.clone();
        clahe(&pixels, &mut equalised, self.config.clip_limit, TILES).map_err(|error| error.to_string())?;
        Ok(equalised)
    }

    fn usable(&self, frame: &Frame) -> Result<Option<Mask>, String> {
        let Some(usable) = &frame.usable else { return Ok(None) };
        let small = resize::mask(usable, self.working);
        match &self.rectifier {
            None => Ok(Some(small)),
            Some(rectifier) => rectifier.mask(&small).map(Some).map_err(|error| error.to_string()),
        }
    }
}

/// The size of pictures, reduced to a width unless they are narrower.
fn working_size(size: Size, width: usize) -> Size {
    if size.width <= width {
        return size;
    }
    let height = size.height as f64 * width as f64 / size.width as f64;
    Size::new(width, height.round() as usize)
}

/// Focal lengths and centre of a pinhole; an eye's camera has no skew to lose, as rectified and scaled pinholes have none
/// and calibrations of endoscopes give none.
fn intrinsics(camera: &Camera) -> PinholeCamera {
    let (fx, fy, cx, cy) = match camera.model() {
        CameraModel::Pinhole(pinhole) => {
            let intrinsics = &pinhole.intrinsics;
            (intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy)
        }
        _ => (1.0, 1.0, 0.0, 0.0),
    };
    PinholeCamera { fx, fy, cx, cy, k1: 0.0, k2: 0.0, p1: 0.0, p2: 0.0 }
}

/// Drops the features whose place is refused.
fn keep(features: &mut OrbFeatures, accepted: impl Fn(&[f32; 2]) -> bool) {
    let kept: Vec<bool> = features.keypoints_xy.iter().map(accepted).collect();
    fn only<T>(values: &mut Vec<T>, kept: &[bool]) {
        let mut kept = kept.iter();
        values.retain(|_| kept.next() == Some(&true));
    }
    only(&mut features.keypoints_xy, &kept);
    only(&mut features.orientations, &kept);
    only(&mut features.descriptors, &kept);
    only(&mut features.octaves, &kept);
}
