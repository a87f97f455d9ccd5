use super::*;
use endoscape_core::Camera;

fn optics() -> Optics {
    Optics::new(Camera::from_field_of_view(Size::new(32, 24), 1.2).unwrap())
}

fn grey(value: f64) -> Vec<Sample> {
    let sample = Sample {
        depth_m: 0.02,
        distance_m: 0.022,
        diffuse: [value; 3],
        label: 1,
        flow: Some([3.0, 0.0]),
        ..Sample::default()
    };
    vec![sample; 32 * 24]
}

#[test]
fn without_effects_a_value_is_light_times_gain() {
    let mut sensor = Sensor::new(Effects::none(), 1, 0.02);
    let developed = sensor.develop(0, 0.1, &optics(), &grey(1000.0), None).unwrap();
    assert!(developed.image.rgb().iter().all(|byte| *byte == 102));
    assert!(developed.usable.values().iter().all(|usable| *usable));
}

#[test]
fn noise_has_the_deviation_it_should_and_no_bias() {
    let mut sensor = Sensor::new(Effects::none().with(Effect::Noise), 1, 0.02);
    let image = sensor.develop(3, 0.1, &optics(), &grey(1000.0), None).unwrap().image;
    let values: Vec<f64> = image.rgb().iter().map(|byte| f64::from(*byte) / 255.0).collect();
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let deviation = (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt();
    let expected = (0.4 / FULL_WELL + (READ_NOISE / FULL_WELL).powi(2)).sqrt();
    assert!((mean - 0.4).abs() < 1e-3, "{mean}");
    assert!((deviation / expected - 1.0).abs() < 0.1, "{deviation} {expected}");
}

#[test]
fn the_gain_follows_with_a_delay() {
    let mut sensor = Sensor::new(Effects::none().with(Effect::Exposure), 1, 0.02);
    let mut gain = |value: f64| sensor.develop(0, 0.1, &optics(), &grey(value), None).unwrap().gain;
    let before = gain(1000.0);
    let first = gain(2000.0);
    assert!(first < before && first > 0.5 * before);
    let settled = (0..60).map(|_| gain(2000.0)).last().unwrap();
    assert!((settled - 0.5 * before).abs() < 1e-3 * before);
}

#[test]
fn even_light_survives_blur_subsampling_and_compression() {
    let effects = [Effect::Defocus, Effect::MotionBlur, Effect::Chroma, Effect::Jpeg, Effect::Droplets];
    for effect in effects {
        let mut sensor = Sensor::new(Effects::none().with(effect), 1, 0.02);
        let image = sensor.develop(0, 0.1, &optics(), &grey(1000.0), None).unwrap().image;
        let middle = image.get(1, 1).unwrap();
        assert!(middle.iter().all(|byte| (40..=104).contains(byte)), "{effect:?} {middle:?}");
    }
}
