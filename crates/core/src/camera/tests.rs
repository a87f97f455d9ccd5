//! Laws every camera model obeys, and values worked out by hand or with OpenCV.

use super::*;
use proptest::prelude::*;

const SIZE: Size = Size { width: 1350, height: 1080 };

fn intrinsics() -> Intrinsics {
    Intrinsics { fx: 767.0, fy: 765.0, cx: 679.0, cy: 543.5, skew: 0.0 }
}

/// The calibration C3VD publishes for its colonoscope (DATASETS: Scaramuzza's model).
pub(crate) fn c3vd() -> Omnidirectional {
    Omnidirectional {
        cx: 678.544839263292,
        cy: 542.975887548343,
        polynomial: [769.243600037458, 0.0, -8.12770624150226e-4, 6.25674244578925e-7, -1.1966218214428e-9],
        stretch: [[0.99998688, 0.00288274], [-0.00296317, 1.0]],
    }
}

fn cameras() -> Vec<Camera> {
    let models: Vec<CameraModel> = vec![
        Pinhole { intrinsics: intrinsics() }.into(),
        Pinhole { intrinsics: Intrinsics { skew: 5.6, ..intrinsics() } }.into(),
        RadialTangential::from_opencv(intrinsics(), &[-0.2486, 0.0614, 0.001, -0.0007]).into(),
        RadialTangential::from_opencv(intrinsics(), &[0.2533, -0.2085, 0.0, 0.0, 0.05]).into(),
        RadialTangential::from_opencv(intrinsics(), &[0.4, 0.1, 1e-4, 2e-4, 0.01, 0.7, 0.2, 0.03]).into(),
        KannalaBrandt { intrinsics: intrinsics(), k1: -0.139, k2: -2.3e-3, k3: 2.1e-3, k4: -1.2e-4 }.into(),
        c3vd().into(),
        Unified { intrinsics: intrinsics(), xi: 0.9, k1: 0.0, k2: 0.0 }.into(),
        Unified { intrinsics: intrinsics(), xi: 1.4, k1: -0.1, k2: 0.02 }.into(),
    ];
    models.into_iter().map(|model| Camera::new(SIZE, model).unwrap()).collect()
}

