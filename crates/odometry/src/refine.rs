//! The motion network's answer sharpened by the pictures themselves.
//!
//! The network sees the whole motion at once but knows it to some per cent only. Given its answer to start from and the
//! depth network's map of the anchor, aligning brightness (docs/math.md, "Direct alignment") finds the motion to a small
//! fraction of a pixel, in the unit of that depth.

use crate::learned::stretched;
use endoscape_baselines::direct::{Alignment, align};
use endoscape_core::{Camera, DepthMap, Grid, Image, Pose, Size};
use endoscape_frames::FramesError;
use endoscape_frames::preprocess::specular::{self, SpecularConfig};
use endoscape_frames::preprocess::{contrast, resize};

/// Pixels that are compared.
const POINTS: usize = 800;

/// Share of the visible points that must agree, and of all points that must be visible, for an alignment to count.
const LEAST_SHARE: f64 = 0.4;

/// Correlation of both pictures' local contrast below which they do not show the same.
const LEAST_CORRELATION: f64 = 0.4;

/// Width at which pictures are compared; narrower ones stay as they are.
const WIDTH: usize = 320;

/// A picture made ready for comparing: of moderate size, its local contrast in the place of brightness, which changes
/// when the lamp moves, and without highlights.
#[derive(Clone, Debug)]
pub struct Contrast {
    image: Image,
    /// 1 where the surface is seen, 0 on highlights.
    matt: Grid<f32>,
}

impl Contrast {
    /// Prepares a frame.
    ///
    /// # Errors
    /// [`FramesError`] for a picture without pixels.
    pub fn new(frame: &Image) -> Result<Self, FramesError> {
        let Size { width, height } = frame.size();
        let narrow = Size::new(WIDTH, (height * WIDTH).div_ceil(width.max(1)));
        let image = resize::image(frame, if width > WIDTH { narrow } else { frame.size() })?;
        let mask = specular::mask(&image, &SpecularConfig { dilation_px: 2, ..SpecularConfig::default() });
        let matt = Grid::from_fn(image.size(), |x, y| if mask.get(x, y) == Some(&true) { 1.0 } else { 0.0 });
        Ok(Self { image: contrast::local(&image), matt })
    }

    /// Extent in pixels.
    pub const fn size(&self) -> Size {
        self.image.size()
    }
}

/// Motion from a reference to the current picture, translation in the unit of the reference's depth, found near one of
/// `guesses`: the one after which both pictures correlate best.
///
/// `depth` is that of the reference; `camera` is scaled to the size of the pictures. `None` where they do not say: too
/// little texture, too little in view, or no agreement.
pub fn refined(
    (reference, depth): (&Contrast, &Grid<f32>),
    current: &Contrast,
    camera: &Camera,
    guesses: &[Pose],
) -> Option<Pose> {
    let camera = camera.scaled_to(reference.size()).ok().filter(|_| reference.size() == current.size())?;
    let depth = DepthMap::new(stretched(depth, reference.size()));
    let picture = (&reference.image, &depth, Some(&reference.matt));
    let aligned = align(picture, &current.image, &camera, guesses, POINTS).ok()?;
    let trusted = aligned.into_iter().filter(is_trusted);
    Some(trusted.max_by(|a, b| a.correlation.total_cmp(&b.correlation))?.current_from_reference)
}

fn is_trusted(aligned: &Alignment) -> bool {
    aligned.agreeing.min(aligned.visible) >= LEAST_SHARE && aligned.correlation >= LEAST_CORRELATION
}
