//! One seed, one network. Alone in its binary: the seed belongs to the whole process.

use burn::tensor::{Device, Tensor};
use endoscape_nets::{DispNetConfig, PoseMaskNetConfig};

#[test]
fn the_same_seed_gives_the_same_networks_and_outputs() {
    let device = Device::flex();
    let outputs = |seed: u64| {
        device.seed(seed);
        let disp = DispNetConfig::default().with_width(0.0625).init(&device).unwrap();
        let pose = PoseMaskNetConfig::default().with_width(0.125).init(&device).unwrap();
        let image = Tensor::<4>::full([1, 3, 40, 72], 0.3, &device);
        let motion = pose.forward_motion(image.clone(), &[image.clone(), image.clone()]);
        let [disparity, ..] = disp.forward(image).scales;
        (disparity.into_data(), motion.into_data())
    };
    assert_eq!(outputs(7), outputs(7));
    assert_ne!(outputs(7), outputs(8));
}
