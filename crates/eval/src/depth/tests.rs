use super::*;
use endoscape_core::Grid;
use proptest::prelude::*;

const ALL: Valid = Valid { min_m: 1e-6, max_m: 1e4, crop: Crop::WHOLE };

fn map(width: usize, height: usize, depth: impl Fn(usize, usize) -> f32) -> DepthMap {
    DepthMap::new(Grid::from_fn(Size::new(width, height), depth))
}

fn hilly(width: usize, height: usize) -> DepthMap {
    map(width, height, |x, y| 1.0 + 0.1 * x as f32 + 0.03 * y as f32)
}

#[test]
fn figures_worked_out_by_hand() {
    let truth = map(2, 1, |x, _| if x == 0 { 1.0 } else { 2.0 });
    let prediction = map(2, 1, |x, _| if x == 0 { 2.0 } else { 2.0 });
    let errors = Samples::of(&prediction, &truth, &ALL).unwrap().errors(1.0, &ALL).unwrap();
    let ln2 = 2_f64.ln();
    assert_eq!((errors.abs_rel, errors.sq_rel, errors.rmse_m), (0.5, 0.5, 0.5_f64.sqrt()));
    assert!((errors.rmse_log - (ln2 * ln2 / 2.0).sqrt()).abs() < 1e-12);
    assert_eq!((errors.d1, errors.d2, errors.d3), (0.5, 0.5, 0.5));
    // ln p - ln g is (ln 2, 0): its standard deviation is half of ln 2.
    assert!((errors.silog - 50.0 * ln2).abs() < 1e-9);
}

#[test]
fn range_and_crop_choose_the_pixels() {
    let truth = hilly(100, 50);
    let valid = Valid::new(2.0, 3.0, Crop::WHOLE).unwrap();
    let inside = truth.grid().values().iter().filter(|depth| **depth > 2.0 && **depth < 3.0).count();
    assert_eq!(Samples::of(&truth, &truth, &valid).unwrap().len(), inside);
    let garg = Valid { crop: Crop::GARG, ..ALL };
    // KITTI's usual 375 x 1242: rows 153 to 371, columns 44 to 1197.
    let kitti = map(1242, 375, |_, _| 5.0);
    assert_eq!(Samples::of(&kitti, &kitti, &garg).unwrap().len(), (371 - 153) * (1197 - 44));
    assert!(Valid::new(1.0, 0.5, Crop::WHOLE).is_err());
    assert!(Valid::new(f64::NAN, 0.5, Crop::WHOLE).is_err());
}

#[test]
fn other_sizes_are_resized_and_other_shapes_refused() {
    let small = hilly(40, 20);
    let resized = resize_to(&small, Size::new(80, 40)).unwrap();
    // Where all neighbours lie inside, a plane stays a plane: x / 2 - 1 / 4 of the small map.
    let expected = 1.0 + 0.1 * (30.0 / 2.0 - 0.25) + 0.03 * (10.0 / 2.0 - 0.25);
    assert!((resized.get(30, 10).unwrap() - expected).abs() < 1e-5);
    assert!(matches!(resize_to(&small, Size::new(40, 40)), Err(EvalError::Shape { .. })));
    assert!(resize_to(&small, Size::new(0, 0)).is_err());
    let holed = map(4, 4, |x, _| if x < 2 { 0.0 } else { 3.0 });
    let resized = resize_to(&holed, Size::new(8, 8)).unwrap();
    assert!(resized.grid().values().iter().all(|depth| *depth == 0.0 || *depth == 3.0));
}

#[test]
fn a_sequence_is_scaled_as_asked() {
    let truths: Vec<DepthMap> = (1..=3).map(|k| hilly(8, 6).scaled(k as f32)).collect();
    let prediction = hilly(8, 6);
    let judged = |scaling| {
        let load = |index: usize| Samples::of(&prediction, &truths[index], &ALL);
        evaluate(3, load, scaling, &ALL).unwrap().unwrap()
    };
    let median = judged(Scaling::Median);
    assert!(median.errors.abs_rel < 1e-6 && median.baselines.constant.abs_rel > 0.05);
    assert!((median.scale - 2.0).abs() < 1e-6);
    // Ratios 1, 2, 3 over their median 2.
    assert!((median.scale_std - (2.0_f64 / 3.0).sqrt() / 2.0).abs() < 1e-6);
    let sequence = judged(Scaling::Sequence);
    assert!((sequence.errors.abs_rel - (1.0 + 0.0 + 1.0 / 3.0) / 3.0).abs() < 1e-6);
    let none = judged(Scaling::None);
    assert!((none.errors.abs_rel - (0.0 + 0.5 + 2.0 / 3.0) / 3.0).abs() < 1e-6);
    assert_eq!(none.frames, 3);
}

#[test]
fn nothing_to_judge_is_no_nan() {
    let unknown = map(4, 4, |_, _| 0.0);
    let load = |_: usize| Samples::of(&unknown, &hilly(4, 4), &ALL);
    assert_eq!(evaluate(2, load, Scaling::Median, &ALL).unwrap(), None);
    assert_eq!(evaluate(0, load, Scaling::Median, &ALL).unwrap(), None);
    assert_eq!(load(0).unwrap().coverage(), 0.0);
}

proptest! {
    #[test]
    fn median_scaling_forgets_the_scale(scale in 0.01..100.0_f32) {
        let truth = hilly(16, 12);
        let errors = |prediction: &DepthMap| {
            let samples = Samples::of(prediction, &truth, &ALL).unwrap();
            samples.errors(samples.median_ratio().unwrap(), &ALL).unwrap()
        };
        let bent = map(16, 12, |x, y| 1.0 + 0.02 * (x * y) as f32);
        let (a, b) = (errors(&bent), errors(&bent.scaled(scale)));
        prop_assert!((a.abs_rel - b.abs_rel).abs() < 1e-5 && (a.silog - b.silog).abs() < 1e-3);
    }
}
