//! Subsequences of posed stretches, as they could also have been.
//!
//! A stretch is walked back and forth without end, from a random place on, so that every subsequence has its full length
//! and time runs either way: the truth of a motion backwards is the inverse motion, exactly. A picture mirrored or turned
//! by a right angle about its centre is the picture of a mirrored or turned world, by a camera whose principal point and
//! focal lengths are mirrored or exchanged along; the network sees no camera. With `M` that change of the axes,
//!
//! ```text
//! R' = M R M^T        t' = M t
//! ```
//!
//! Everything drawn follows from the seed, the step and the place in the batch alone.

use super::clip::{PosedClip, PosedFrame};
use super::config::SupervisedConfig;
use super::loss::target_of;
use burn::tensor::{Device, Tensor, TensorData};
use endoscape_core::{Image, Pose, Size};
use endoscape_nets::input::network_range;
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

/// One of the eight symmetries of a square; those of them that keep a rectangle's shape are the four without exchange.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Symmetry {
    /// Left becomes right.
    pub mirror: bool,
    /// Above becomes below.
    pub flip: bool,
    /// Then rows become columns.
    pub exchange: bool,
}

impl Symmetry {
    fn draw(size: Size, rng: &mut ChaCha8Rng) -> Self {
        let [mirror, flip, exchange] = [(); 3].map(|()| rng.random::<bool>());
        Self { mirror, flip, exchange: exchange && size.width == size.height }
    }

    /// The pixel of the original that the changed picture of `size` shows at column `x` and row `y`.
    pub const fn origin(self, size: Size, x: usize, y: usize) -> (usize, usize) {
        let (x, y) = if self.exchange { (y, x) } else { (x, y) };
        let x = if self.mirror { size.width - 1 - x } else { x };
        (x, if self.flip { size.height - 1 - y } else { y })
    }

    /// The same change of the camera's axes.
    pub fn axes(self) -> Matrix3<f64> {
        let sign = |changed: bool| if changed { -1.0 } else { 1.0 };
        let mirrored = Matrix3::from_diagonal(&Vector3::new(sign(self.mirror), sign(self.flip), 1.0));
        let exchanged = Matrix3::new(0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
        if self.exchange { exchanged * mirrored } else { mirrored }
    }

    /// The motion as the changed pictures show it.
    pub fn motion(self, motion: &Pose) -> Pose {
        let axes = self.axes();
        let rotation = axes * motion.rotation.to_rotation_matrix().into_inner() * axes.transpose();
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
        Pose::from_parts(Translation3::from(axes * motion.translation.vector), rotation)
    }
}

/// Position of step `at` of a walk back and forth along `length` places.
///
/// # Panics
/// If there are fewer than two places.
const fn back_and_forth(at: usize, length: usize) -> usize {
    let place = at % (2 * (length - 1));
    if place < length { place } else { 2 * (length - 1) - place }
}

/// Subsequences side by side.
pub struct Passage {
    /// `[batch, time, 6, height, width]`, RGB in [-1, 1], the earlier frame first.
    pub pairs: Tensor<5>,
    /// `[batch, time, 6]`: what the network should answer.
    pub truth: Tensor<3>,
}

impl Passage {
    /// Lays pictures and motions on the device; `frames` are those of all subsequences one after another, each one frame
    /// longer than its motions.
    fn new(frames: Vec<f32>, truth: Vec<f32>, [batch, time]: [usize; 2], size: Size, device: &Device) -> Self {
        let shape = [batch, time + 1, 3, size.height, size.width];
        let frames = Tensor::<5>::from_data(TensorData::new(frames, shape), device);
        let pairs = Tensor::cat(vec![frames.clone().narrow(1, 0, time), frames.narrow(1, 1, time)], 2);
        Self { pairs, truth: Tensor::from_data(TensorData::new(truth, [batch, time, 6]), device) }
    }

