//! Export to ONNX, operator set 17: the networks for programs that know nothing of this one.
//!
//! | value | shape | what |
//! |---|---|---|
//! | input `image` | batch, 3, height, width | RGB in [-1, 1]; the input of a depth network exported alone |
//! | input `snippet` | batch, 3 N, height, width | the same for target and sources in time order, target first |
//! | output `disparity` | batch, 1, height, width | of the target; depth is its inverse |
//! | output `motion` | batch, N - 1, 6 | `source_from_target`: tx ty tz, then the rotation as the metadata names it |
//! | output `mask` | batch, N - 1, height, width | reliability per source, if the network predicts it |
//!
//! Batch normalisation is folded into the convolutions; coarser scales of disparity and mask are not put out.

mod graph;
mod proto;

use crate::checkpoint::Checkpoint;
use crate::disp_net::{DispNet, FIRST_HEAD};
use crate::error::NetsError;
use crate::files;
use crate::import::Network;
use crate::layers::{ConvBlock, UpConvBlock};
use crate::pose_mask_net::{MOTION_SCALE, MaskDecoder, MaskHead, PoseMaskNet};
use burn::tensor::ExecutionError;
use graph::{GraphBuilder, Value};
use prost::Message;
use proto::{DataType, Dimension, Extent, ValueInfo};
use std::path::Path;

/// Operator set of the exported files.
const OPERATOR_SET: i64 = 17;

/// What to fix in an exported graph; the default leaves everything open.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct OnnxOptions {
    /// One network alone; depth and motion, if the checkpoint has both. The alignment network is not exported: what it
    /// reads takes a warp to make.
    pub only: Option<Network>,
    /// Pictures per call.
    pub batch: Option<usize>,
    /// Rows and columns.
    pub size: Option<[usize; 2]>,
}

impl Checkpoint {
    /// Writes one ONNX file with the depth and the motion network of the checkpoint, or one of them.
    ///
    /// # Errors
    /// [`NetsError::Mismatch`] when the checkpoint lacks the network asked for, and [`NetsError::Io`].
    pub fn export_onnx(&self, path: &Path, options: &OnnxOptions) -> Result<(), NetsError> {
        let disp = self.disp.as_ref().filter(|_| options.only.is_none_or(|only| only == Network::Disp));
        let pose = self.pose.as_ref().filter(|_| options.only.is_none_or(|only| only == Network::Pose));
        if disp.is_none() && pose.is_none() {
            let wanted = options.only.map_or_else(|| "network".to_string(), |network| network.to_string());
            let reason = format!("cannot be written because the checkpoint has no {wanted}");
            return Err(NetsError::mismatch(path, reason, "import or train it first"));
        }
        let unreadable = |error| NetsError::io(path, "write", std::io::Error::other(format!("{error:?}")));
        let model = self.model(disp, pose, options).map_err(unreadable)?;
        files::replace_with(path, |draft| files::write_durably(draft, &model.encode_to_vec()))
    }

    fn model(
        &self,
        disp: Option<&DispNet>,
        pose: Option<&PoseMaskNet>,
        options: &OnnxOptions,
    ) -> Result<proto::Model, ExecutionError> {
        let channels = pose.map_or(3, |pose| 3 * (pose.sources + 1));
        let name = if pose.is_some() { "snippet" } else { "image" };
        let input = Value { name: name.to_string(), size: options.size };
        let mut graph = GraphBuilder::default();
        let mut output = Vec::new();
        if let Some(disp) = disp {
            let image = if pose.is_some() { graph.channels(&input, 0, 3, 1) } else { input.clone() };
            let disparity = disp_net(&mut graph, disp, &image)?;
            graph.output(&disparity, "disparity");
            output.push(picture("disparity", 1, options, "inverse depth of the target"));
        }
        if let Some(pose) = pose {
            output.extend(pose_mask_net(&mut graph, pose, &input, options)?);
        }
        let (node, initializer) = graph.finish();
        let input = vec![picture(name, channels, options, "RGB in [-1, 1]; target first, then sources in time order")];
        Ok(proto::Model {
            ir_version: proto::IR_VERSION,
            producer_name: "endoscape".to_string(),
            producer_version: env!("CARGO_PKG_VERSION").to_string(),
            doc_string: "Depth and camera motion from endoscopic video".to_string(),
            graph: Some(proto::Graph { node, name: "endoscape".to_string(), initializer, input, output }),
            opset_import: vec![proto::OperatorSet { domain: String::new(), version: OPERATOR_SET }],
            metadata_props: self.metadata(),
        })
    }

