//! Pictures as the networks see them, in training and at work alike.

use burn::tensor::{Device, Tensor, TensorData};
use endoscape_core::{Image, Size};

/// The networks' range, [-1, 1], from 0 to 1.
pub fn network_range(value: f32) -> f32 {
    2.0 * value - 1.0
}

/// One picture as the networks see it, `[3, height, width]`, RGB in [-1, 1].
pub fn network_values(image: &Image) -> Vec<f32> {
    let mut values = Vec::with_capacity(image.rgb().len());
    for channel in 0..3 {
        let plane = image.rgb().chunks_exact(3).map(|rgb| rgb[channel]);
        values.extend(plane.map(|value| network_range(f32::from(value) / 255.0)));
    }
    values
}

/// One picture as a tensor.
///
/// # Shapes
/// - returns: `[1, 3, height, width]`, RGB in [-1, 1]
pub fn network_input(image: &Image, device: &Device) -> Tensor<4> {
    let Size { width, height } = image.size();
    Tensor::from_data(TensorData::new(network_values(image), [1, 3, height, width]), device)
}

/// Whether a device is the processor, where plans run faster than layers.
pub fn is_processor(device: &Device) -> bool {
    *device == Device::flex()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_follow_each_other_and_black_is_minus_one() {
        let image = Image::from_fn(Size::new(2, 1), |x, _| if x == 0 { [0, 51, 255] } else { [255, 102, 0] });
        let input = network_input(&image, &Device::flex());
        assert_eq!(input.dims(), [1, 3, 1, 2]);
        let values: Vec<f32> = input.into_data().iter().collect();
        for (value, expected) in values.into_iter().zip([-1.0, 1.0, -0.6, -0.2, 1.0, -1.0]) {
            assert!((value - expected).abs() < 1e-6, "{value} instead of {expected}");
        }
    }
}
