//! Builds an ONNX graph operator by operator.
//!
//! Every method appends nodes and returns the value they make. Where the picture size is fixed, sizes are followed
//! along the way and cuts that would change nothing are left out; where it is not, cuts read it from the graph.

use super::proto;
use super::proto::{Attribute, AttributeType, DataType, Node};
use crate::folding::{Kernel, folded};
use burn::nn::conv::{Conv2d, ConvTranspose2d};
use burn::nn::{BatchNorm, PaddingConfig2d};
use burn::tensor::ExecutionError;

/// A picture-shaped value of the graph.
#[derive(Debug, Clone)]
pub struct Value {
    pub name: String,
    /// Rows and columns, if fixed.
    pub size: Option<[usize; 2]>,
}

#[derive(Default)]
pub struct GraphBuilder {
    nodes: Vec<Node>,
    initializers: Vec<proto::Tensor>,
}

impl GraphBuilder {
    pub fn finish(self) -> (Vec<Node>, Vec<proto::Tensor>) {
        (self.nodes, self.initializers)
    }

    pub fn conv(&mut self, conv: &Conv2d, norm: Option<&BatchNorm>, input: &Value) -> Result<Value, ExecutionError> {
        let kernel = folded(conv.weight.val(), conv.bias.as_ref().map(|bias| bias.val()), norm, 0)?;
        let padding = match conv.padding {
            PaddingConfig2d::Same => text("auto_pad", "SAME_UPPER"),
            PaddingConfig2d::Valid => ints("pads", &[0; 4]),
            PaddingConfig2d::Explicit(top, left, bottom, right) => ints("pads", &[top, left, bottom, right]),
        };
        let attributes = vec![ints("strides", &conv.stride), padding];
        // Both flavours of padding keep ceil(n / stride) rows.
        let size = input.size.map(|[h, w]| [h.div_ceil(conv.stride[0]), w.div_ceil(conv.stride[1])]);
        Ok(self.convolution("Conv", kernel, input, attributes, size))
    }

    /// Transposed convolution, cut to the size of `like`.
    pub fn up_conv(
        &mut self,
        conv: &ConvTranspose2d,
        norm: Option<&BatchNorm>,
        input: &Value,
        like: &Value,
    ) -> Result<Value, ExecutionError> {
        let kernel = folded(conv.weight.val(), conv.bias.as_ref().map(|bias| bias.val()), norm, 1)?;
        let ([top, left], [below, beside]) = (conv.padding, conv.padding_out);
        let attributes = vec![
            ints("strides", &conv.stride),
            ints("pads", &[top, left, top, left]),
            ints("output_padding", &[below, beside]),
        ];
        let grown = |n: usize, axis: usize| {
            2 * (n - 1) + conv.kernel_size[axis] + conv.padding_out[axis] - 2 * conv.padding[axis]
        };
        let size = input.size.map(|[h, w]| [grown(h, 0), grown(w, 1)]);
        let full = self.convolution("ConvTranspose", kernel, input, attributes, size);
        Ok(self.crop(full, like))
    }

    pub fn relu(&mut self, input: &Value) -> Value {
        self.node("Relu", &[&input.name], vec![], input.size)
    }

    pub fn sigmoid(&mut self, input: &Value) -> Value {
        self.node("Sigmoid", &[&input.name], vec![], input.size)
    }

    pub fn scale(&mut self, input: &Value, factor: f64) -> Value {
        let factor = self.scalar(factor);
        self.node("Mul", &[&input.name, &factor], vec![], input.size)
    }

    pub fn offset(&mut self, input: &Value, summand: f64) -> Value {
        let summand = self.scalar(summand);
        self.node("Add", &[&input.name, &summand], vec![], input.size)
    }

    pub fn subtract(&mut self, left: &Value, right: &Value) -> Value {
        self.node("Sub", &[&left.name, &right.name], vec![], left.size)
    }

    /// Along the channels; all inputs have the size of the first.
    pub fn concat(&mut self, inputs: &[Value]) -> Value {
        let names: Vec<&str> = inputs.iter().map(|input| input.name.as_str()).collect();
        self.node("Concat", &names, vec![int("axis", 1)], inputs.first().and_then(|input| input.size))
    }

    /// Doubles a picture bilinearly, pixel areas aligned, and cuts it to the size of `like`.
    pub fn upsample(&mut self, input: &Value, like: &Value) -> Value {
        let scales: Vec<u8> = [1.0f32, 1.0, 2.0, 2.0].iter().flat_map(|scale| scale.to_le_bytes()).collect();
        let scales = self.initializer(DataType::Float, vec![4], scales);
        let attributes = vec![text("mode", "linear"), text("coordinate_transformation_mode", "half_pixel")];
        let size = input.size.map(|[h, w]| [2 * h, 2 * w]);
        // The empty name stands for the region of interest, which this mode has not.
        let doubled = self.node("Resize", &[&input.name, "", &scales], attributes, size);
        self.crop(doubled, like)
    }

