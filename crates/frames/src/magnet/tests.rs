use super::*;
use endoscape_core::Pose;
use endoscape_core::magnetic::{HallArray, Magnet, to_csv};

fn rig() -> MagneticRig {
    let magnet = Magnet { moment_a_m2: 0.2, position_in_camera_m: [0.0; 3], axis_in_camera: [0.0, 0.0, 1.0] };
    MagneticRig::new(magnet, HallArray::grid(2, 2, 0.03, &HallArray::TRIAXIAL, 5e-7), Pose::identity()).unwrap()
}

fn write_folder(readings: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join(RIG_FILE), rig_to_toml(&rig()).unwrap()).unwrap();
    std::fs::write(folder.path().join(READINGS_FILE), readings).unwrap();
    folder
}

#[test]
fn what_is_written_is_read_back() {
    let field = rig().field_tesla(&Pose::translation(0.01, 0.0, 0.1));
    let reading = MagneticReading { index: 0, time_s: 0.5, field_tesla: field.into_iter().map(Some).collect() };
    let folder = write_folder(&to_csv(std::slice::from_ref(&reading)));
    assert_eq!(read(folder.path()).unwrap(), Some((rig(), vec![reading])));
}

#[test]
fn a_folder_without_a_magnet_has_none() {
    assert_eq!(read(tempfile::tempdir().unwrap().path()).unwrap(), None);
}

#[test]
fn faults_name_file_and_line() {
    let folder = write_folder("index,time_s\n0,0.0,1\n");
    let fault = read(folder.path()).unwrap_err().to_string();
    assert!(fault.contains("magnet.csv, line 2: found 3 columns"), "{fault}");
    std::fs::write(folder.path().join(RIG_FILE), "[magnet]\nmoment_a_m2 = -1.0\n").unwrap();
    let fault = read(folder.path()).unwrap_err().to_string();
    assert!(fault.contains("magnet.toml"), "{fault}");
    std::fs::remove_file(folder.path().join(RIG_FILE)).unwrap();
    let fault = read(folder.path()).unwrap_err().to_string();
    assert!(fault.contains("magnet.toml"), "{fault}");
}