    /// The subsequences of a step.
    pub fn draw(clips: &[PosedClip], config: &SupervisedConfig, unit_m: f64, step: u64, device: &Device) -> Self {
        let (mut frames, mut truth) = (Vec::new(), Vec::new());
        for place in 0..config.batch as u64 {
            let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
            rng.set_stream(step * config.batch as u64 + place);
            let drawn = Drawn::new(clips, config, &mut rng);
            drawn.frames.iter().for_each(|frame| drawn.picture(&frame.image, &mut frames));
            truth.extend(drawn.motions().flat_map(|motion| target_of(&motion, unit_m)));
        }
        Self::new(frames, truth, [config.batch, config.subsequence], config.size(), device)
    }

    /// Neighbouring frames as they are, as one subsequence.
    pub fn plain(frames: &[PosedFrame], unit_m: f64, device: &Device) -> Self {
        let drawn = Drawn { frames: frames.iter().collect(), symmetry: Symmetry::default(), gains: [1.0; 3] };
        let (mut pictures, mut truth) = (Vec::new(), Vec::new());
        frames.iter().for_each(|frame| drawn.picture(&frame.image, &mut pictures));
        truth.extend(drawn.motions().flat_map(|motion| target_of(&motion, unit_m)));
        let size = frames.first().map_or(Size::new(0, 0), |frame| frame.image.size());
        Self::new(pictures, truth, [1, frames.len().saturating_sub(1)], size, device)
    }
}

/// Frames of one subsequence and what is changed about all of them.
struct Drawn<'a> {
    frames: Vec<&'a PosedFrame>,
    symmetry: Symmetry,
    /// Factor on red, green and blue.
    gains: [f32; 3],
}

impl<'a> Drawn<'a> {
    fn new(clips: &'a [PosedClip], config: &SupervisedConfig, rng: &mut ChaCha8Rng) -> Self {
        let stretch = stretch_of(clips, rng);
        let gap = rng.random_range(1..=config.longest_gap.min(stretch.len() - 1));
        let start = rng.random_range(0..2 * (stretch.len() - 1));
        let frame = |place: usize| &stretch[back_and_forth(start + place * gap, stretch.len())];
        let symmetry = if config.symmetries { Symmetry::draw(config.size(), rng) } else { Symmetry::default() };
        let mut change = || 1.0 + config.colour_change as f32 * (2.0 * rng.random::<f32>() - 1.0);
        let brightness = change();
        let gains = [(); 3].map(|()| brightness * change());
        Self { frames: (0..=config.subsequence).map(frame).collect(), symmetry, gains }
    }

    /// Appends a picture as the network sees it, `[3, height, width]`.
    fn picture(&self, image: &Image, values: &mut Vec<f32>) {
        let size @ Size { width, height } = image.size();
        for (channel, gain) in self.gains.into_iter().enumerate() {
            for pixel in 0..width * height {
                let (x, y) = self.symmetry.origin(size, pixel % width, pixel / width);
                let value = f32::from(image.rgb()[3 * (y * width + x) + channel]) / 255.0;
                values.push(network_range((gain * value).min(1.0)));
            }
        }
    }

    /// `previous_from_current` of neighbouring frames, as the changed pictures show it.
    fn motions(&self) -> impl Iterator<Item = Pose> {
        self.frames.windows(2).map(|pair| {
            let previous_from_current = pair[0].world_from_camera.inverse() * pair[1].world_from_camera;
            self.symmetry.motion(&previous_from_current)
        })
    }
}

