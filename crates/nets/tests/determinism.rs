//! One seed, one network, whatever else the process draws at the same time.

use burn::tensor::{Device, Distribution, Tensor};
use endoscape_nets::{DispNetConfig, PoseMaskNetConfig};

#[test]
fn the_same_seed_gives_the_same_networks_and_outputs() {
    let device = Device::flex();
    let outputs = |seed: u64| {
        let disp = DispNetConfig::default().with_width(0.0625).init(seed, &device).unwrap();
        // The generator of a device belongs to the whole process: what others take from it must not matter.
        let _ = Tensor::<1>::random([seed as usize], Distribution::Default, &device).into_data();
        let pose = PoseMaskNetConfig::default().with_width(0.125).init(seed, &device).unwrap();
        let image = Tensor::<4>::full([1, 3, 40, 72], 0.3, &device);
        let motion = pose.forward_motion(image.clone(), &[image.clone(), image.clone()]);
        let [disparity, ..] = disp.forward(image).scales;
        (disparity.into_data(), motion.into_data())
    };
    assert_eq!(outputs(7), outputs(7));
    assert_ne!(outputs(7), outputs(8));
}
