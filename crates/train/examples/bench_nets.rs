//! The Rust half of `scripts/bench_nets.py`: does what a line on standard input says, answers with the seconds.
//!
//! | request | answer |
//! |---|---|
//! | `export FOLDER NETS WxH` | writes `disp.onnx` and `pose.onnx` (motion alone); `[]` |
//! | `infer WHAT NETS WxH COUNT` | seconds of each pass; WHAT is `depth`, `motion`, `both` or `forward` (Burn's layers) |
//! | `profile WHAT NETS WxH COUNT` | `[name, size, operations, seconds]` of each step of a plan, medians; WHAT is `depth` or `motion` |
//! | `step OBJECTIVE NETS WxH BATCH COUNT` | seconds of each training step |
//! | `parts OBJECTIVE NETS WxH BATCH COUNT` | seconds of networks, objective, backward and optimiser, medians |
//!
//! NETS and OBJECTIVE name presets. Answers are one JSON list per line, so that several programs can take turns.

use burn::optim::GradientsParams;
use burn::tensor::{Device, Distribution, Tensor};
use endoscape_core::{Camera, Size};
use endoscape_kernels::awake;
use endoscape_nets::{
    Checkpoint, DepthPlan, InferencePlan, MaskHead, MotionPlan, NetsConfig, Network, OnnxOptions, SCALES, StepTime,
    recycle,
};
use endoscape_synthesis::config::Scales;
use endoscape_synthesis::objective::{View, ViewBatch};
use endoscape_synthesis::{CameraPyramid, ObjectiveConfig, objective, pyramid};
use endoscape_train::batch::SnippetBatch;
use endoscape_train::model::DepthMotionModel;
use endoscape_train::optimizer::adam;
use std::error::Error;
use std::hint::black_box;
use std::io::{BufRead, Write};
use std::path::Path;
use std::time::Instant;

/// Name, rows and columns, operations and seconds of a step.
type StepRow = (String, [usize; 2], usize, f64);

fn main() -> Result<(), Box<dyn Error>> {
    for line in std::io::stdin().lock().lines() {
        let line = line?;
        if let ["profile", what, nets, size, count] = line.split_whitespace().collect::<Vec<_>>()[..] {
            let steps = profile(what, &checkpoint(nets)?, parse(size)?, count.parse()?)?;
            writeln!(std::io::stdout(), "{}", serde_json::to_string(&steps)?)?;
            continue;
        }
        let seconds = match line.split_whitespace().collect::<Vec<_>>()[..] {
            ["export", folder, nets, size] => export(Path::new(folder), nets, parse(size)?)?,
            ["infer", what, nets, size, count] => infer(what, &checkpoint(nets)?, parse(size)?, count.parse()?)?,
            ["step", config, nets, size, batch, count] => {
                let steps = steps(&preset(config)?, checkpoint(nets)?, parse(size)?, batch.parse()?, count.parse()?)?;
                steps.into_iter().map(|parts| parts.into_iter().sum()).collect()
            }
            ["parts", config, nets, size, batch, count] => {
                let steps = steps(&preset(config)?, checkpoint(nets)?, parse(size)?, batch.parse()?, count.parse()?)?;
                (0..4).map(|part| median(steps.iter().map(|parts| parts[part]).collect())).collect()
            }
            _ => return Err(format!("unknown request: {line}").into()),
        };
        writeln!(std::io::stdout(), "{seconds:?}")?;
    }
    Ok(())
}

fn checkpoint(nets: &str) -> Result<Checkpoint, Box<dyn Error>> {
    let device = Device::flex();
    Ok(Checkpoint::init(NetsConfig::preset(nets).ok_or("no such networks")?, 0, &device)?)
}

fn preset(objective: &str) -> Result<ObjectiveConfig, Box<dyn Error>> {
    match objective {
        "paper" => Ok(ObjectiveConfig::paper()),
        "port" => Ok(ObjectiveConfig::port()),
        "endo" => Ok(ObjectiveConfig::endo()),
        _ => Err("no such objective".into()),
    }
}