/// A stretch of any clip, each as likely as it has pairs.
///
/// # Panics
/// If there is none.
fn stretch_of<'a>(clips: &'a [PosedClip], rng: &mut ChaCha8Rng) -> &'a [PosedFrame] {
    let stretches = || clips.iter().flat_map(|clip| clip.stretches.iter());
    let pairs: usize = stretches().map(|stretch| stretch.len() - 1).sum();
    let mut number = rng.random_range(0..pairs);
    let mut found: &[PosedFrame] = &[];
    for stretch in stretches() {
        found = stretch;
        match number.checked_sub(stretch.len() - 1) {
            Some(rest) => number = rest,
            None => break,
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use endoscape_core::{Camera, se3};
    use nalgebra::{Point2, Point3, Vector6};

    const SYMMETRIES: [Symmetry; 8] = {
        let mut all = [Symmetry { mirror: false, flip: false, exchange: false }; 8];
        let mut at = 0;
        while at < 8 {
            all[at] = Symmetry { mirror: at & 1 == 1, flip: at & 2 == 2, exchange: at & 4 == 4 };
            at += 1;
        }
        all
    };

    #[test]
    fn a_changed_picture_shows_the_changed_point() {
        let size = Size::new(33, 33);
        let camera = Camera::from_field_of_view(size, 1.2).unwrap();
        // Chosen so that it lies on a pixel centre.
        let ray = camera.unproject(&Point2::new(5.0, 21.0)).unwrap();
        for symmetry in SYMMETRIES {
            let seen = camera.project(&Point3::from(symmetry.axes() * ray * 3.0)).unwrap();
            let origin = symmetry.origin(size, seen.x.round() as usize, seen.y.round() as usize);
            assert_eq!(origin, (5, 21), "{symmetry:?} {seen}");
        }
    }

    #[test]
    fn changed_motions_move_changed_points_alike() {
        let motion = se3::exp(&Vector6::new(0.1, -0.2, 0.3, 0.2, -0.1, 0.4));
        let point = Point3::new(0.3, -0.7, 1.9);
        for symmetry in SYMMETRIES {
            let change = |point: Point3<f64>| Point3::from(symmetry.axes() * point.coords);
            let difference = symmetry.motion(&motion) * change(point) - change(motion * point);
            assert!(difference.norm() < 1e-12, "{symmetry:?}");
            assert!((symmetry.motion(&motion).rotation.angle() - motion.rotation.angle()).abs() < 1e-12);
        }
    }

    #[test]
    fn the_walk_turns_at_both_ends() {
        let walk: Vec<usize> = (0..9).map(|at| back_and_forth(at, 4)).collect();
        assert_eq!(walk, [0, 1, 2, 3, 2, 1, 0, 1, 2]);
        assert_eq!((0..4).map(|at| back_and_forth(at, 2)).collect::<Vec<_>>(), [0, 1, 0, 1]);
    }

    fn clip() -> PosedClip {
        let frame = |at: usize| PosedFrame {
            image: Image::from_fn(Size::new(32, 32), |x, y| [(at * 20) as u8, (3 * x) as u8, (5 * y) as u8]),
            world_from_camera: Pose::translation(at as f64, 0.0, 0.0),
        };
        PosedClip { name: "test".into(), stretches: vec![(0..5).map(frame).collect()], fingerprint: String::new() }
    }

    #[test]
    fn a_step_is_the_same_whenever_it_is_drawn_and_its_truth_fits_its_frames() {
        let config = SupervisedConfig { width: 32, height: 32, colour_change: 0.0, ..SupervisedConfig::default() };
        let draw = |step| Passage::draw(&[clip()], &config, 0.5, step, &Device::flex());
        assert_eq!(draw(7).pairs.into_data(), draw(7).pairs.into_data());
        assert_ne!(draw(7).pairs.into_data(), draw(8).pairs.into_data());
        // The red channel tells the frame, 20 levels each; one frame on is two units along one of the picture's axes.
        let Passage { pairs, truth } = draw(3);
        let red = |channel: usize| pairs.clone().slice([0..2, 0..16, channel..channel + 1, 0..1, 0..1]);
        let frame_of = |channel: usize| (red(channel) + 1.0).mul_scalar(127.5 / 20.0);
        let steps = (frame_of(3) - frame_of(0)).abs().flatten::<1>(0, 4);
        let lengths = truth.narrow(2, 0, 3).abs().sum_dim(2).flatten::<1>(0, 2);
        assert!((steps.mul_scalar(2.0) - lengths).abs().max().into_scalar::<f32>() < 1e-4);
    }
}
