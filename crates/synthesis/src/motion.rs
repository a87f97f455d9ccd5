//! Motion vectors of a network to rigid transforms.
//!
//! A motion vector is `[tx ty tz, r1 r2 r3]`: a translation in the unit of depth, then three rotation parameters. The
//! transform maps points of the target camera to the source camera, `p_source = R p_target + t`. Every map is smooth
//! at zero motion, where training starts.

use burn::tensor::Tensor;
pub use endoscape_core::Rotation;

/// Rigid transforms from motion vectors.
///
/// # Shapes
/// - `motion`: `[batch, 6]`, `tx ty tz` in the unit of depth, then the parameters of `rotation`
/// - returns: `[batch, 3, 4]`, the matrix `[R | t]` from the target's to the source's camera frame
pub fn source_from_target(motion: Tensor<2>, rotation: Rotation) -> Tensor<3> {
    let translation = motion.clone().narrow(1, 0, 3).unsqueeze_dim(2);
    let parameters = motion.narrow(1, 3, 3);
    let rotation = match rotation {
        Rotation::Euler => rotation_from_euler(parameters),
        Rotation::Quaternion => rotation_from_quaternion(parameters),
        Rotation::AxisAngle => rotation_from_axis_angle(parameters),
    };
    Tensor::cat(vec![rotation, translation], 2)
}

/// `R = Rx(a) Ry(b) Rz(c)`, multiplied out.
///
/// # Shapes
/// - `angles`: `[batch, 3]`, radians
/// - returns: `[batch, 3, 3]`
pub fn rotation_from_euler(angles: Tensor<2>) -> Tensor<3> {
    let [cx, cy, cz] = columns(&angles.clone().cos());
    let [sx, sy, sz] = columns(&angles.sin());
    let (sx_sy, cx_sy) = (sx.clone() * sy.clone(), cx.clone() * sy.clone());
    matrix([
        cy.clone() * cz.clone(),
        -(cy.clone() * sz.clone()),
        sy,
        cx.clone() * sz.clone() + sx_sy.clone() * cz.clone(),
        cx.clone() * cz.clone() - sx_sy * sz.clone(),
        -(sx.clone() * cy.clone()),
        sx.clone() * sz.clone() - cx_sy.clone() * cz.clone(),
        sx * cz + cx_sy * sz,
        cx * cy,
    ])
}

/// Rotation of the unit quaternion `(1, x, y, z) / |(1, x, y, z)|`.
///
/// # Shapes
/// - `vector`: `[batch, 3]`
/// - returns: `[batch, 3, 3]`
pub fn rotation_from_quaternion(vector: Tensor<2>) -> Tensor<3> {
    let norm = (vector.clone().square().sum_dim(1) + 1.0).sqrt();
    let w = norm.clone().recip();
    let [x, y, z] = columns(&(vector / norm));
    let twice = |a: &Tensor<2>, b: &Tensor<2>| a.clone() * b.clone() * 2.0;
    let diagonal = |a: &Tensor<2>, b: &Tensor<2>| -(twice(a, a) + twice(b, b)) + 1.0;
    matrix([
        diagonal(&y, &z),
        twice(&x, &y) - twice(&w, &z),
        twice(&x, &z) + twice(&w, &y),
        twice(&x, &y) + twice(&w, &z),
        diagonal(&x, &z),
        twice(&y, &z) - twice(&w, &x),
        twice(&x, &z) - twice(&w, &y),
        twice(&y, &z) + twice(&w, &x),
        diagonal(&x, &y),
    ])
}

/// Rodrigues' formula `R = I + A [w] + B [w]^2` with `A = sin(t) / t`, `B = (1 - cos(t)) / t^2`, `t = |w|`.
///
/// # Shapes
/// - `vector`: `[batch, 3]`, axis times angle in radians
/// - returns: `[batch, 3, 3]`
pub fn rotation_from_axis_angle(vector: Tensor<2>) -> Tensor<3> {
    let [batch, _] = vector.dims();
    let [x, y, z] = columns(&vector);
    let (a, b) = rodrigues_coefficients(vector.square().sum_dim(1));
    let zero = x.zeros_like();
    let cross = matrix([zero.clone(), -z.clone(), y.clone(), z, zero.clone(), -x.clone(), -y, x, zero]);
    let identity = Tensor::<2>::eye(3, &cross.device()).cast(cross.dtype()).unsqueeze::<3>();
    let scaled = |coefficient: Tensor<2>, matrix: Tensor<3>| coefficient.reshape([batch, 1, 1]) * matrix;
    scaled(a, cross.clone()) + scaled(b, cross.clone().matmul(cross)) + identity
}

/// `sin(t) / t` and `(1 - cos(t)) / t^2` of `t^2`, by their series where the quotients lose digits and gradients.
fn rodrigues_coefficients(t2: Tensor<2>) -> (Tensor<2>, Tensor<2>) {
    // At t^2 = 0.01 the first term left out of either series is below 1e-13.
    let small = t2.clone().lower_scalar(0.01);
    let series = |c: [f64; 4]| ((t2.clone() * c[3] + c[2]) * t2.clone() + c[1]) * t2.clone() + c[0];
    let a_series = series([1.0, -1.0 / 6.0, 1.0 / 120.0, -1.0 / 5040.0]);
    let b_series = series([0.5, -1.0 / 24.0, 1.0 / 720.0, -1.0 / 40320.0]);
    // The branch not taken must stay finite too, or its zero gradient turns into NaN.
    let large = t2.mask_fill(small.clone(), 1.0);
    let t = large.clone().sqrt();
    let a = t.clone().sin() / t.clone();
    let b = (-t.cos() + 1.0) / large;
    (a.mask_where(small.clone(), a_series), b.mask_where(small, b_series))
}

/// The three columns of `[batch, 3]`, each `[batch, 1]`.
fn columns(vectors: &Tensor<2>) -> [Tensor<2>; 3] {
    [0, 1, 2].map(|column| vectors.clone().narrow(1, column, 1))
}

/// `[batch, 3, 3]` from nine entries `[batch, 1]`, row after row.
fn matrix(entries: [Tensor<2>; 9]) -> Tensor<3> {
    let [batch, _] = entries[0].dims();
    Tensor::cat(Vec::from(entries), 1).reshape([batch, 3, 3])
}
