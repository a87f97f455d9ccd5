use super::*;
use endoscape_core::camera::{KannalaBrandt, RadialTangential};

fn camera(text: &str) -> Camera {
    parse(text).unwrap().camera(Some(Size::new(640, 480))).unwrap()
}

fn pinhole(text: &str) -> Intrinsics {
    match camera(text).model() {
        CameraModel::Pinhole(model) => model.intrinsics,
        other => panic!("{other:?}"),
    }
}

fn radial(text: &str) -> RadialTangential {
    match camera(text).model() {
        CameraModel::RadialTangential(model) => *model,
        other => panic!("{other:?}"),
    }
}

fn fisheye(text: &str) -> KannalaBrandt {
    match camera(text).model() {
        CameraModel::KannalaBrandt(model) => *model,
        other => panic!("{other:?}"),
    }
}

fn refusal(text: &str) -> String {
    parse(text).and_then(|calibration| calibration.camera(Some(Size::new(640, 480)))).unwrap_err().reason
}

const OPENCV: &str = "%YAML:1.0
---
image_width: 1280
image_height: 1024
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 1035.3, 0., 596.9, 0.,
       1035.0, 520.4, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ -5.9e-04, 2.6e-03, 1.1e-04, -3.5e-05, -6.8e-03 ]
";

#[test]
fn our_own_file_reads_back_the_same() {
    let model = KannalaBrandt { intrinsics: pinhole("300 301 320 240"), k1: 0.1, k2: 0.0, k3: -0.01, k4: 0.0 };
    let camera = Camera::new(Size::new(640, 480), model.into()).unwrap();
    assert_eq!(parse(&toml::to_string(&camera).unwrap()), Ok(camera.into()));
    assert_eq!(parse(&serde_json::to_string(&camera).unwrap()), Ok(camera.into()));
}

#[test]
fn opencv_and_ros_yaml() {
    let camera = camera(OPENCV);
    let model = radial(OPENCV);
    assert_eq!(camera.size(), Size::new(1280, 1024));
    assert_eq!((model.intrinsics.fx, model.intrinsics.cy, model.p2, model.k3), (1035.3, 520.4, -3.5e-5, -6.8e-3));
    let fisheye_text =
        OPENCV.replace("image_width", "distortion_model: equidistant\nimage_width").replace(", -6.8e-03", "");
    assert_eq!(fisheye(&fisheye_text).k4, -3.5e-5);
}

#[test]
fn the_left_camera_of_a_stereo_calibration() {
    let text = "%YAML:1.0\nM1: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 10., 0., 5., 0., 11., 6., 0., 0., 1. ]\n\
                D1: !!opencv-matrix\n   rows: 1\n   cols: 2\n   dt: d\n   data: [ 0.1, 0. ]\n\
                M2: !!opencv-matrix\n   data: [ 90., 0., 5., 0., 11., 6., 0., 0., 1. ]\n";
    assert_eq!((radial(text).intrinsics.fx, radial(text).k1), (10.0, 0.1));
    assert!(parse(text).unwrap().camera(None).unwrap_err().reason.contains("does not state the picture size"));
}

#[test]
fn opencv_xml() {
    let text = "<?xml version=\"1.0\"?>\n<opencv_storage>\n<image_width>32</image_width><image_height>24</image_height>\n\
                <camera_matrix type_id=\"opencv-matrix\"><rows>3</rows><cols>3</cols><dt>d</dt><data>\n 10. 0. 5. 0. 11. 6.\n 0. 0. 1.\
                </data></camera_matrix></opencv_storage>";
    assert_eq!((pinhole(text).fy, camera(text).size()), (11.0, Size::new(32, 24)));
}

#[test]
fn kalibr_and_euroc_yaml() {
    let text = "cam0:\n  camera_model: pinhole\n  distortion_model: equidistant\n  distortion_coeffs: [0.1, 0.2, 0.3, 0.4]\n  \
                intrinsics: [458.6, 457.3, 367.2, 248.4]\n  resolution: [752, 480]\ncam1:\n  intrinsics: [1, 1, 1, 1]\n";
    assert_eq!((fisheye(text).k2, fisheye(text).intrinsics.fx, camera(text).size().width), (0.2, 458.6, 752));
    let text = text.replace("equidistant", "radial-tangential");
    assert_eq!((radial(&text).p1, radial(&text).k3), (0.3, 0.0));
    let text = text.replace("radial-tangential", "fov");
    assert!(refusal(&text).starts_with("names the lens model `fov`, which is not supported"));
}

#[test]
fn orb_slam_settings() {
    let text = "%YAML:1.0\nCamera.type: \"PinHole\"\nCamera.fx: 500.0\nCamera.fy: 501.0\nCamera.cx: 320.0\nCamera.cy: 240.0\n\
                Camera.k1: 0.01\nCamera.width: 640\nCamera.height: 480\n";
    assert_eq!((radial(text).k1, radial(text).intrinsics.fy), (0.01, 501.0));
}

