//! What endoscopes show beside the static scene: highlights, debris and instruments, tissue that gives way.

use super::planes::Planes;
use std::f32::consts::TAU;

/// A disc with a soft rim, in shares of the picture's width from its upper left corner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Blob {
    /// Centre.
    pub centre: [f32; 2],
    /// Half axes.
    pub radii: [f32; 2],
    /// Turn of the first axis, radians.
    pub turn_rad: f32,
}

impl Blob {
    /// How much of a pixel the blob covers, 0 to 1, falling from the middle (highlights) or at the rim (`sharp`).
    fn cover(&self, x: usize, y: usize, width: usize, sharp: bool) -> f32 {
        let (dx, dy) = (x as f32 / width as f32 - self.centre[0], y as f32 / width as f32 - self.centre[1]);
        let (sin, cos) = self.turn_rad.sin_cos();
        let (u, v) = ((cos * dx + sin * dy) / self.radii[0], (cos * dy - sin * dx) / self.radii[1]);
        let r2 = u * u + v * v;
        if sharp { ((1.2 - r2) / 0.4).clamp(0.0, 1.0) } else { (-1.5 * r2).exp() }
    }
}

/// Adds white highlights.
pub fn add_speculars(planes: &mut Planes, blobs: &[Blob]) {
    let width = planes.size().width;
    planes.map_pixels(|x, y, rgb| {
        let glow: f32 = blobs.iter().map(|blob| blob.cover(x, y, width, false)).sum();
        rgb.map(|value| value + 1.2 * glow)
    });
}

/// Hides a part behind something of one colour.
pub fn occlude(planes: &mut Planes, blob: &Blob, colour: [f32; 3]) {
    let width = planes.size().width;
    planes.map_pixels(|x, y, rgb| {
        let cover = blob.cover(x, y, width, true);
        std::array::from_fn(|channel| rgb[channel] * (1.0 - cover) + colour[channel] * cover)
    });
}

/// A smooth deformation: one wave along each axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Deformation {
    /// Largest displacement as a share of the width.
    pub amplitude: f32,
    /// Waves over the picture's width.
    pub waves: f32,
    /// Where each wave starts, radians.
    pub phases_rad: [f32; 2],
}

/// Moves the picture as soft tissue moves, by nobody's camera.
pub fn deform(planes: &mut Planes, deformation: &Deformation) {
    let still = planes.clone();
    let width = planes.size().width as f32;
    let Deformation { amplitude, waves, phases_rad: [a, b] } = *deformation;
    planes.map_pixels(|x, y, _| {
        let (x, y) = (x as f32, y as f32);
        let wave = |along: f32, phase: f32| amplitude * width * (TAU * waves * along / width + phase).sin();
        still.sample(x + wave(y, a), y + wave(x, b))
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use endoscape_core::Size;

    fn tissue() -> Planes {
        Planes::from_fn(Size::new(32, 24), |x, y| [0.5 + 0.01 * x as f32, 0.2 + 0.01 * y as f32, 0.2])
    }

    const BLOB: Blob = Blob { centre: [0.5, 0.375], radii: [0.1, 0.1], turn_rad: 0.4 };

    #[test]
    fn highlights_are_white_and_local() {
        let mut planes = tissue();
        add_speculars(&mut planes, &[BLOB]);
        assert_eq!(planes.sample(16.0, 12.0), [1.0; 3]);
        assert!((planes.sample(0.0, 0.0)[1] - tissue().sample(0.0, 0.0)[1]).abs() < 1e-3);
    }

    #[test]
    fn occluders_hide_what_is_behind() {
        let mut planes = tissue();
        occlude(&mut planes, &BLOB, [0.1, 0.2, 0.3]);
        assert_eq!(planes.sample(16.0, 12.0), [0.1, 0.2, 0.3]);
        assert_eq!(planes.sample(0.0, 0.0), tissue().sample(0.0, 0.0));
    }

    #[test]
    fn a_deformation_moves_by_at_most_its_amplitude() {
        let mut planes = tissue();
        deform(&mut planes, &Deformation { amplitude: 0.05, waves: 1.0, phases_rad: [0.3, 1.0] });
        let moved = (planes.sample(16.0, 12.0)[0] - tissue().sample(16.0, 12.0)[0]).abs() / 0.01;
        assert!(moved > 0.0 && moved <= 0.05 * 32.0 + 1e-3, "moved by {moved} pixels");
        let mut same = tissue();
        deform(&mut same, &Deformation { amplitude: 0.0, waves: 1.0, phases_rad: [0.3, 1.0] });
        assert_eq!(same, tissue());
    }
}
