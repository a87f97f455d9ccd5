//! Writes ONNX files and what the same networks give here, for `scripts/check_onnx.py` to compare.
//!
//! `cargo run -p endoscape-nets --example onnx_samples -- OUT [CHECKPOINT]`: without a checkpoint,
//! the golden networks of the repository.

use burn::tensor::{Device, Distribution, Tensor};
use endoscape_nets::{Checkpoint, Network, OnnxOptions};
use safetensors::tensor::{Dtype, TensorView};
use std::error::Error;
use std::path::{Path, PathBuf};

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let out = arguments.next().ok_or("name an output folder")?;
    std::fs::create_dir_all(&out)?;
    let device = Device::flex();
    let checkpoints = match arguments.next() {
        Some(folder) => vec![("checkpoint", Checkpoint::load(&folder, &device)?, [128, 416])],
        None => {
            let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../golden/nets");
            let import = |name| Checkpoint::import(&golden.join(name), None, &device).map(|(checkpoint, _)| checkpoint);
            let mut port = import("port_disp.pth.tar")?;
            port.absorb(import("port_pose.pth.tar")?);
            vec![("port", port, [53, 90]), ("paper", import("paper_weights.safetensors")?, [64, 101])]
        }
    };
    for (name, checkpoint, size) in checkpoints {
        write_samples(&out, name, &checkpoint, size, &device)?;
    }
    Ok(())
}

fn write_samples(
    out: &Path,
    name: &str,
    checkpoint: &Checkpoint,
    size: [usize; 2],
    device: &Device,
) -> Result<(), Box<dyn Error>> {
    let (only_disp, only_pose) = (Some(Network::Disp), Some(Network::Pose));
    let (batch, fixed) = (Some(2), Some(size));
    for (suffix, options) in [
        ("open", OnnxOptions::default()),
        ("fixed", OnnxOptions { only: None, batch, size: fixed }),
        ("disp", OnnxOptions { only: only_disp, batch: None, size: fixed }),
        ("pose", OnnxOptions { only: only_pose, batch, size: None }),
    ] {
        checkpoint.export_onnx(&out.join(format!("{name}_{suffix}.onnx")), &options)?;
    }
    let (disp, pose) =
        (checkpoint.disp.as_ref().ok_or("no depth network")?, checkpoint.pose.as_ref().ok_or("no motion network")?);
    let [height, width] = size;
    let shape = [2, 3 * (pose.sources() + 1), height, width];
    let snippet = Tensor::<4>::random(shape, Distribution::Uniform(-1.0, 1.0), device);
    let image = snippet.clone().narrow(1, 0, 3);
    let [disparity, ..] = disp.forward(image.clone()).scales;
    let seen = pose.forward_snippet(snippet.clone());
    let mut arrays = vec![
        array("snippet", snippet),
        array("image", image),
        array("disparity", disparity),
        array("motion", seen.motion),
    ];
    arrays.extend(seen.mask.map(|[mask, ..]| array("mask", mask)));
    let views = arrays.iter().map(|(key, shape, bytes)| Ok((*key, TensorView::new(Dtype::F32, shape.clone(), bytes)?)));
    let views = views.collect::<Result<Vec<_>, safetensors::SafeTensorError>>()?;
    Ok(std::fs::write(out.join(format!("{name}.safetensors")), safetensors::serialize(views, None)?)?)
}

fn array<const D: usize>(key: &'static str, tensor: Tensor<D>) -> (&'static str, Vec<usize>, Vec<u8>) {
    let shape = tensor.dims().to_vec();
    let bytes = tensor.into_data().iter::<f32>().flat_map(f32::to_le_bytes).collect();
    (key, shape, bytes)
}