    /// What a user of the outputs must know and the graph does not say.
    fn metadata(&self) -> Vec<proto::Entry> {
        let rotation = format!("{:?}", self.config.pose.rotation);
        let length = self.config.pose.snippet_length.to_string();
        [("rotation", rotation), ("snippet_length", length)]
            .map(|(key, value)| proto::Entry { key: key.to_string(), value })
            .to_vec()
    }
}

/// The finest disparity; mirrors [`DispNet::forward`].
fn disp_net(graph: &mut GraphBuilder, net: &DispNet, image: &Value) -> Result<Value, ExecutionError> {
    let mut sizes = vec![image.clone()];
    let mut features = image.clone();
    for stage in &net.encoder {
        let halved = block(graph, &stage.halve, &features)?;
        features = block(graph, &stage.refine, &halved)?;
        sizes.push(features.clone());
    }
    sizes.pop();
    let mut disparity: Option<Value> = None;
    for (index, stage) in net.decoder.iter().enumerate() {
        // At full size the picture itself gives the size, but is no skip.
        let like = sizes.pop().unwrap_or_else(|| image.clone());
        let mut inputs = vec![up_block(graph, &stage.up, &features, &like)?];
        inputs.extend((!sizes.is_empty()).then(|| like.clone()));
        inputs.extend(disparity.as_ref().map(|coarser| graph.upsample(coarser, &like)));
        let joined = if inputs.len() > 1 { graph.concat(&inputs) } else { inputs.swap_remove(0) };
        features = block(graph, &stage.fuse, &joined)?;
        if index >= FIRST_HEAD {
            let logits = graph.conv(&net.heads[index - FIRST_HEAD], None, &features)?;
            let unit = graph.sigmoid(&logits);
            let scaled = graph.scale(&unit, net.alpha);
            disparity = Some(graph.offset(&scaled, net.beta));
        }
    }
    Ok(disparity.unwrap_or(features))
}

/// Motion and finest mask; mirrors [`PoseMaskNet::forward`]. Returns what it puts out.
fn pose_mask_net(
    graph: &mut GraphBuilder,
    net: &PoseMaskNet,
    snippet: &Value,
    options: &OnnxOptions,
) -> Result<Vec<ValueInfo>, ExecutionError> {
    let mut sizes = vec![snippet.clone()];
    let mut features = snippet.clone();
    for stage in &net.encoder {
        features = block(graph, stage, &features)?;
        sizes.push(features.clone());
    }
    sizes.pop();
    let mut moving = features.clone();
    for stage in &net.motion {
        moving = block(graph, stage, &moving)?;
    }
    let moving = graph.conv(&net.motion_head, None, &moving)?;
    let mean = graph.spatial_mean(&moving, net.sources, 6);
    let motion = graph.scale(&mean, MOTION_SCALE);
    graph.output(&motion, "motion");
    let dims = [extent(options.batch, "batch"), fixed(net.sources), fixed(6)];
    let mut outputs = vec![value_info("motion", dims.to_vec(), "source_from_target: translation, then rotation")];
    if let Some(decoder) = &net.mask {
        let mask = finest_mask(graph, decoder, features, &sizes, net.sources)?;
        graph.output(&mask, "mask");
        outputs.push(picture("mask", net.sources, options, "probability that a pixel can be trusted"));
    }
    Ok(outputs)
}

fn finest_mask(
    graph: &mut GraphBuilder,
    decoder: &MaskDecoder,
    mut features: Value,
    sizes: &[Value],
    sources: usize,
) -> Result<Value, ExecutionError> {
    for (stage, like) in decoder.ups.iter().zip(sizes.iter().rev()) {
        features = up_block(graph, stage, &features, like)?;
    }
    let [.., head] = &decoder.heads;
    let logits = graph.conv(head, None, &features)?;
    if decoder.kind != MaskHead::Softmax {
        return Ok(graph.sigmoid(&logits));
    }
    let end = 2 * sources as i64;
    let (doubtful, reliable) = (graph.channels(&logits, 0, end, 2), graph.channels(&logits, 1, end, 2));
    let difference = graph.subtract(&reliable, &doubtful);
    Ok(graph.sigmoid(&difference))
}