#[test]
fn kitti_files() {
    let text = "P0: 1 0 9 0 0 1 9 0 0 0 1 0\nP2: 718.856 0 607.1928 45.38 0 718.856 185.2157 -0.11 0 0 1 0.003\n";
    assert_eq!((pinhole(text).fx, pinhole(text).cy), (718.856, 185.2157));
    let text = "calib_time: 09-Jan-2012 13:57:47\nS_rect_02: 1.242000e+03 3.750000e+02\n\
                P_rect_02: 7.215377e+02 0 6.095593e+02 44.8 0 7.215377e+02 1.728540e+02 0.2 0 0 1 0.003\n";
    assert_eq!((pinhole(text).cx, camera(text).size()), (609.5593, Size::new(1242, 375)));
}

#[test]
fn calibu_xml() {
    let text = "<rig>\n<camera>\n<camera_model name=\"\" type=\"calibu_fu_fv_u0_v0_kb4\">\n<width> 1440 </width><height> 1080 </height>\n\
                <params> [ 717.2; 717.4; 735.3; 552.7; -0.1389; -0.0012; 0.0018; -0.0001 ] </params>\n</camera_model></camera></rig>";
    assert_eq!((fisheye(text).intrinsics.cx, fisheye(text).k1, camera(text).size().height), (735.3, -0.1389, 1080));
    let error = parse(&text.replace("kb4", "w")).unwrap_err();
    assert_eq!(error.line, Some(3));
    assert!(error.reason.contains("`calibu_fu_fv_u0_v0_w` with 8 parameters"), "{error}");
}

#[test]
fn nerfstudio_json_counts_from_the_corner() {
    let text = r#"{"camera_model": "OPENCV", "fl_x": 400.0, "fl_y": 401.0, "cx": 320.0, "cy": 240.0, "w": 640, "h": 480, "k1": 0.1, "frames": []}"#;
    assert_eq!((radial(text).intrinsics.cx, radial(text).k1), (319.5, 0.1));
    assert_eq!(fisheye(&text.replace("OPENCV", "OPENCV_FISHEYE")).k1, 0.1);
    assert_eq!(pinhole(r#"{"fx": 4, "fy": 5, "cx": 6, "cy": 7}"#).cx, 6.0);
}

#[test]
fn matrices_in_rows_and_in_columns() {
    assert_eq!(pinhole("156.0,0,178.5,0,155.7,181.8,0,0,1").cx, 178.5);
    assert_eq!(pinhole("156 0 0\n2 155.7 0\n178.5 181.8 1\n").skew, 2.0);
    assert_eq!(pinhole("# K\n[[10, 0, 5], [0, 11, 6], [0, 0, 1]]").fy, 11.0);
    assert_eq!(pinhole("10 0 5 0\n0 11 6 0\n0 0 1 0\n").cy, 6.0);
    assert!(refusal("1 2 3 4 5 6 7 8 9").contains("no camera matrix"));
    assert!(refusal("1 2 3").contains("holds 3 numbers"));
}

#[test]
fn what_is_no_camera_is_refused_in_a_sentence() {
    assert_eq!(refusal("  \n"), "is empty where a camera was expected");
    assert_eq!(refusal("0 300 320 240"), "camera parameter fx is 0, but it must be above zero");
    assert_eq!(parse("300 nan\n320 240").unwrap_err().line, Some(1));
    assert!(refusal(&OPENCV.replace("1035.3", ".nan")).contains("where a finite number was expected"));
    assert!(refusal("a: b\n").starts_with("names no focal length"));
    assert_eq!(parse("a: [1, 2\nb: }\n").unwrap_err().line, Some(2));
    assert_eq!(parse("model = \"pinhole\"\nwidth = \n").unwrap_err().line, Some(2));
    assert_eq!(parse("{\n\"a\": }").unwrap_err().line, Some(2));
    assert_eq!(parse("<a>\n</b>").unwrap_err().line, Some(2));
}

#[test]
fn deep_and_repeating_files_stay_cheap() {
    for text in ["[".repeat(100_000), "{\"a\":".repeat(100_000), "- ".repeat(100_000), "a: &a [x]\nb: *a\n".into()] {
        assert!(parse(&text).is_err());
    }
    assert!(parse(&"<a>".repeat(100_000)).is_err());
    assert!(parse(&"x: [1]\n".repeat(20_000)).unwrap_err().reason.contains("more than"));
}

#[test]
fn errors_name_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("camera.txt");
    std::fs::write(&path, "0 300 320 240").unwrap();
    let error = read_camera(&path, Some(Size::new(640, 480))).unwrap_err().to_string();
    assert!(error.contains("camera.txt: camera parameter fx is 0"), "{error}");
    assert!(matches!(read_camera(&folder.path().join("none"), None), Err(FramesError::Missing { .. })));
}