proptest! {
    #[test]
    fn project_undoes_unproject(u in 0.0..1349.0, v in 0.0..1079.0) {
        for camera in cameras() {
            let pixel = Point2::new(u, v);
            if let Some(direction) = camera.unproject(&pixel) {
                prop_assert!((direction.norm() - 1.0).abs() < 1e-12);
                let again = camera.project(&Point3::from(direction * 0.03));
                let again = again.ok_or_else(|| TestCaseError::fail(format!("{camera:?} lost {pixel}")))?;
                prop_assert!((again - pixel).norm() < 1e-6, "{camera:?}: {pixel} became {again}");
            }
        }
    }

    #[test]
    fn unproject_undoes_project(x in -3.0..3.0, y in -3.0..3.0, z in -0.5..1.0, scale in 1e-3..1e3) {
        for camera in cameras() {
            let point = Point3::new(x, y, z) * scale;
            if let Some(pixel) = camera.project(&point) {
                // Only what lies near the picture matters; far outside it a polynomial is ill-conditioned.
                if (pixel - Point2::new(675.0, 540.0)).norm() > 1500.0 { continue; }
                let direction = camera.unproject(&pixel)
                    .ok_or_else(|| TestCaseError::fail(format!("{camera:?} has no ray at {pixel}")))?;
                prop_assert!((direction - point.coords.normalize()).norm() < 1e-7, "{camera:?} at {pixel}");
            }
        }
    }

    #[test]
    fn projection_does_not_see_distance(x in -1.0..1.0, y in -1.0..1.0, scale in 1e-3..1e3) {
        for camera in cameras() {
            let (near, far) = (Point3::new(x, y, 1.0), Point3::new(x, y, 1.0) * scale);
            match (camera.project(&near), camera.project(&far)) {
                (Some(near), Some(far)) => prop_assert!((near - far).norm() < 1e-8),
                (near, far) => prop_assert_eq!(near.is_some(), far.is_some()),
            }
        }
    }

    #[test]
    fn derivatives_are_those_of_differences(x in -2.0..2.0, y in -2.0..2.0, z in -0.3..1.0, scale in 1e-2..1e2) {
        for camera in cameras() {
            let point = Point3::new(x, y, z) * scale;
            let h = 1e-5 * point.coords.norm();
            let at = |axis, step: f64| camera.project(&(point + Vector3::ith(axis, step)));
            let Some(derivative) = camera.project_derivative(&point) else { continue };
            for axis in 0..3 {
                let (Some(before), Some(after)) = (at(axis, -h), at(axis, h)) else { continue };
                let difference = (after - before) / (2.0 * h);
                // Near the rim of a model the second derivative grows without bound.
                if derivative.norm() * scale > 1e5 { continue; }
                let error = (derivative.column(axis) - difference).norm() * scale;
                prop_assert!(error < 1e-3 * (1.0 + derivative.norm() * scale), "{camera:?} at {point}: {error}");
            }
        }
    }

    #[test]
    fn resizing_moves_pixel_edges_with_the_picture(x in -0.8..0.8, y in -0.8..0.8, w in 32_usize..2000, h in 32_usize..2000) {
        for camera in cameras() {
            let resized = camera.scaled_to(Size::new(w, h)).unwrap();
            let point = Point3::new(x, y, 1.0);
            if let (Some(a), Some(b)) = (camera.project(&point), resized.project(&point)) {
                let expected_x = (a.x + 0.5) * w as f64 / 1350.0 - 0.5;
                let expected_y = (a.y + 0.5) * h as f64 / 1080.0 - 0.5;
                prop_assert!((b.x - expected_x).abs() < 1e-6 && (b.y - expected_y).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn cropping_shifts_pixels(x in -0.8..0.8, y in -0.8..0.8) {
        let rect = Rect { x: 200, y: 180, size: Size::new(950, 720) };
        for camera in cameras() {
            let cropped = camera.cropped(rect).unwrap();
            let point = Point3::new(x, y, 1.0);
            if let (Some(a), Some(b)) = (camera.project(&point), cropped.project(&point)) {
                prop_assert!((a.x - 200.0 - b.x).abs() < 1e-9 && (a.y - 180.0 - b.y).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn poison_points_have_no_pixel_or_a_finite_one(p in prop::array::uniform3(prop_oneof![
        Just(f64::NAN), Just(f64::INFINITY), Just(f64::NEG_INFINITY), Just(0.0), Just(1e300), Just(-1e-300), -1.0..1.0,
    ])) {
        for camera in cameras() {
            if let Some(pixel) = camera.project(&Point3::from(p)) {
                prop_assert!(pixel.x.is_finite() && pixel.y.is_finite());
            }
            if let Some(direction) = camera.unproject(&Point2::new(p[0], p[1])) {
                prop_assert!((direction.norm() - 1.0).abs() < 1e-9);
            }
        }
    }
}

#[test]
fn values_by_opencv() {
    // cv2.projectPoints([0.3, -0.2, 1.0]) and cv2.fisheye.projectPoints with the parameters of `cameras()`.
    let expected =
        [(2, (901.643914766, 395.51080202)), (4, (900.574309047, 396.192178124)), (5, (896.158719998, 399.105023209))];
    for (index, (u, v)) in expected {
        let pixel = cameras()[index].project(&Point3::new(0.3, -0.2, 1.0)).unwrap();
        assert!((pixel.x - u).abs() < 1e-6 && (pixel.y - v).abs() < 1e-6, "{index}: {pixel}");
    }
}

#[test]
fn a_barrel_polynomial_stops_where_it_turns_back() {
    // r (1 - 0.2486 r^2 + 0.0614 r^4) has no turning point; with k2 = 0 it turns at r = 1 / sqrt(3 * 0.2486).
    let lens = RadialTangential::from_opencv(intrinsics(), &[-0.2486, 0.0]);
    let camera = Camera::new(SIZE, lens.into()).unwrap();
    let turning = 1.0 / (3.0_f64 * 0.2486).sqrt();
    assert!((camera.domain_rad().tan() - turning).abs() < 1e-3);
    assert!(camera.project(&Point3::new(1.01 * turning, 0.0, 1.0)).is_none());
    assert!(camera.project(&Point3::new(0.99 * turning, 0.0, 1.0)).is_some());
}

#[test]
fn the_field_of_view_makes_its_pinhole() {
    let camera = Camera::from_field_of_view(Size::new(640, 512), 1.2).unwrap();
    assert!((camera.horizontal_field_of_view_rad().unwrap() - 1.2).abs() < 1e-12);
    assert!(matches!(Camera::from_field_of_view(Size::new(640, 512), 3.1), Err(CameraError::FieldOfView { .. })));
}

#[test]
fn nonsense_is_refused() {
    let zero = Pinhole { intrinsics: Intrinsics { fx: 0.0, ..intrinsics() } };
    assert_eq!(Camera::new(SIZE, zero.into()), Err(CameraError::NotPositive { name: "fx", value: 0.0 }));
    let nan = Pinhole { intrinsics: Intrinsics { cy: f64::NAN, ..intrinsics() } };
    assert_eq!(Camera::new(SIZE, nan.into()), Err(CameraError::NotFinite { name: "cy" }));
    let empty = Size::new(0, 10);
    assert_eq!(Camera::new(empty, Pinhole { intrinsics: intrinsics() }.into()), Err(CameraError::Empty(empty)));
}

#[test]
fn camera_files_keep_every_digit() {
    for camera in cameras() {
        let text = serde_json::to_string(&camera).unwrap();
        assert_eq!(serde_json::from_str::<Camera>(&text).unwrap(), camera);
    }
}