fn block(graph: &mut GraphBuilder, block: &ConvBlock, input: &Value) -> Result<Value, ExecutionError> {
    let features = graph.conv(&block.conv, block.norm.as_ref(), input)?;
    Ok(graph.relu(&features))
}

fn up_block(
    graph: &mut GraphBuilder,
    block: &UpConvBlock,
    input: &Value,
    like: &Value,
) -> Result<Value, ExecutionError> {
    let features = graph.up_conv(&block.conv, block.norm.as_ref(), input, like)?;
    Ok(graph.relu(&features))
}

fn picture(name: &str, channels: usize, options: &OnnxOptions, meaning: &str) -> ValueInfo {
    let [height, width] = options.size.map_or([None; 2], |size| size.map(Some));
    let dims = vec![extent(options.batch, "batch"), fixed(channels), extent(height, "height"), extent(width, "width")];
    value_info(name, dims, meaning)
}

fn value_info(name: &str, dims: Vec<Extent>, meaning: &str) -> ValueInfo {
    let dim = dims.into_iter().map(|extent| Dimension { value: Some(extent) }).collect();
    let tensor = proto::TensorType { elem_type: DataType::Float.into(), shape: Some(proto::Shape { dim }) };
    ValueInfo {
        name: name.to_string(),
        r#type: Some(proto::Type { tensor_type: Some(tensor) }),
        doc_string: meaning.to_string(),
    }
}

fn fixed(extent: usize) -> Extent {
    Extent::Fixed(extent as i64)
}

fn extent(known: Option<usize>, name: &str) -> Extent {
    known.map_or_else(|| Extent::Named(name.to_string()), fixed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::NetsConfig;
    use burn::tensor::Device;
    use std::collections::HashSet;

    fn exported(checkpoint: &Checkpoint, options: &OnnxOptions) -> proto::Model {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.onnx");
        checkpoint.export_onnx(&path, options).unwrap();
        proto::Model::decode(std::fs::read(path).unwrap().as_slice()).unwrap()
    }

    fn tiny(config: NetsConfig) -> Checkpoint {
        let config = NetsConfig { disp: config.disp.with_width(0.01), pose: config.pose.with_width(0.05), ..config };
        Checkpoint::init(config, 0, &Device::flex()).unwrap()
    }

    #[test]
    fn every_node_uses_what_stands_before_it() {
        for (config, size) in [(NetsConfig::paper(), None), (NetsConfig::endo(), Some([37, 90]))] {
            let model = exported(&tiny(config), &OnnxOptions { size, ..OnnxOptions::default() });
            assert_eq!(model.opset_import[0].version, 17);
            let graph = model.graph.unwrap();
            let inputs = graph.input.iter().map(|value| value.name.clone());
            let mut known: HashSet<String> = inputs.chain(graph.initializer.iter().map(|t| t.name.clone())).collect();
            for node in &graph.node {
                for input in node.input.iter().filter(|input| !input.is_empty()) {
                    assert!(known.contains(input), "{} lacks {input}", node.name);
                }
                assert!(known.insert(node.output[0].clone()), "{} is made twice", node.output[0]);
            }
            let outputs: Vec<_> = graph.output.iter().map(|value| value.name.as_str()).collect();
            assert_eq!(outputs, ["disparity", "motion", "mask"]);
            for tensor in &graph.initializer {
                let width = if tensor.data_type() == DataType::Float { 4 } else { 8 };
                assert_eq!(tensor.raw_data.len() as i64, tensor.dims.iter().product::<i64>() * width);
            }
        }
    }

    #[test]
    fn a_size_divisible_by_128_needs_no_cuts() {
        let only = Some(Network::Disp);
        let model = exported(&tiny(NetsConfig::endo()), &OnnxOptions { only, size: Some([128, 256]), batch: Some(1) });
        let graph = model.graph.unwrap();
        assert!(graph.node.iter().all(|node| !matches!(node.op_type.as_str(), "Slice" | "Shape")));
        assert_eq!(graph.input[0].name, "image");
    }

    #[test]
    fn a_network_that_is_not_there_is_one_sentence() {
        let mut checkpoint = tiny(NetsConfig::endo());
        checkpoint.pose = None;
        let options = OnnxOptions { only: Some(Network::Pose), ..OnnxOptions::default() };
        let message = checkpoint.export_onnx(Path::new("out.onnx"), &options).unwrap_err().to_string();
        assert_eq!(
            message,
            "out.onnx: cannot be written because the checkpoint has no motion network; import or train it first"
        );
    }
}
