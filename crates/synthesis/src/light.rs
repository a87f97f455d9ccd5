//! An endoscope carries its lamp: what is near is bright, and brightness alone says much about depth.
//!
//! Light that leaves the tip of the instrument and returns to it obeys `L = c a f(cos) / r^2`, with the distance `r`
//! along the ray, the angle between surface normal and ray, the albedo `a`, and one constant `c` per picture for lamp
//! and exposure. Solved for the distance it is a depth map up to one factor, from a single picture. Wet tissue scatters
//! under its surface and darkens less towards grazing angles than a Lambertian wall, hence `f = sqrt(cos)`.

use crate::camera::CameraBatch;
use burn::tensor::Tensor;

/// Exponent that undoes the tone curve of a recorder, as in sRGB on average.
const GAMMA: f64 = 2.2;

/// Exponent of the cosine, between 1 (Lambert) and 0 (a glowing wall).
const COSINE_POWER: f64 = 0.5;

/// Radiance below which a pixel is black level and noise, as a share of white.
const BLACK: f64 = 2e-3;

/// Smallest squared cosine: 1.4 degrees off grazing.
const GRAZING: f64 = 6e-4;

/// Keeps squared lengths away from zero.
const TINY: f64 = 1e-12;

/// Mean difference, in logarithm of depth, between a depth map and what its picture's brightness says: 0.1 is about
/// 10 %. Shapes are those of [`expected_log_distance`] and [`distance_disagreement`], which it joins.
///
/// Zero for pictures of less than 3 pixels in width or height.
pub fn light_disagreement(
    depth: Tensor<4>,
    image: Tensor<4>,
    usable: Option<Tensor<4>>,
    cameras: &CameraBatch,
) -> Tensor<1> {
    let [_, _, height, width] = depth.dims();
    if height < 3 || width < 3 {
        return depth.zeros_like().mean();
    }
    let expected = expected_log_distance(depth.clone(), image, cameras);
    distance_disagreement(depth, expected, usable, cameras)
}

/// Logarithm of the distance along each ray that the brightness says, `(log f(cos) - log L) / 2`, up to one number per
/// picture.
///
/// Normals come from neighbouring pixels of `depth` and have no gradient: otherwise rough walls would explain dark
/// pixels as well as far ones do.
///
/// # Shapes
/// - `depth`: `[batch, 1, height, width]` along the axis of `cameras`, any unit; at least 3 pixels each way
/// - `image`: `[batch, 3, height, width]`, RGB in [-1, 1]
/// - returns: `[batch, 1, height - 2, width - 2]`: the outermost pixels have no normal
pub fn expected_log_distance(depth: Tensor<4>, image: Tensor<4>, cameras: &CameraBatch) -> Tensor<4> {
    let cosine = squared_cosine(&cameras.backproject(depth.detach())).clamp_min(GRAZING);
    let lit = ((image + 1.0) * 0.5).clamp_min(0.0).powf_scalar(GAMMA).mean_dim(1) + BLACK;
    cosine.log() * (0.25 * COSINE_POWER) - inner(lit).log() * 0.5
}

/// Mean absolute difference between the logarithm of the distance along each ray and the expected one, with its mean
/// over the picture taken out, so that neither the scale of depth nor the exposure counts.
///
/// # Shapes
/// - `depth`: `[batch, 1, height, width]` along the axis of `cameras`, any unit
/// - `expected`: `[batch, 1, height - 2, width - 2]`
/// - `usable`: `[batch, 1, height, width]`, 1 for pixels that count; `None` if all do
pub fn distance_disagreement(
    depth: Tensor<4>,
    expected: Tensor<4>,
    usable: Option<Tensor<4>>,
    cameras: &CameraBatch,
) -> Tensor<1> {
    let seen = cameras.seen().expand(depth.dims());
    let counts = inner(usable.map_or_else(|| seen.clone(), |usable| usable * seen.clone()));
    let squared_distance = cameras.backproject(depth).powi_scalar(2).sum_dim(1);
    let distance = inner(squared_distance).clamp_min(TINY).log() * 0.5;
    let total = counts.clone().sum_dims(&[2, 3]).clamp_min(1.0);
    let average = |map: Tensor<4>| (map * counts.clone()).sum_dims(&[2, 3]) / total.clone();
    let difference = distance - expected;
    let error = (difference.clone() - average(difference)).abs();
    average(error).mean()
}

/// Squared cosine between ray and surface normal at every inner pixel, `[batch, 1, height - 2, width - 2]`.
fn squared_cosine(points: &Tensor<4>) -> Tensor<4> {
    let [_, _, height, width] = points.dims();
    let along = |axis: usize, length: usize| {
        let across = 5 - axis;
        let across_length = points.dims()[across];
        let strip = points.clone().narrow(across, 1, across_length - 2);
        strip.clone().narrow(axis, 2, length - 2) - strip.narrow(axis, 0, length - 2)
    };
    let normal = cross(&along(3, width), &along(2, height));
    let points = inner(points.clone());
    let dot = (normal.clone() * points.clone()).sum_dim(1);
    let squares = |vector: Tensor<4>| vector.powi_scalar(2).sum_dim(1);
    // Scale-free: normals shrink with the square of the depth, points with the depth.
    dot.clone() * dot / (squares(normal) * squares(points)).clamp_min(f64::from(f32::MIN_POSITIVE))
}

/// Cross product over the channels.
fn cross(a: &Tensor<4>, b: &Tensor<4>) -> Tensor<4> {
    let part = |vector: &Tensor<4>, index: usize| vector.clone().narrow(1, index % 3, 1);
    let component = |index: usize| part(a, index + 1) * part(b, index + 2) - part(a, index + 2) * part(b, index + 1);
    Tensor::cat((0..3).map(component).collect(), 1)
}

/// All but the outermost pixels.
fn inner(map: Tensor<4>) -> Tensor<4> {
    let [_, _, height, width] = map.dims();
    map.narrow(2, 1, height - 2).narrow(3, 1, width - 2)
}
