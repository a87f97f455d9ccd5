//! Poses from KITTI's inertial and satellite unit.
//!
//! The unit's latitude and longitude are laid on a plane by the Mercator projection at the latitude of the first
//! packet, and its roll, pitch and yaw are applied about x, y and z in that order, as A. Geiger et al., "Vision meets
//! robotics: the KITTI dataset" (IJRR 2013) define the frames: x east, y north, z up in the world; x ahead, y left,
//! z up in the unit.

use super::common;
use crate::FramesError;
use endoscape_core::Pose;
use endoscape_core::trajectory::{TextError, numbers, records};
use nalgebra::{Rotation3, Vector3};
use std::path::PathBuf;

/// Radius of the Earth in metres in that projection (WGS 84, equator).
const EARTH_RADIUS_M: f64 = 6_378_137.0;

/// Where the unit was and how it was turned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Packet {
    /// Latitude, radians.
    pub latitude_rad: f64,
    /// Longitude, radians.
    pub longitude_rad: f64,
    /// Height above the sea, metres.
    pub altitude_m: f64,
    /// Roll, pitch and yaw, radians; yaw is 0 towards the east and grows towards the north.
    pub roll_pitch_yaw_rad: [f64; 3],
}

/// Reads one packet: the first six of its numbers on the first line; velocities and accuracies follow them.
///
/// # Errors
/// [`TextError`] if there are fewer than six finite numbers or the latitude is at a pole, where the projection ends.
pub fn parse_packet(text: &str) -> Result<Packet, TextError> {
    let (line, record) =
        records(text).next().ok_or_else(|| TextError { line: 1, reason: "the file is empty".into() })?;
    let n: [f64; 6] = numbers(line, record.split_whitespace().take(6), "latitude longitude altitude roll pitch yaw")?;
    if n[0].abs() > 89.0 {
        return Err(TextError { line, reason: format!("the latitude {} degrees cannot be projected", n[0]) });
    }
    Ok(Packet {
        latitude_rad: n[0].to_radians(),
        longitude_rad: n[1].to_radians(),
        altitude_m: n[2],
        roll_pitch_yaw_rad: [n[3], n[4], n[5]],
    })
}

impl Packet {
    /// Pose of the unit on the plane projected at `scale` (the cosine of the first packet's latitude), metres.
    fn plane_from_imu(&self, scale: f64) -> Pose {
        let east_m = scale * EARTH_RADIUS_M * self.longitude_rad;
        let north_m = scale * EARTH_RADIUS_M * (std::f64::consts::FRAC_PI_4 + 0.5 * self.latitude_rad).tan().ln();
        let [roll, pitch, yaw] = self.roll_pitch_yaw_rad;
        let position = Vector3::new(east_m, north_m, self.altitude_m);
        Pose::from_parts(position.into(), Rotation3::from_euler_angles(roll, pitch, yaw).into())
    }
}

/// Poses of the camera fixed to the unit, by frame number; the world is the camera at the first packet.
///
/// # Errors
/// [`FramesError`] with the first packet that cannot be read.
pub fn world_from_camera(
    packets: &[(usize, PathBuf)],
    camera_from_imu: &Pose,
) -> Result<Vec<(usize, Pose)>, FramesError> {
    let read = |(number, file): &(usize, PathBuf)| {
        let packet = parse_packet(&common::read_text(file)?).map_err(|error| (file.as_path(), error))?;
        Ok((*number, packet))
    };
    let packets = packets.iter().map(read).collect::<Result<Vec<_>, FramesError>>()?;
    let Some((_, first)) = packets.first() else { return Ok(Vec::new()) };
    let scale = first.latitude_rad.cos();
    let imu_from_camera = camera_from_imu.inverse();
    let world_from_plane = (first.plane_from_imu(scale) * imu_from_camera).inverse();
    let pose = |packet: &Packet| world_from_plane * packet.plane_from_imu(scale) * imu_from_camera;
    Ok(packets.iter().map(|(number, packet)| (*number, pose(packet))).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_degree_is_as_long_as_on_the_globe() {
        let packet = |text: &str| parse_packet(text).unwrap();
        let scale = packet("49 8 0 0 0 0").latitude_rad.cos();
        let position = |text: &str| packet(text).plane_from_imu(scale).translation.vector;
        let origin = position("49 8 0 0 0 0");
        let degree_m = EARTH_RADIUS_M * 1_f64.to_radians();
        let north = position("49.001 8 0 0 0 0") - origin;
        let east = position("49 8.001 0 0 0 0") - origin;
        assert!((north.y - 1e-3 * degree_m).abs() < 0.01 && north.x == 0.0);
        assert!((east.x - 1e-3 * degree_m * scale).abs() < 1e-6 && east.y == 0.0);
    }

    #[test]
    fn yaw_turns_ahead_from_east_to_north() {
        let turned = parse_packet(&format!("49 8 0 0 0 {}", std::f64::consts::FRAC_PI_2)).unwrap();
        let ahead = turned.plane_from_imu(1.0).rotation * Vector3::x();
        assert!((ahead - Vector3::y()).norm() < 1e-12);
    }

    proptest! {
        #[test]
        fn any_text_is_answered(text in "[-0-9.e \n]{0,100}") {
            let _ = parse_packet(&text);
        }
    }
}