fn parse(size: &str) -> Result<Size, Box<dyn Error>> {
    let (width, height) = size.split_once('x').ok_or("sizes are WxH")?;
    Ok(Size::new(width.parse()?, height.parse()?))
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

fn export(folder: &Path, nets: &str, size: Size) -> Result<Vec<f64>, Box<dyn Error>> {
    let mut config = NetsConfig::preset(nets).ok_or("no such networks")?;
    // Without its mask the motion network is what a user runs.
    config.pose.mask = MaskHead::None;
    let checkpoint = Checkpoint::init(config, 0, &Device::flex())?;
    let size = Some([size.height, size.width]);
    for (name, network) in [("disp", Network::Disp), ("pose", Network::Pose)] {
        let options = OnnxOptions { only: Some(network), batch: Some(1), size };
        checkpoint.export_onnx(&folder.join(format!("{name}.onnx")), &options)?;
    }
    Ok(Vec::new())
}

/// Seconds of each of `count` runs, after one that is not counted.
fn timed(count: usize, mut run: impl FnMut()) -> Vec<f64> {
    run();
    let once = |_| {
        let begun = Instant::now();
        run();
        begun.elapsed().as_secs_f64()
    };
    (0..count).map(once).collect()
}

fn infer(what: &str, checkpoint: &Checkpoint, size: Size, count: usize) -> Result<Vec<f64>, Box<dyn Error>> {
    let rows_columns = [size.height, size.width];
    let (disp, pose) = (checkpoint.disp.as_ref().ok_or("no depth")?, checkpoint.pose.as_ref().ok_or("no motion")?);
    let snippet = vec![0.25; 9 * size.area()];
    let image = &snippet[..3 * size.area()];
    match what {
        "depth" => {
            let mut plan = DepthPlan::new(disp, rows_columns)?;
            Ok(timed(count, || {
                black_box(plan.disparity(image));
            }))
        }
        "motion" => {
            let mut plan = MotionPlan::new(pose, rows_columns, false)?;
            Ok(timed(count, || {
                black_box(plan.motion(&snippet));
            }))
        }
        "both" => {
            let mut plan = InferencePlan::new(checkpoint, rows_columns, false)?;
            Ok(timed(count, || {
                black_box(plan.depth_and_motion(&snippet));
            }))
        }
        "forward" => {
            let image = noise([1, 3, size.height, size.width], &Device::flex());
            Ok(timed(count, || {
                black_box(disp.forward(image.clone()));
            }))
        }
        _ => Err("infer what?".into()),
    }
}

/// Medians over `count` runs of each step of a plan.
fn profile(what: &str, checkpoint: &Checkpoint, size: Size, count: usize) -> Result<Vec<StepRow>, Box<dyn Error>> {
    let snippet = vec![0.25; 9 * size.area()];
    let mut plan = InferencePlan::new(checkpoint, [size.height, size.width], false)?;
    plan.depth_and_motion(&snippet);
    let run = |_| match what {
        "depth" => plan.depth.as_mut().map(|plan| plan.profile(&snippet[..3 * size.area()])),
        _ => plan.motion.as_mut().map(|plan| plan.profile(&snippet)),
    };
    let runs: Vec<Vec<StepTime>> = (0..count.max(1)).filter_map(run).collect();
    let row = |(index, step): (usize, &StepTime)| {
        let seconds = median(runs.iter().map(|run| run[index].seconds).collect());
        (step.name.clone(), step.size, step.operations, seconds)
    };
    Ok(runs.first().ok_or("no such network")?.iter().enumerate().map(row).collect())
}

fn noise(shape: [usize; 4], device: &Device) -> Tensor<4> {
    Tensor::random(shape, Distribution::Uniform(-1.0, 1.0), device)
}

/// Noise in the shape of a batch.
fn batch(count: usize, size: Size, config: &ObjectiveConfig, device: &Device) -> Result<SnippetBatch, Box<dyn Error>> {
    let camera = Camera::from_field_of_view(size, 70_f64.to_radians())?;
    let levels = if config.scales == Scales::Full { 1 } else { SCALES };
    let cameras = CameraPyramid::new(&[camera], &pyramid::sizes(size, levels), config.camera_scaling, device)?;
    let picture = || noise([count, 3, size.height, size.width], device);
    let usable = || Tensor::ones([count, 1, size.height, size.width], device);
    let view = || View { image: picture(), usable: Some(usable()) };
    Ok(SnippetBatch {
        views: ViewBatch { target: view(), sources: vec![view(), view()], cameras },
        depth_inputs: (0..3).map(|_| picture()).collect(),
        motion_inputs: (0..3).map(|_| picture()).collect(),
        stands: Tensor::zeros([count], device),
        lessons: None,
    })
}

/// Seconds of the networks, the objective, the way back and the optimiser in each of `count` steps.
fn steps(
    config: &ObjectiveConfig,
    checkpoint: Checkpoint,
    size: Size,
    snippets: usize,
    count: usize,
) -> Result<Vec<[f64; 4]>, Box<dyn Error>> {
    let device = Device::flex().autodiff();
    let batch = batch(snippets, size, config, &device)?;
    let fresh = Checkpoint::init(checkpoint.config, 0, &device)?;
    let mut model = DepthMotionModel::from_checkpoint(fresh)?;
    let (mut optimizer, mut steps) = (adam(), Vec::new());
    for _ in 0..=count {
        awake(|| {
            let mut mark = Instant::now();
            let mut lap = || std::mem::replace(&mut mark, Instant::now()).elapsed().as_secs_f64();
            let output = model.predict(&batch, config.geometry_weight > 0.0);
            let networks = lap();
            let terms = objective(&batch.views, &output.prediction, config);
            let judged = lap();
            let gradients = GradientsParams::from_grads(terms.total.backward(), &model);
            let backward = lap();
            let updated = optimizer.step(2e-4, model.clone(), gradients);
            recycle(std::mem::replace(&mut model, updated));
            steps.push([networks, judged, backward, lap()]);
        });
    }
    // The first step allocates what the others use again.
    Ok(steps.split_off(1))
}