    /// Every `step`-th channel from `start` on, before `end`.
    pub fn channels(&mut self, input: &Value, start: i64, end: i64, step: i64) -> Value {
        let parts = [start, end, 1, step].map(|number| self.integers(&[number]));
        let [start, end, axis, step] = parts.each_ref().map(String::as_str);
        self.node("Slice", &[&input.name, start, end, axis, step], vec![], input.size)
    }

    /// Mean over rows and columns, as `[batch, rows, columns]`.
    pub fn spatial_mean(&mut self, input: &Value, rows: usize, columns: usize) -> Value {
        let mean = self.node("ReduceMean", &[&input.name], vec![ints("axes", &[2, 3]), int("keepdims", 0)], None);
        // A zero keeps the batch as it is.
        let shape = self.integers(&[0, rows as i64, columns as i64]);
        self.node("Reshape", &[&mean.name, &shape], vec![], None)
    }

    /// Gives a value the name it has outside.
    pub fn output(&mut self, input: &Value, name: &str) {
        let node = Node {
            input: vec![input.name.clone()],
            output: vec![name.to_string()],
            name: name.to_string(),
            op_type: "Identity".to_string(),
            attribute: vec![],
        };
        self.nodes.push(node);
    }

    fn crop(&mut self, input: Value, like: &Value) -> Value {
        let ends = match (input.size, like.size) {
            (Some(size), Some(wanted)) if size == wanted => return input,
            (_, Some([height, width])) => self.integers(&[height as i64, width as i64]),
            (_, None) => self.node("Shape", &[&like.name], vec![int("start", 2), int("end", 4)], None).name,
        };
        let (starts, axes) = (self.integers(&[0, 0]), self.integers(&[2, 3]));
        self.node("Slice", &[&input.name, &starts, &ends, &axes], vec![], like.size)
    }

    fn convolution(
        &mut self,
        operator: &str,
        kernel: Kernel,
        input: &Value,
        attributes: Vec<Attribute>,
        size: Option<[usize; 2]>,
    ) -> Value {
        let dims = kernel.dims.map(|extent| extent as i64).to_vec();
        let bias_dims = vec![kernel.bias.len() as i64];
        let bytes = |values: Vec<f32>| values.iter().flat_map(|value| value.to_le_bytes()).collect();
        let weight = self.initializer(DataType::Float, dims, bytes(kernel.weight));
        let bias = self.initializer(DataType::Float, bias_dims, bytes(kernel.bias));
        self.node(operator, &[&input.name, &weight, &bias], attributes, size)
    }

    fn node(&mut self, operator: &str, inputs: &[&str], attribute: Vec<Attribute>, size: Option<[usize; 2]>) -> Value {
        let name = format!("{}_{}", operator.to_lowercase(), self.nodes.len());
        self.nodes.push(Node {
            input: inputs.iter().map(|name| (*name).to_string()).collect(),
            output: vec![name.clone()],
            name: name.clone(),
            op_type: operator.to_string(),
            attribute,
        });
        Value { name, size }
    }

    fn scalar(&mut self, value: f64) -> String {
        self.initializer(DataType::Float, vec![], (value as f32).to_le_bytes().to_vec())
    }

    fn integers(&mut self, values: &[i64]) -> String {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.initializer(DataType::Int64, vec![values.len() as i64], bytes)
    }

    fn initializer(&mut self, data_type: DataType, dims: Vec<i64>, raw_data: Vec<u8>) -> String {
        let name = format!("constant_{}", self.initializers.len());
        self.initializers.push(proto::Tensor { dims, data_type: data_type.into(), name: name.clone(), raw_data });
        name
    }
}

/// Scales the output channels, which lie along `axis` of the weight, by `gamma / sqrt(variance + epsilon)`.
///
fn int(name: &str, value: i64) -> Attribute {
    Attribute { name: name.to_string(), i: value, r#type: AttributeType::Int.into(), ..Attribute::default() }
}

fn ints(name: &str, values: &[usize]) -> Attribute {
    let ints = values.iter().map(|&value| value as i64).collect();
    Attribute { name: name.to_string(), ints, r#type: AttributeType::Ints.into(), ..Attribute::default() }
}

fn text(name: &str, value: &str) -> Attribute {
    let s = value.as_bytes().to_vec();
    Attribute { name: name.to_string(), s, r#type: AttributeType::String.into(), ..Attribute::default() }
}
