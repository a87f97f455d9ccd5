//! The motion network's answer sharpened by the pictures themselves.
//!
//! The network sees the whole motion at once but knows it to some per cent only. Given its answer to start from and the
//! depth network's map of the anchor, aligning brightness (docs/math.md, "Direct alignment") finds the motion to a small
//! fraction of a pixel, in the unit of that depth.

use crate::correct::Sighting;
use crate::reproject::{bilinear, rescaled, stretched};
use endoscape_baselines::direct::align::Reference;
use endoscape_baselines::direct::point::Point;
use endoscape_baselines::direct::pyramid::{Lenses, Pyramid};
use endoscape_baselines::direct::{Alignment, Brightness};
use endoscape_core::{Camera, CameraError, Grid, Image, Pose, Size};
use endoscape_frames::FramesError;
use endoscape_frames::preprocess::specular::{self, SpecularConfig};
use endoscape_frames::preprocess::{contrast, resize};
use nalgebra::{Point2, Point3};
use rayon::iter::{IntoParallelRefIterator, ParallelIterator};

/// Pixels that are compared.
const POINTS: usize = 1200;

/// Standard deviation of a keyframe's depth as a share of it, before any picture has been compared with it: the depth
/// network's error on pictures of other makers, after scaling (docs/results.md).
const DEPTH_DOUBT: f64 = 0.3;

/// Standard deviation of local contrast between two views of one place, grey levels.
const NOISE: f64 = 6.0;

/// Share of the visible points that must agree, and of all points that must be visible, for an alignment to count.
const LEAST_SHARE: f64 = 0.4;

/// Correlation of both pictures' local contrast below which they do not show the same.
const LEAST_CORRELATION: f64 = 0.4;

/// Width at which pictures are compared; narrower ones stay as they are.
const WIDTH: usize = 320;

/// Halvings of the picture at most.
const LEVELS: usize = 6;

/// A picture made ready for comparing: of moderate size, its local contrast in the place of brightness, which changes
/// when the lamp moves, and without highlights.
#[derive(Clone, Debug)]
pub struct Contrast {
    pyramid: Pyramid,
    /// 1 where the surface is seen, 0 on highlights.
    matt: Grid<f32>,
}

/// Sharpens motions between pictures of one camera.
#[derive(Clone, Debug)]
pub struct Refiner {
    lenses: Lenses,
}

impl Refiner {
    /// For the frames of `camera`.
    ///
    /// # Errors
    /// [`CameraError`] for a camera that cannot be scaled.
    pub fn new(camera: &Camera) -> Result<Self, CameraError> {
        let Size { width, height } = camera.size();
        let narrow = Size::new(WIDTH, (height * WIDTH).div_ceil(width));
        let camera = camera.scaled_to(if width > WIDTH { narrow } else { camera.size() })?;
        Ok(Self { lenses: Lenses::new(&camera, LEVELS)? })
    }

    /// Size at which pictures are compared.
    fn size(&self) -> Size {
        self.lenses.level(0).camera().size()
    }

    /// Prepares a frame; done once, however often it is compared.
    ///
    /// # Errors
    /// [`FramesError`] for a picture without pixels.
    pub fn contrast(&self, frame: &Image) -> Result<Contrast, FramesError> {
        let image = resize::image(frame, self.size())?;
        let mask = specular::mask(&image, &SpecularConfig { dilation_px: 2, ..SpecularConfig::default() });
        let matt = Grid::from_fn(image.size(), |x, y| if mask.get(x, y) == Some(&true) { 1.0 } else { 0.0 });
        Ok(Contrast { pyramid: Pyramid::new(&contrast::local(&image), None, &self.lenses), matt })
    }

    /// The points of a frame that others are compared with; `depth` covers the whole picture at any size, in any unit.
    pub fn reference(&self, frame: &Contrast, depth: &Grid<f32>) -> Reference {
        let depth = stretched(depth, self.size());
        Reference::of_depth((&frame.pyramid, &self.lenses), (&depth, DEPTH_DOUBT), Some(&frame.matt), POINTS)
    }

    /// Motion from a reference to the current picture, translation in the unit of the reference's depth, found near one
    /// of `guesses`: the one after which both pictures correlate best.
    ///
    /// The pictures then say how deep the reference's points are, so that every picture makes the next motion better.
    /// `None` where they do not say: too little texture, too little in view, or no agreement.
    pub fn refined(&self, reference: &mut Reference, current: &Contrast, guesses: &[Pose]) -> Option<Pose> {
        let aligned = |guess: &Pose| {
            let guess = Alignment::guess(*guess, Brightness::default());
            reference.align(&current.pyramid, &self.lenses, &guess, NOISE)
        };
        let trusted: Vec<Alignment> = guesses.par_iter().filter_map(aligned).filter(is_trusted).collect();
        let best = trusted.into_iter().max_by(|a, b| a.correlation.total_cmp(&b.correlation))?;
        reference.observe(&current.pyramid, &self.lenses, &best, NOISE);
        Some(best.current_from_reference)
    }

    /// What pictures have shown of the depth of a reference's points, held against a depth map of another picture,
    /// which covers it at any size in the unit of the reference; the motion goes from one to the other.
    ///
    /// What was believed of a point beforehand is taken out of its doubt, so that it does not pass for measured.
    pub fn sightings(&self, reference: &Reference, other_from_reference: &Pose, depth: &Grid<f32>) -> Vec<Sighting> {
        let lens = self.lenses.level(0);
        let sighting = |point: &Point| {
            let learned = point.inverse_depth.doubt().powi(-2) - DEPTH_DOUBT.powi(-2);
            let moved = other_from_reference * Point3::from(point.ray / point.inverse_depth.mean);
            let pixel = Point2::from(lens.project(&moved.coords)?);
            let at = rescaled(&pixel, self.size(), depth.size());
            let log_ratio = (moved.z / bilinear(depth, &at)?).ln();
            (learned > 0.0 && log_ratio.is_finite()).then(|| Sighting { at, log_ratio, sigma: learned.powf(-0.5) })
        };
        reference.points.iter().filter(|point| point.found > 0).filter_map(sighting).collect()
    }
}

fn is_trusted(aligned: &Alignment) -> bool {
    aligned.agreeing.min(aligned.visible) >= LEAST_SHARE && aligned.correlation >= LEAST_CORRELATION
}
