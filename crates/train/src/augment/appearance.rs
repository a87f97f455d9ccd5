//! How the same view could have looked: colour, exposure, vignette, motion blur.

use super::planes::Planes;

/// A change of colour shared by all frames of a snippet, because one camera took them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ColourShift {
    /// Factor on everything.
    pub brightness: f32,
    /// Factor on the distance from the mean.
    pub contrast: f32,
    /// Factor on the distance from grey.
    pub saturation: f32,
    /// Factor per channel: the lamp's colour.
    pub balance: [f32; 3],
}

/// Applies a change of colour.
pub fn shift_colour(planes: &mut Planes, shift: &ColourShift) {
    let mean = planes.mean() * shift.brightness;
    planes.map_pixels(|_, _, rgb| {
        let lit = rgb.map(|value| mean + (value * shift.brightness - mean) * shift.contrast);
        let grey = lit.iter().sum::<f32>() / 3.0;
        std::array::from_fn(|channel| (grey + (lit[channel] - grey) * shift.saturation) * shift.balance[channel])
    });
}

/// Multiplies the light by `gain`, as an automatic exposure does between frames.
pub fn expose(planes: &mut Planes, gain: f32) {
    planes.map_pixels(|_, _, rgb| rgb.map(|value| value * gain));
}

/// Darkens towards the corners, where the light falls by the share `strength`.
pub fn vignette(planes: &mut Planes, strength: f32) {
    let size = planes.size();
    let (cx, cy) = (0.5 * (size.width - 1) as f32, 0.5 * (size.height - 1) as f32);
    let corner = (cx * cx + cy * cy).max(1.0);
    planes.map_pixels(|x, y, rgb| {
        let (dx, dy) = (x as f32 - cx, y as f32 - cy);
        rgb.map(|value| value * (1.0 - strength * (dx * dx + dy * dy) / corner))
    });
}

/// Smears along `(dx, dy)` pixels, as a moving camera does while the shutter is open.
pub fn motion_blur(planes: &mut Planes, [dx, dy]: [f32; 2]) {
    const TAPS: usize = 5;
    let sharp = planes.clone();
    planes.map_pixels(|x, y, _| {
        let mut sum = [0.0; 3];
        for tap in 0..TAPS {
            let along = tap as f32 / (TAPS - 1) as f32 - 0.5;
            let colour = sharp.sample(x as f32 + along * dx, y as f32 + along * dy);
            sum = std::array::from_fn(|channel| sum[channel] + colour[channel] / TAPS as f32);
        }
        sum
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use endoscape_core::Size;

    fn ramp() -> Planes {
        Planes::from_fn(Size::new(16, 12), |x, y| [0.2 + 0.02 * x as f32, 0.3 + 0.01 * y as f32, 0.25])
    }

    #[test]
    fn neutral_changes_change_nothing() {
        let neutral = ColourShift { brightness: 1.0, contrast: 1.0, saturation: 1.0, balance: [1.0; 3] };
        let mut planes = ramp();
        shift_colour(&mut planes, &neutral);
        expose(&mut planes, 1.0);
        vignette(&mut planes, 0.0);
        motion_blur(&mut planes, [0.0, 0.0]);
        assert!(planes.values().iter().zip(ramp().values()).all(|(a, b)| (a - b).abs() < 1e-6));
    }

    #[test]
    fn values_stay_between_black_and_white() {
        let wild = ColourShift { brightness: 3.0, contrast: 4.0, saturation: 5.0, balance: [0.0, 2.0, 1.0] };
        let mut planes = ramp();
        shift_colour(&mut planes, &wild);
        expose(&mut planes, 9.0);
        assert!(planes.values().iter().all(|value| (0.0..=1.0).contains(value)));
    }

    #[test]
    fn corners_darken_and_the_middle_does_not() {
        let mut planes = Planes::from_fn(Size::new(17, 13), |_, _| [0.8; 3]);
        vignette(&mut planes, 0.5);
        assert!((planes.sample(8.0, 6.0)[0] - 0.8).abs() < 1e-6);
        assert!((planes.sample(0.0, 0.0)[0] - 0.4).abs() < 1e-6);
    }

    #[test]
    fn blur_along_a_ramp_keeps_its_middle() {
        let mut planes = ramp();
        motion_blur(&mut planes, [4.0, 0.0]);
        assert!((planes.sample(8.0, 6.0)[0] - ramp().sample(8.0, 6.0)[0]).abs() < 1e-6);
        assert!(planes.sample(0.0, 0.0)[0] > ramp().sample(0.0, 0.0)[0]);
    }
}
