use super::*;
use crate::{MagneticReading, Pose, se3};
use nalgebra::{Matrix3, Point3, Vector3, Vector6};
use proptest::prelude::*;

fn rig() -> MagneticRig {
    let magnet =
        Magnet { moment_a_m2: 0.2, position_in_camera_m: [0.0, 0.001, -0.01], axis_in_camera: [0.6, 0.0, 0.8] };
    let world_from_array = se3::exp(&Vector6::new(0.1, -0.2, 0.3, 0.4, 0.5, -0.6));
    MagneticRig::new(magnet, HallArray::grid(3, 2, 0.03, &HallArray::TRIAXIAL, 5e-7), world_from_array).unwrap()
}

fn vector(range: std::ops::Range<f64>) -> impl Strategy<Value = Vector3<f64>> {
    prop::array::uniform3(range).prop_map(Vector3::from)
}

#[test]
fn on_and_across_the_axis_the_field_has_its_textbook_values() {
    // 2 mu_0 m / (4 pi r^3) along the axis, half of it and reversed across.
    let dipole = Dipole { position_m: Point3::origin(), moment_a_m2: Vector3::new(0.0, 0.0, 0.5) };
    let along = dipole.field_tesla(&Point3::new(0.0, 0.0, 0.1));
    let across = dipole.field_tesla(&Point3::new(0.1, 0.0, 0.0));
    assert!((along - Vector3::new(0.0, 0.0, 1e-4)).amax() < 1e-18);
    assert!((across - Vector3::new(0.0, 0.0, -5e-5)).amax() < 1e-18);
}

proptest! {
    #[test]
    fn the_gradient_is_the_derivative_of_the_field(at in vector(0.03..0.2), m in vector(-1.0..1.0)) {
        let dipole = Dipole { position_m: Point3::new(0.001, -0.002, 0.003), moment_a_m2: m };
        let at = Point3::from(at);
        let h = 1e-6;
        let column = |axis: usize| {
            let step = Vector3::ith(axis, h);
            (dipole.field_tesla(&(at + step)) - dipole.field_tesla(&(at - step))) / (2.0 * h)
        };
        let numeric = Matrix3::from_columns(&[column(0), column(1), column(2)]);
        let gradient = dipole.field_gradient(&at);
        prop_assert!((gradient - numeric).amax() < 1e-6 * (gradient.amax() + 1e-9));
        prop_assert!(gradient.trace().abs() < 1e-12 * gradient.amax() + 1e-18);
    }

    #[test]
    fn the_field_turns_with_the_capsule_and_the_array(
        v in vector(-0.1..0.1), w in vector(-1.0..1.0), camera in vector(-0.05..0.05),
    ) {
        // Moving world, array and capsule together changes no reading.
        let moved = se3::exp(&Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z));
        let rig = rig();
        let world_from_camera = Pose::translation(camera.x, camera.y, 0.5);
        let elsewhere = MagneticRig::new(*rig.magnet(), rig.array().clone(), moved * rig.world_from_array()).unwrap();
        let here = rig.field_tesla(&world_from_camera);
        for (a, b) in here.iter().zip(elsewhere.field_tesla(&(moved * world_from_camera))) {
            prop_assert!((a - b).amax() < 1e-12 * (a.amax() + 1e-6));
        }
    }

    #[test]
    fn readings_survive_their_file(values in prop::collection::vec(vector(-1e-3..1e-3), 4), time_s in 0.0..1e6_f64) {
        let partial = Vector3::new(1e-6, f64::INFINITY, -2e-6);
        let mut field_tesla: Vec<_> = values.into_iter().map(Some).collect();
        field_tesla.extend([None, Some(partial)]);
        let reading = MagneticReading { index: 7, time_s, field_tesla };
        let text = to_csv(std::slice::from_ref(&reading));
        let again = parse_csv(&text, 6).unwrap();
        prop_assert_eq!(&again[0].field_tesla[..5], &reading.field_tesla[..5]);
        let again = again[0].field_tesla[5].unwrap();
        prop_assert!(again.x == partial.x && again.y.is_nan() && again.z == partial.z);
    }
}

#[test]
fn a_turn_about_the_magnets_axis_changes_nothing() {
    let rig = rig();
    let centre = Pose::translation(0.0, 0.001, -0.01);
    let turn = nalgebra::UnitQuaternion::from_axis_angle(&rig.axis_in_camera(), 1.0);
    let world_from_camera = se3::exp(&Vector6::new(0.1, 0.0, 0.5, 0.1, 0.2, 0.3));
    let turned = world_from_camera * centre * turn * centre.inverse();
    for (a, b) in rig.field_tesla(&world_from_camera).iter().zip(rig.field_tesla(&turned)) {
        assert!((a - b).amax() < 1e-15);
    }
}

#[test]
fn a_rig_survives_its_file() {
    let rig = rig();
    let again: MagneticRig = serde_json::from_str(&serde_json::to_string(&rig).unwrap()).unwrap();
    // serde_json rounds the last digit.
    assert!((again.world_from_array().to_homogeneous() - rig.world_from_array().to_homogeneous()).amax() < 1e-15);
    assert_eq!((again.magnet(), again.array()), (rig.magnet(), rig.array()));
}

#[test]
fn numbers_that_are_no_rig_are_refused_by_name() {
    let rig = rig();
    let (magnet, array) = (*rig.magnet(), rig.array().clone());
    let weak = Magnet { moment_a_m2: 0.0, ..magnet };
    let error = MagneticRig::new(weak, array.clone(), Pose::identity()).unwrap_err();
    assert_eq!(error, MagneticError::NotPositive { name: "magnet.moment_a_m2", value: 0.0 });
    let long = Magnet { axis_in_camera: [0.0, 0.0, 2.0], ..magnet };
    assert!(matches!(MagneticRig::new(long, array.clone(), Pose::identity()), Err(MagneticError::NotUnit { .. })));
    let single = HallArray { positions_m: vec![[0.0; 3]], ..array.clone() };
    let error = MagneticRig::new(magnet, single, Pose::identity()).unwrap_err();
    assert_eq!(error, MagneticError::TooFew { measurements: 3 });
    let half = HallArray { bias_tesla: vec![[0.0; 3]], ..array.clone() };
    let error = MagneticRig::new(magnet, half, Pose::identity()).unwrap_err();
    assert_eq!(error, MagneticError::Unpaired { sensors: 6, biases: 1 });
    let nowhere = HallArray { positions_m: vec![[f64::NAN; 3]; 9], ..array };
    assert!(matches!(MagneticRig::new(magnet, nowhere, Pose::identity()), Err(MagneticError::NotFinite { .. })));
}

#[test]
fn faults_of_a_file_of_readings_name_their_line() {
    let fault = |text: &str| parse_csv(text, 1).unwrap_err();
    assert_eq!(fault("index,time_s,x,y,z\n0,0.0,1,2\n").line, 2);
    assert!(fault("0,0.0,1,2,weak\n").reason.contains("`weak` is no number"));
    assert_eq!(fault("0,0.0,1,2,3\n1,0.0,1,2,3\n").line, 2);
    assert!(fault("0,nan,1,2,3\n").reason.contains("time"));
    assert!(fault("zero,0,1,2,3\n").reason.contains("no index"));
}
