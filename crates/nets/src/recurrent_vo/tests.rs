use super::*;
use burn::module::{ModuleVisitor, Param};
use burn::tensor::Gradients;

fn tiny() -> RecurrentVoConfig {
    RecurrentVoConfig {
        stem: [4, 6],
        blocks: [[2, 3, 2, 1], [3, 4, 3, 2], [4, 5, 4, 3]],
        grid: 2,
        hidden: 8,
        unit_m: 0.002,
    }
}

/// Pairs that differ from place to place, time to time and batch to batch.
fn pairs(shape: [usize; 5], device: &Device) -> Tensor<5> {
    let value = |at: usize| ((at * 7919 + 13) % 1009) as f32 / 504.5 - 1.0;
    let values: Vec<f32> = (0..shape.iter().product()).map(value).collect();
    Tensor::from_data(TensorData::new(values, shape), device)
}

fn numbers<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().iter().collect()
}

#[test]
fn every_pair_has_a_motion_at_any_size() {
    let device = Device::flex();
    let net = tiny().init(0, &device).unwrap();
    for [height, width] in [[64, 64], [33, 47], [8, 100], [1, 1]] {
        let (motion, Memory([first, second])) = net.forward(pairs([2, 3, 6, height, width], &device), None);
        assert_eq!(motion.dims(), [2, 3, 6]);
        assert_eq!((first.cell.dims(), second.hidden.dims()), ([2, 8], [2, 8]));
        assert!(numbers(motion).iter().all(|number| number.is_finite()));
    }
}

#[test]
fn one_pair_after_another_is_all_of_them_at_once() {
    let device = Device::flex();
    let net = tiny().init(3, &device).unwrap();
    let pairs = pairs([1, 7, 6, 40, 48], &device);
    let at_once = numbers(net.forward(pairs.clone(), None).0);
    let mut memory = None;
    let mut one_by_one = Vec::new();
    for time in 0..7 {
        let (motion, next) = net.forward(pairs.clone().narrow(1, time, 1), memory);
        one_by_one.extend(numbers(motion));
        memory = Some(next);
    }
    assert!(at_once.iter().zip(&one_by_one).all(|(a, b)| (a - b).abs() < 1e-6), "{at_once:?} {one_by_one:?}");
    let without_memory = numbers(net.forward(pairs.narrow(1, 6, 1), None).0);
    assert!(without_memory.iter().zip(&at_once[36..]).any(|(a, b)| (a - b).abs() > 1e-6), "nothing is remembered");
}

#[test]
fn one_seed_is_one_network() {
    let device = Device::flex();
    let motion = |seed| numbers(tiny().init(seed, &device).unwrap().forward(pairs([1, 2, 6, 32, 32], &device), None).0);
    assert_eq!(motion(4), motion(4));
    assert_ne!(motion(4), motion(5));
}

#[test]
fn the_parameter_count_is_known_before_building() {
    for config in [tiny(), RecurrentVoConfig::default()] {
        assert_eq!(config.init(0, &Device::flex()).unwrap().num_params(), config.parameter_count());
    }
}

#[test]
fn every_parameter_receives_a_gradient_and_a_detached_memory_none() {
    struct Dead<'a>(&'a Gradients, usize);
    impl ModuleVisitor for Dead<'_> {
        fn visit_float<const D: usize>(&mut self, parameter: &Param<Tensor<D>>) {
            self.1 += usize::from(parameter.val().grad(self.0).is_none());
        }
    }
    let device = Device::flex().autodiff();
    let net = tiny().init(0, &device).unwrap();
    let early = pairs([1, 2, 6, 32, 32], &device).require_grad();
    let (_, memory) = net.forward(early.clone(), None);
    let (motion, _) = net.forward(pairs([1, 3, 6, 32, 32], &device), Some(memory.clone()));
    let gradients = motion.sum().backward();
    let mut dead = Dead(&gradients, 0);
    net.visit(&mut dead);
    assert_eq!(dead.1, 0);
    assert!(early.grad(&gradients).is_some(), "the memory is part of the graph");
    let (motion, _) = net.forward(pairs([1, 3, 6, 32, 32], &device), Some(memory.detached()));
    assert!(early.grad(&motion.sum().backward()).is_none(), "a detached memory hands gradients on");
}

#[test]
fn wrong_settings_are_named() {
    for (text, fragment) in [
        ("hidden = 0", "`hidden` holds 0"),
        ("unit_m = 0.0", "`unit_m` is 0"),
        ("grid = 99", "`grid` is 99"),
        ("depth = 3", "`line 1`"),
    ] {
        let message = RecurrentVoConfig::from_toml(text).unwrap_err().to_string();
        assert!(message.contains(fragment) && !message.contains('\n'), "{message}");
    }
    assert_eq!(RecurrentVoConfig::from_toml(&tiny().to_toml().unwrap()).unwrap(), tiny());
}
